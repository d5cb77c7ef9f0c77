# The two commands to know are `make demo` and `make test`; both do all the set-up. `make help` lists all.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Without tests and linters; the stamps are newer than what they were made of, so all is safe to repeat.
RUNTIME := $(VENV)/.installed
DEVELOP := $(VENV)/.installed-dev
# Into the environment, also where pip's settings of this user say otherwise.
PIP_INSTALL := PIP_USER=0 PIP_CONSTRAINT=constraints.txt PIP_BUILD_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check
# A worker that has nothing left to do takes over tests of another one.
# A worker more than there are cores: a fourth of the time tests wait for services and processes.
WORKERS := $(shell expr $$(getconf _NPROCESSORS_ONLN) + 1)
# A test that hangs fails after so many seconds, with what each thread was doing; none takes a tenth of it.
UNHUNG := -o faulthandler_timeout=400 -o faulthandler_exit_on_timeout=true
# An attack takes longer; where `make torture` is long, hours.
ATTACKED = -o faulthandler_timeout=$(if $(SHORT),1800,36000) -o faulthandler_exit_on_timeout=true
PYTEST := pytest -n $(WORKERS) --dist worksteal -q $(UNHUNG)
# The service syncs what it stores; in memory that takes no time, where tests would wait for a disk.
TEMPORARY = $(addprefix PYTEST_DEBUG_TEMPROOT=,$(shell tools/folder-in-memory))
FAST := tests/test_layout.py tests/test_references.py tests/unit tests/property tests/contract \
	tests/api/test_flow.py tests/api/test_keys.py tests/api/test_openapi.py tests/api/test_problems.py

.DEFAULT_GOAL := help
# With `make -j` too: two would install into one environment at the same time.
.NOTPARALLEL:
.PHONY: help demo test test-fast coverage torture soak install lint bench wheels constraints clean

help: ## Show this list.
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(RUNTIME) ## Record, post, build, localize; leaves the service running. ONCE=1 stops it, DRIVE=path uses your drive.
	$(BIN)/tensormap demo $(if $(ONCE),--once) $(if $(DRIVE),--drive '$(DRIVE)')

test: $(DEVELOP) ## Run all tests; those on recorded drives too if TENSORMAP_DATA names their folder.
	PYTHONDONTWRITEBYTECODE= $(TEMPORARY) $(BIN)/python -m $(PYTEST)

test-fast: $(DEVELOP) ## Run what takes a minute: unit, property, contract, a slice of api.
	PYTHONDONTWRITEBYTECODE= $(TEMPORARY) $(BIN)/python -m $(PYTEST) -m 'not slow' $(FAST)

coverage: $(DEVELOP) ## Run all tests, and fail where they run less of the code than pyproject.toml says.
	$(BIN)/coverage erase
	PYTHONDONTWRITEBYTECODE= $(TEMPORARY) $(BIN)/coverage run -m $(PYTEST)
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

# What `make torture` attacks with, unless the environment says otherwise; with SHORT=1 the tests' own
# sizes, which take six minutes. Starvation: seconds that each load is measured for, and how many
# WebSockets, tracks and builds one key asks for; seconds that vehicles are tracked before a restart.
ifndef SHORT
torture: export TENSORMAP_TORTURE_KILLS ?= 300
torture: export TENSORMAP_TORTURE_FAULTS ?= 0
torture: export TENSORMAP_TORTURE_INTERMITTENT ?= 500
torture: export TENSORMAP_TORTURE_FLIPS ?= 20000
torture: export TENSORMAP_TORTURE_IMPORTS ?= 5000
torture: export TENSORMAP_TORTURE_STORED ?= 500
torture: export TENSORMAP_TORTURE_HOSTILE ?= 100000
torture: export TENSORMAP_TORTURE_JSON ?= 100000
torture: export TENSORMAP_TORTURE_TRUNCATION_STEP ?= 1
torture: export TENSORMAP_TORTURE_INPUTS ?= 50000
torture: export TENSORMAP_TORTURE_STARVATION_S ?= 60
torture: export TENSORMAP_TORTURE_WEBSOCKETS ?= 5000
torture: export TENSORMAP_TORTURE_TRACKS ?= 1000
torture: export TENSORMAP_TORTURE_BUILDS ?= 300
torture: export TENSORMAP_TORTURE_TRACKED_S ?= 15
endif

torture: $(DEVELOP) ## Attack the service for hours: kills, disk faults, damage, starvation. SHORT=1 takes 6 minutes.
	$(TEMPORARY) $(BIN)/python -m pytest -n 2 --dist worksteal -q $(ATTACKED) -m 'not alone' tests/torture
	$(BIN)/python -m pytest -n 0 -q $(ATTACKED) -m 'alone and not soak' $(if $(SHORT),tests/torture/test_starvation.py tests/torture/test_track_restarts.py,tests/torture)

ifndef SHORT
soak: export TENSORMAP_SOAK_S ?= 1800
soak: export TENSORMAP_FLEET_S ?= 600
soak: export TENSORMAP_FLEET_P99_MS ?= 50
soak: export TENSORMAP_TORTURE_VEHICLES ?= 50
soak: export TENSORMAP_TORTURE_FLEET_SCANS ?= 1200
endif

# Short ones have no bar of time, and run side by side.
soak: $(DEVELOP) ## Use the service for half an hour, and drive 50 vehicles for ten minutes. SHORT=1 takes 2 minutes.
	$(BIN)/python -m pytest -n $(if $(SHORT),2,0) -q $(ATTACKED) -m soak tests/torture

install: $(DEVELOP) ## Install the service and all that its development needs into .venv.

lint: $(DEVELOP) ## Check style, types, spelling and the direction of imports.
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	# Its workers have three seconds to start, which a busy machine does not give them (status 2).
	$(BIN)/mypy || { test $$? -eq 2 && $(BIN)/mypy --num-workers 0; }
	$(BIN)/lint-imports
	$(BIN)/codespell

bench: $(DEVELOP) ## Measure against the bars and the committed ratios; writes benchmarks/RESULTS.md.
	$(BIN)/python -m benchmarks

wheels: | $(BIN)/python ## Build the wheels of the service and of its client in dist/.
	PIP_BUILD_CONSTRAINT=constraints.txt $(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist clients/python .

constraints: ## Renew constraints.txt with the newest versions that pyproject.toml allows.
	tools/make-constraints

clean: ## Remove what was installed and made.
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache .coverage*

# Without pip it is half made: that was killed.
$(BIN)/python: $(if $(wildcard $(BIN)/pip),,again)
	PYTHON='$(PYTHON)' tools/make-venv $(VENV)

again:

$(RUNTIME): pyproject.toml clients/python/pyproject.toml constraints.txt | $(BIN)/python
	@echo 'Installing TensorMap in $(VENV): a minute or two'
	$(PIP_INSTALL) --editable clients/python --editable '.[odometry,ros]'
	@touch $@

$(DEVELOP): pyproject.toml clients/python/pyproject.toml constraints.txt | $(BIN)/python
	@echo 'Installing TensorMap and what its tests need in $(VENV): two minutes or three'
	$(PIP_INSTALL) --editable clients/python --editable '.[dev]'
	@touch $@ $(RUNTIME)
