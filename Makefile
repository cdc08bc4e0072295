PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin

.PHONY: demo test fuzz lint benchmark clean

# The main job on the packaged recording: base install, no torch, no network but the package index.
demo: $(VENV)/base
	$(BIN)/depthmocap demo --out out/demo

# By two processes; what threads would do beside them, they would do against each other.
test: $(VENV)/dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n 2 --dist loadfile

# Spoilt inputs for every reader; also of some readers alone, or from another seed: FUZZ="--readers rig --seed 1".
fuzz: $(VENV)/dev
	OMP_NUM_THREADS=1 $(BIN)/python tests/fuzz/fuzz.py $(FUZZ)

lint: $(VENV)/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

benchmark: $(VENV)/dev
	$(BIN)/python benchmarks/run.py

$(VENV)/base: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q --disable-pip-version-check -e .
	touch $@

# The last line fills Anny's cache, which processes must not do at the same time.
$(VENV)/dev: pyproject.toml constraints.txt $(VENV)/base
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[train,cluster,record,datasets,realsense,dev]'
	$(BIN)/python -c 'from depthmocap.body.model import BodyModel; BodyModel.load()'
	touch $@

clean:
	rm -rf $(VENV) out
