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

# Every target that `help` lists.
.PHONY: $(shell sed -n 's/^\([a-z-]*\):.*## .*/\1/p' Makefile)

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  %-15s %s\n", $$1, $$2}'

setup: $(VENV)/.installed  ## make .venv and install what the program runs with

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "wrenchbook needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(BIN)/python requirements.lock pyproject.toml
	$(PIP) install --require-hashes -r requirements.lock
	@command -v $${CC:-cc} >/dev/null || $(PIP) install --require-hashes -r requirements-zig.lock
	$(PIP) install --no-deps --no-build-isolation -e .
	@# Links that show type checker and import-linter the packages as they are imported.
	@mkdir -p $(VENV)/face/wrenchbook
	@ln -sfn ../../../wrenchbook.py $(VENV)/face/wrenchbook/__init__.py
	@for room in fea surrogate service; do ln -sfn ../../../$$room $(VENV)/face/wrenchbook/$$room; done
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed requirements-dev.lock
	$(PIP) install --require-hashes -r requirements-dev.lock
	@touch $@

demo: setup  ## the main job, end to end, on real finite elements
	$(BIN)/wrenchbook demo

serve: setup  ## the API and the embedded solver on 127.0.0.1:8000
	$(BIN)/wrenchbook serve

test: $(VENV)/.installed-dev  ## the test suite
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

check: lint types arch test  ## all that CI asks: lint, types, import rules, tests

lint: $(VENV)/.installed-dev  ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-dev  ## pyright
	$(BIN)/pyright

arch: $(VENV)/.installed-dev  ## import-linter: who may import what
	cd $(VENV)/face && ../bin/lint-imports --config ../../pyproject.toml

house: $(VENV)/.installed-dev  ## files a room, circles, lengths, duplicates, what docstrings state
	$(BIN)/python -m tests.house

format: $(VENV)/.installed-dev  ## let ruff lay out the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.installed-dev  ## timings as ratios, side by side in one run
	$(BIN)/python -m pytest tests/benchmarks -s -p no:cacheprovider \
		--ignore tests/benchmarks/test_fill.py --ignore tests/benchmarks/test_scene.py \
		--ignore tests/benchmarks/test_loop.py --ignore tests/benchmarks/test_mesh_error.py \
		--ignore tests/benchmarks/test_surface_error.py \
		--ignore tests/benchmarks/test_check_cost.py --ignore tests/benchmarks/test_fea_order.py \
		--ignore tests/benchmarks/test_import_rate.py --ignore tests/benchmarks/test_connections.py \
		--ignore tests/benchmarks/test_fea_speed.py --ignore tests/benchmarks/test_fea_calculix.py

bench-fea: $(VENV)/.installed-dev  ## wall time of the solver beside CalculiX, in turn
	$(BIN)/python -m pytest tests/benchmarks/test_fea_speed.py tests/benchmarks/test_fea_order.py -s -p no:cacheprovider --timeout 1800

bench-mesh-error: $(VENV)/.installed-dev  ## the mesh's share of the bars beside two refinements
	$(BIN)/python -m pytest tests/benchmarks/test_mesh_error.py -s -p no:cacheprovider --timeout 1800

bench-surface-error: $(VENV)/.installed-dev  ## the same share of a surface's bars, node by node
	$(BIN)/python -m pytest tests/benchmarks/test_surface_error.py -s -p no:cacheprovider --timeout 1800

bench-check: $(VENV)/.installed-dev  ## time and memory as the check tells them, beside a solve
	$(BIN)/python -m pytest tests/benchmarks/test_check_cost.py -s -p no:cacheprovider --timeout 1800

bench-stability: $(VENV)/.installed-dev  ## extreme parts and loads: each right or refused by name
	$(BIN)/python -m pytest tests/benchmarks/test_stability.py -s -p no:cacheprovider

bench-surrogate: $(VENV)/.installed-dev  ## builds of tables beside scipy's bare triangulations
	$(BIN)/python -m pytest tests/benchmarks/test_surrogate_speed.py -s -p no:cacheprovider

bench-kernel: $(VENV)/.installed-dev  ## single answers and batches of the kernel beside scipy's own calls
	$(BIN)/python -m pytest tests/benchmarks/test_kernel_speed.py -s -p no:cacheprovider

bench-live: $(VENV)/.installed-dev  ## imports and new rows of a real server: seconds and memory
	$(BIN)/python -m pytest tests/benchmarks/test_live_tables.py -s -p no:cacheprovider --timeout 1800

bench-start: $(VENV)/.installed-dev  ## a server's start on built tables: seconds and memory
	$(BIN)/python -m pytest tests/benchmarks/test_start.py -s -p no:cacheprovider --timeout 1800

bench-import: $(VENV)/.installed-dev  ## 100,000 rows until they answer, a million until acknowledged: seconds, memory, waits
	$(BIN)/python -m pytest tests/benchmarks/test_import_rate.py -s -p no:cacheprovider --timeout 1800

bench-fill: $(VENV)/.installed-dev  ## error by the number of solves: fill, griddata and SMT's kriging
	$(BIN)/python -m pytest tests/benchmarks/test_fill.py -s -p no:cacheprovider

