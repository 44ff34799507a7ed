# Everything a contributor or CI does, one target each. `make help` lists them.
.DEFAULT_GOAL := help
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -q
LOCK := pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes \
	--no-annotate --no-header --no-emit-index-url --extra server --extra fast --extra build -q

.PHONY: kills help setup demo serve test check lint types arch house format bench bench-fea bench-stability bench-calibration bench-methods bench-surrogate bench-fill validate \
	validate-table validate-ccx image lock clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  %-15s %s\n", $$1, $$2}'

setup: $(VENV)/.installed  ## make .venv and install what the program runs with

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "wrenchbook needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(BIN)/python requirements.lock pyproject.toml
	$(PIP) install --require-hashes -r requirements.lock
	$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed requirements-dev.lock
	$(PIP) install --require-hashes -r requirements-dev.lock
	@touch $@

demo: setup  ## the main job, end to end, on real finite elements
	$(BIN)/wrenchbook demo

serve: setup  ## the API and the embedded solver on 127.0.0.1:8000
	$(BIN)/wrenchbook serve

test: $(VENV)/.installed-dev  ## the test suite
	$(BIN)/python -m pytest -n 2 --dist loadfile

check: lint types arch test  ## all that CI asks: lint, types, import rules, tests

lint: $(VENV)/.installed-dev  ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-dev  ## pyright
	$(BIN)/pyright

arch: $(VENV)/.installed-dev  ## import-linter: who may import what
	$(BIN)/lint-imports

house: $(VENV)/.installed-dev  ## files a room, circles, lengths, duplicates, what docstrings state
	$(BIN)/python -m tests.house

format: $(VENV)/.installed-dev  ## let ruff lay out the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.installed-dev  ## timings as ratios, side by side in one run
	$(BIN)/python -m pytest tests/benchmarks -s -p no:cacheprovider \
		--ignore tests/benchmarks/test_fill.py \
		--ignore tests/benchmarks/test_fea_speed.py --ignore tests/benchmarks/test_fea_calculix.py

bench-fea: $(VENV)/.installed-dev  ## wall time of the solver beside CalculiX, in turn
	$(BIN)/python -m pytest tests/benchmarks/test_fea_speed.py -s -p no:cacheprovider --timeout 1800

bench-stability: $(VENV)/.installed-dev  ## extreme parts and loads: each right or refused by name
	$(BIN)/python -m pytest tests/benchmarks/test_stability.py -s -p no:cacheprovider

bench-surrogate: $(VENV)/.installed-dev  ## single answers, batches and builds beside scipy's own calls
	$(BIN)/python -m pytest tests/benchmarks/test_surrogate_speed.py -s -p no:cacheprovider

bench-fill: $(VENV)/.installed-dev  ## error by the number of solves: fill, griddata and SMT's kriging
	$(BIN)/python -m pytest tests/benchmarks/test_fill.py -s -p no:cacheprovider

bench-calibration: $(VENV)/.installed-dev  ## error bars against true errors, fresh seeds; what each setting does
	$(BIN)/python -m pytest tests/benchmarks/test_calibration.py -s -p no:cacheprovider

bench-methods: $(VENV)/.installed-dev  ## RMS of each method, SMT's kriging and scipy's RBF at equal numbers of solves
	$(BIN)/python -m pytest tests/benchmarks/test_methods.py -s -p no:cacheprovider

kills: $(VENV)/.installed-dev  ## 200 times kill -9 of server, solver or both: no job lost, no row twice
	WRENCHBOOK_KILLS=200 $(BIN)/python -m pytest tests/service/test_kill.py -s --timeout 1200

validate: setup  ## verify the solver: closed forms, published numbers, CalculiX
	$(BIN)/wrenchbook validate all

validate-table: setup  ## the same, and write its tables into fea/README.md
	$(BIN)/python -m fea.validation all --update fea/README.md

validate-ccx: $(VENV)/.installed-dev  ## same mesh as CalculiX: the slow cases, about ten minutes
	$(BIN)/python -m pytest tests/benchmarks/test_fea_calculix.py -p no:cacheprovider --timeout 1800

image:  ## the container image
	docker build -t wrenchbook .

lock: $(VENV)/.installed-dev  ## write both lock files anew from pyproject.toml
	$(BIN)/uv $(LOCK) -o requirements.lock
	$(BIN)/uv $(LOCK) --extra dev -c requirements.lock -o requirements-dev.lock

clean:  ## remove .venv and caches
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis .import_linter_cache build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
