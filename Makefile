PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin

.PHONY: demo test lint benchmark clean

# The main job on the packaged recording: base install, no torch, no network but the package index.
demo: $(VENV)/base
	$(BIN)/depthmocap demo --out out/demo

test: $(VENV)/dev
	$(BIN)/python -m pytest -q

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

$(VENV)/dev: pyproject.toml constraints.txt $(VENV)/base
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[train,cluster,record,datasets,realsense,dev]'
	touch $@

clean:
	rm -rf $(VENV) out
