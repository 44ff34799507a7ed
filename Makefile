# Everything a contributor or CI does, one target each. `make help` lists them.
.DEFAULT_GOAL := help
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -q
LOCKED := --universal --python-version 3.11 --generate-hashes --no-annotate --no-header \
	--no-emit-index-url -q
LOCK := pip compile pyproject.toml $(LOCKED) --extra server --extra build
# The platforms of `make wheels`: those of surrogate/kernel/build.py.
PLATFORMS := manylinux_2_28_x86_64 manylinux_2_28_aarch64 macosx_11_0_x86_64 macosx_11_0_arm64 win_amd64

# One more than the cores: tests of servers and browsers wait for 40 % of their time.
WORKERS = $(shell $(PYTHON) -c 'import os; print(os.cpu_count() + 1)')

# Where the environment forbids bytecode, each server and solver compiles the sources anew: 0.4 s
# of the 2.0 s of processor time that the imports of a web process take.
unexport PYTHONDONTWRITEBYTECODE

# No target is a file.
.PHONY: $(shell sed -n 's/^\([a-z-]*\):.*/\1/p' Makefile)

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  %-15s %s\n", $$1, $$2}'

setup: $(VENV)/.installed  ## make .venv and install the locked packages of the program

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "wrenchbook needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(BIN)/python requirements.lock pyproject.toml
	$(PIP) install --require-hashes -r requirements.lock
	@command -v $${CC:-cc} >/dev/null || $(PIP) install --require-hashes -r requirements-zig.lock
	$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed requirements-dev.lock
	$(PIP) install --require-hashes -r requirements-dev.lock
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed requirements-docs.lock
	$(PIP) install --require-hashes -r requirements-docs.lock
	@touch $@

demo: setup  ## query, solve and fill of a plate with finite elements, 1 to 3 minutes
	$(BIN)/wrenchbook demo

serve: setup  ## the server and its solvers on 127.0.0.1:8000
	$(BIN)/wrenchbook serve

# The file that begins first is chosen by tests/conftest.py.
PYTEST = $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

test: $(VENV)/.installed-dev  ## the tests that are not marked slow
	$(PYTEST) -m "not slow"

test-slow: $(VENV)/.installed-dev $(VENV)/.installed-docs  ## the tests marked slow: many seeds, all platforms, whole sweeps
	$(PYTEST) -m slow

test-fast: $(VENV)/.installed-dev  ## tests of solver and tables: no server, browser or engine
	$(PYTEST) -m "not slow" tests/fea tests/surrogate

# branches of service, surrogate and fea that the tests take, by file
coverage: $(VENV)/.installed-dev
	mkdir -p build/coverage
	$(BIN)/python -m coverage run -m pytest -n $(WORKERS) --dist loadfile
	$(BIN)/python -m coverage combine -q
	$(BIN)/python -m coverage report

check: lint types arch $(VENV)/.installed-docs test  ## all checks of CI: lint, types, import rules, tests

# rules and format by ruff
lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# pyright
types: $(VENV)/.installed-dev
	$(BIN)/pyright

# import rules of pyproject.toml by import-linter
arch: $(VENV)/.installed-dev
	$(BIN)/lint-imports

# figures of the structure, and the files that each kind of request passes
house: $(VENV)/.installed-dev
	$(BIN)/python -m tests.house
	$(BIN)/python -m tests.walks

messages: $(VENV)/.installed-dev  ## print all error messages: where each appears, its text and what to do
	$(BIN)/python -m tests.messages

docs: $(VENV)/.installed-docs  ## the documentation as a site: build/docs/index.html
	$(BIN)/python -m sphinx -q -W --keep-going -c data/docs . build/docs

format: $(VENV)/.installed-dev  ## format the code by ruff
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

NAME ?=
bench: $(VENV)/.installed-dev  ## one benchmark: make bench NAME=kernel; without NAME their list
	@if [ -z "$(NAME)" ]; then $(BIN)/python -m tests.benchmarks; else \
		$(BIN)/python -m pytest -s -p no:cacheprovider --timeout 3600 tests/benchmarks/test_$(subst -,_,$(NAME)).py; fi

