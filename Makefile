# Each target sets up what it needs: Python $(PYTHON), make and a shell suffice.
PYTHON ?= python3.11
VENV ?= .venv
BIN := $(VENV)/bin
CONSTRAINTS ?= -c constraints.txt

.PHONY: demo test newest versions wheel bench evaluation pictures tables browser lint chip micropython notebooks docs linkcheck coverage clean

demo: $(VENV)/ready
	$(BIN)/soft-limb demo out --force

test: $(VENV)/ready lint
	$(BIN)/python -m pytest

# The tests with the newest versions that pyproject.toml allows, in an environment of its own.
newest:
	rm -rf build/newest
	$(MAKE) VENV=build/newest CONSTRAINTS= versions test

versions: $(VENV)/ready
	@echo "Other than in constraints.txt:"
	@$(BIN)/python -m pip list --format freeze --exclude-editable --exclude pip \
	    --disable-pip-version-check | grep -vixFf constraints.txt || echo "nothing"

# What pip installs, in dist/.
wheel: $(VENV)/ready
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .

bench: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(CONSTRAINTS) -e '.[bench]'
	$(BIN)/python benchmarks/simulation.py
	$(BIN)/python benchmarks/space_simulation.py
	$(BIN)/python benchmarks/public_crawler.py
	$(BIN)/python benchmarks/gaits.py
	$(BIN)/python benchmarks/stepping.py
	$(BIN)/python benchmarks/walking.py
	$(BIN)/python benchmarks/replanning.py
	$(BIN)/python benchmarks/sweep.py
	$(BIN)/python benchmarks/calibration_accuracy.py
	$(BIN)/python benchmarks/space_calibration.py
	$(BIN)/python benchmarks/fuzz.py
	$(BIN)/python benchmarks/lab_door.py --quick
	$(BIN)/python benchmarks/board_faults.py faults --limbs 2
	$(BIN)/python benchmarks/board_faults.py ordinary --limbs 2
	$(BIN)/python benchmarks/serial_replay.py
	$(BIN)/python benchmarks/live_page.py
	$(BIN)/python benchmarks/bridge.py
	$(BIN)/python benchmarks/laws.py
	$(BIN)/python benchmarks/controller_steps.py
	$(BIN)/python benchmarks/space_feedback.py
	$(BIN)/python benchmarks/planning.py

# `make pictures tables` makes all pictures and measured tables of README and docs from one run of the
# code. It takes an hour; pictures need Graphviz and a Chromium.
LIMBS ?= 6
OTHERS ?= 2
evaluation: $(VENV)/ready
	$(BIN)/python examples/reproduce_paper.py build/evaluation --limbs $(LIMBS) --others $(OTHERS)

pictures: evaluation
	$(BIN)/python docs/pictures.py build/evaluation

tables: evaluation
	$(BIN)/python benchmarks/controller_steps.py > build/evaluation/controller_steps.txt
	$(BIN)/python benchmarks/laws.py > build/evaluation/laws.txt
	$(BIN)/python docs/tables.py build/evaluation

# For the tests that look at pages; a Chromium that is installed already will do.
browser: $(VENV)/ready
	$(BIN)/playwright install --with-deps --only-shell chromium

# Needs Node.js and npm.
micropython: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(CONSTRAINTS) -e '.[firmware]'
	npm install --silent --no-save --prefix $(VENV)/micropython @micropython/micropython-webassembly-pyscript@1.27.0
	MICROPYTHON=$(VENV)/micropython/node_modules/@micropython/micropython-webassembly-pyscript/micropython.mjs \
	    $(BIN)/python -m pytest -n 0 tests/hardware/test_firmware.py -rsP

# The C core on emulated chips; needs arm-none-eabi-gcc and qemu-system-arm, and says so.
chip: $(VENV)/ready
	PYTHONPATH=benchmarks $(BIN)/python -m tests.chip.check_chip

# Which lines no test runs.
coverage: $(VENV)/ready
	mkdir -p build/coverage
	rm -f build/coverage/*
	$(BIN)/coverage run -m pytest
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

# Opens them in JupyterLab.
notebooks: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(CONSTRAINTS) -e '.[notebooks]'
	$(BIN)/jupyter lab examples/notebooks

# One site of all pages, the notebooks and the API of this version, from build/docs/index.html on.
docs: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(CONSTRAINTS) -e '.[docs]'
	$(BIN)/python docs/site/make_site.py

# Other sites may be down, or there may be no network.
linkcheck: $(VENV)/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(CONSTRAINTS) -e '.[docs]'
	-$(BIN)/python docs/site/make_site.py linkcheck

lint: $(VENV)/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

$(VENV)/ready: pyproject.toml constraints.txt
	@echo "Setting up $(VENV), once: about a minute, and 700 MB ..."
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --progress-bar on --disable-pip-version-check $(CONSTRAINTS) -e '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) out build *.egg-info
