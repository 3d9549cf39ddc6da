# Each target sets up what it needs: Python, make and a shell suffice. PYTHON is the newest that is
# supported, or what you say.
PYTHON ?=
VENV ?= .venv
BIN := $(VENV)/bin
CONSTRAINTS ?= -c constraints.txt

.PHONY: demo test test-all newest versions wheel bench evaluation pictures tables browser lint chip notebooks docs linkcheck coverage clean

demo: $(VENV)/ready
	$(BIN)/python examples/demo.py out

test: $(VENV)/ready lint
	$(BIN)/python -m pytest

# As well what takes long: the wheel, the demo, notebooks, a browser, MicroPython, C compilers, and
# long fits and walks.
test-all: $(VENV)/ready lint
	$(BIN)/python -m pytest -m ''

# The tests with the newest versions that pyproject.toml allows, in an environment of its own. All
# versions of Python that pyenv has count, not just the one that is chosen.
newest:
	rm -rf build/newest
	PYENV_VERSION=$$(pyenv versions --bare 2>/dev/null | paste -s -d : -) \
	    $(MAKE) VENV=build/newest CONSTRAINTS= versions test-all

versions: $(VENV)/ready
	@$(BIN)/python -c 'import sys; sys.version_info < (3, 12) and print("Drake 1.51 is the last for \
	Python 3.11: newer versions of Drake are not tested, as no newer Python was found.")'
	@echo "Other than in constraints.txt:"
	@$(BIN)/python -m pip list --format freeze --exclude-editable --exclude pip \
	    --disable-pip-version-check | grep -vixF "$$(sed 's/;.*//' constraints.txt)" || echo "nothing"

# What pip installs, in dist/.
wheel: $(VENV)/ready
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .

bench: $(VENV)/ready
	$(BIN)/python benchmarks/space_planning.py --problems 30
	$(BIN)/python benchmarks/public_crawler.py
	$(BIN)/python benchmarks/gaits.py
	$(BIN)/python benchmarks/random_plans.py
	$(BIN)/python benchmarks/space_calibration.py
	$(BIN)/python benchmarks/frame_fuzzing.py
	$(BIN)/python benchmarks/lab_door.py --quick
	$(BIN)/python benchmarks/board_faults.py --limbs 2
	$(BIN)/python benchmarks/serial_timing.py
	$(BIN)/python benchmarks/plan_time_by_law.py
	$(BIN)/python benchmarks/controller_step_time.py
	$(BIN)/python benchmarks/planning.py

# `make pictures tables` makes all pictures and measured tables of README and docs from one run of the
# code. It takes an hour; pictures need Graphviz and a Chromium.
LIMBS ?= 6
OTHERS ?= 2
evaluation: $(VENV)/ready
	$(BIN)/python examples/reproduce_paper build/evaluation --limbs $(LIMBS) --others $(OTHERS)

pictures: evaluation
	$(BIN)/python docs/pictures.py build/evaluation

tables: evaluation
	$(BIN)/python benchmarks/gaits_in_space.py > build/evaluation/gaits_in_space.txt
	$(BIN)/python docs/tables.py build/evaluation

# For the tests that look at pages; a Chromium that is installed already will do.
browser: $(VENV)/ready
	$(BIN)/playwright install --with-deps --only-shell chromium

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
	@sh .ci/set_up $(VENV) '$(PYTHON)' $(CONSTRAINTS) -e '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) out build *.egg-info