# 10,000 calls made up from the document, a million damaged files of each form: hours
fuzz: $(VENV)/.installed-dev
	WRENCHBOOK_FUZZ=10000 $(BIN)/python -m pytest tests/fuzz -s -p no:cacheprovider

# 60 faults put into the sources, one at a time: an hour; ONLY=ledger takes those of one part
mutants: $(VENV)/.installed-dev
	$(BIN)/python -m tests.mutants

# 200 times kill -9 of server, solver or both, and of imports: no job lost, no row twice
kills: $(VENV)/.installed-dev
	WRENCHBOOK_KILLS=200 $(BIN)/python -m pytest tests/service/test_kill.py \
		tests/service/test_import_killed.py -s --timeout 1200

# 5 seeds on each engine, 200 times kill -9 each: every accepted job has its row
soak: $(VENV)/.installed-dev
	WRENCHBOOK_SOAK_KILLS=200 WRENCHBOOK_SOAK_SEEDS=5 $(BIN)/python -m pytest \
		tests/acceptance/test_nothing_lost.py -s -p no:cacheprovider --timeout 3600

# a minute of a 1 kHz loop that records while its server is killed
soak-recording: $(VENV)/.installed-dev
	WRENCHBOOK_SOAK=60 $(BIN)/python -m pytest tests/service/test_recording_killed.py -s --timeout 900

validate: $(VENV)/.installed-dev  ## verify the solver by closed forms, published numbers and CalculiX
	$(BIN)/python -m tests.validation all

reference: $(VENV)/.installed-dev  ## write the references: component.toml, commands, calls and names
	$(BIN)/python -m wrenchbook.fea.bundle.reference
	$(BIN)/python -m data.docs.generated

paper: $(VENV)/.installed-dev  ## reproduce the coupling paper with MuJoCo: build/paper/paper.html
	$(BIN)/python -m data.paper build/paper

# the same, and write its tables into data/docs/reference/validation.md
validate-table: $(VENV)/.installed-dev
	$(BIN)/python -m tests.validation all --update data/docs/reference/validation.md

# same mesh as CalculiX: the slow cases, about ten minutes
validate-ccx: $(VENV)/.installed-dev
	$(BIN)/python -m pytest tests/benchmarks/test_fea_calculix.py -p no:cacheprovider --timeout 1800

# the pictures of README.md and the docs: the figure, a response, and the page in Chromium
pictures: $(VENV)/.installed-dev
	$(BIN)/python -m tests.pictures

wheels: setup  ## wheels of five platforms into dist/, compiled by ziglang
	$(PIP) install --require-hashes -r requirements-zig.lock
	for platform in $(PLATFORMS); do \
		KERNEL_PLATFORM=$$platform $(BIN)/python -m hatchling build -t wheel -d dist || exit 1; \
	done

# the wheel of this platform in an empty environment of each Python: demo, and a POSTed wrench
PYTHONS ?=
release-check: setup  ## install and try the wheel on Python 3.11 to 3.14
	rm -rf build/release
	$(BIN)/python -m hatchling build -t wheel -d build/release
	$(BIN)/python -P tests/release.py build/release/*.whl $(PYTHONS)

# data/docs/reference/licences.md, from the lock files and the installed packages
licences: $(VENV)/.installed-dev $(VENV)/.installed-docs
	$(BIN)/python -m data.docs.licences

image:  ## build the container image (compose.yaml adds TLS and Dask workers)
	docker build -t wrenchbook .

# write the lock files anew from pyproject.toml; the image installs the first and the third
lock: $(VENV)/.installed-dev
	$(BIN)/uv $(LOCK) -o requirements.lock
	$(BIN)/uv $(LOCK) --extra dev -c requirements.lock -o requirements-dev.lock
	$(BIN)/uv pip compile pyproject.toml $(LOCKED) --extra cluster \
		-c requirements.lock -c requirements-dev.lock -o requirements-cluster.lock
	$(BIN)/uv pip compile pyproject.toml $(LOCKED) --extra docs \
		-c requirements.lock -c requirements-dev.lock -o requirements-docs.lock
	echo "ziglang>=0.14" | $(BIN)/uv pip compile - $(LOCKED) -o requirements-zig.lock

clean:  ## remove .venv and caches
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis .import_linter_cache build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