bench-loop: $(VENV)/.installed-dev  ## a MuJoCo loop with a mount against real time, over HTTP and downloaded
	$(BIN)/python -m pytest tests/benchmarks/test_loop.py -s -p no:cacheprovider

bench-scene: $(VENV)/.installed-dev  ## a planar scene beside the whole component: solves, build time, memory
	$(BIN)/python -m pytest tests/benchmarks/test_scene.py -s -p no:cacheprovider

bench-calibration: $(VENV)/.installed-dev  ## error bars against true errors, fresh seeds; what each setting does
	$(BIN)/python -m pytest tests/benchmarks/test_calibration.py -s -p no:cacheprovider

bench-methods: $(VENV)/.installed-dev  ## RMS of each method, SMT's kriging and scipy's RBF at equal numbers of solves
	$(BIN)/python -m pytest tests/benchmarks/test_methods.py -s -p no:cacheprovider

bench-solvers: $(VENV)/.installed-dev  ## a fill of 60: a fresh process a solve beside solvers that live
	$(BIN)/python -m pytest tests/benchmarks/test_solver_rate.py -s -p no:cacheprovider --timeout 1200

bench-dispatcher: $(VENV)/.installed-dev  ## jobs a second of one dispatcher with 1,000 simulated workers
	$(BIN)/python -m pytest tests/benchmarks/test_dispatcher_rate.py -s -p no:cacheprovider

bench-fmu: $(VENV)/.installed-dev  ## evaluations a second of an exported FMU, from C
	$(BIN)/python -m pytest tests/benchmarks/test_fmu_rate.py -s -p no:cacheprovider

bench-cluster: $(VENV)/.installed-dev  ## Dask: two workers beside one, jobs of 10 ms a second, bytes a solve
	$(BIN)/python -m pytest tests/benchmarks/test_cluster.py -s -p no:cacheprovider

bench-processes: $(VENV)/.installed-dev  ## a server of two processes beside one of one: queries, builds, memory
	$(VENV)/bin/python -m pytest -q -s tests/benchmarks/test_processes.py

bench-clients: $(VENV)/.installed-dev  ## a minute of eight client processes: each answer checked, p99 over idle
	$(BIN)/python -m pytest -q -s tests/benchmarks/test_clients.py --timeout 300

bench-http: $(VENV)/.installed-dev  ## requests a second beside an echo, the client beside http.client, answers during builds
	$(BIN)/python -m pytest tests/benchmarks/test_http_rate.py tests/benchmarks/test_live_tables.py -s -p no:cacheprovider

bench-connections: $(VENV)/.installed-dev  ## the main call beside 200 idle, 500 slow and 2,000 polling connections
	$(BIN)/python -m pytest tests/benchmarks/test_connections.py -s -p no:cacheprovider

fuzz: $(VENV)/.installed-dev  ## 10,000 calls made up from the document, a million damaged files of each form: hours
	WRENCHBOOK_FUZZ=10000 $(BIN)/python -m pytest tests/fuzz -s -p no:cacheprovider

kills: $(VENV)/.installed-dev  ## 200 times kill -9 of server, solver or both: no job lost, no row twice
	WRENCHBOOK_KILLS=200 $(BIN)/python -m pytest tests/service/test_kill.py -s --timeout 1200

soak: $(VENV)/.installed-dev  ## 5 seeds on each engine, 200 times kill -9 each: every accepted job has its row
	WRENCHBOOK_SOAK_KILLS=200 WRENCHBOOK_SOAK_SEEDS=5 $(BIN)/python -m pytest \
		tests/acceptance/test_nothing_lost.py -s -p no:cacheprovider --timeout 3600

soak-recording: $(VENV)/.installed-dev  ## a minute of a 1 kHz loop that records while its server is killed
	WRENCHBOOK_SOAK=60 $(BIN)/python -m pytest tests/service/test_recording_killed.py -s --timeout 900

validate: setup  ## verify the solver: closed forms, published numbers, CalculiX
	$(BIN)/wrenchbook validate all

validate-table: setup  ## the same, and write its tables into fea/README.md
	$(BIN)/python -m wrenchbook.fea.validation all --update fea/README.md

validate-ccx: $(VENV)/.installed-dev  ## same mesh as CalculiX: the slow cases, about ten minutes
	$(BIN)/python -m pytest tests/benchmarks/test_fea_calculix.py -p no:cacheprovider --timeout 1800

pictures: $(VENV)/.installed-dev  ## the pictures of README.md: the figure, and the page in Chromium
	$(BIN)/python -m tests.pictures

wheels: setup  ## wheels of all five platforms, compiled here by ziglang, into dist/
	$(PIP) install --require-hashes -r requirements-zig.lock
	for platform in $(PLATFORMS); do \
		KERNEL_PLATFORM=$$platform $(BIN)/python -m hatchling build -t wheel -d dist || exit 1; \
	done

image:  ## the container image
	docker build -t wrenchbook .

lock: $(VENV)/.installed-dev  ## write both lock files anew from pyproject.toml
	$(BIN)/uv $(LOCK) -o requirements.lock
	$(BIN)/uv $(LOCK) --extra dev -c requirements.lock -o requirements-dev.lock
	echo "ziglang>=0.14" | $(BIN)/uv pip compile - $(LOCKED) -o requirements-zig.lock

clean:  ## remove .venv and caches
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis .import_linter_cache build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
