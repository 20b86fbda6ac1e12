# Unghost: `make` alone lists the targets. Works with GNU make 3.81 or newer.
.DEFAULT_GOAL := help
.NOTPARALLEL:
.DELETE_ON_ERROR:
.PHONY: help demo serve setup test test-postgres test-long check fmt lint types imports js unit browser bench experiment readers lock migrate docs screenshots clean

VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
PYTEST := $(BIN)/python -m pytest
# Even `make -n test` runs a recipe line that contains $(MAKE); this variable avoids that.
AGAIN := $(MAKE) --no-print-directory
# Includes the tests that are marked as long; the time-out allows for hours.
LONG := $(PYTEST) -m "" --capture=no --timeout=14400
# Any database of a server on which the tests may create and drop databases.
DATABASE ?= postgresql+psycopg://postgres@127.0.0.1:5432/postgres
# With it, each of the tests' hundreds of processes would compile all that it imports again.
unexport PYTHONDONTWRITEBYTECODE
CODE := app filter_core unghost migrations tests benchmarks tools setup.py
# Each of these files says that a step is done. The step is repeated if a file on which it
# depends is newer.
PROGRAM := $(VENV)/.program
DEVELOPMENT := $(VENV)/.development
CHROMIUM := $(VENV)/.chromium
# If CI is set, more programs are installed; that is another step.
SYSTEM := $(VENV)/.system$(if $(CI),-ci)

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' Makefile

demo: $(PROGRAM) ## Render a small street with ghosts, filter it and serve the review page
	$(BIN)/unghost demo $(ARGS)

serve: $(PROGRAM) ## Serve your own data folder (./unghost-data, or UNGHOST_DATA)
	$(BIN)/unghost serve $(ARGS)

setup: $(DEVELOPMENT) ## Install everything that development needs into .venv

ifdef ARGS
test: check
endif
test: $(CHROMIUM) $(SYSTEM) ## Set up, then run all checks and tests but the long ones, also in the browser
ifdef ARGS
	$(PYTEST) $(ARGS)
else
	@CHECK="$(AGAIN) check" $(BIN)/python -m tests.support.postgres_cluster \
		sh tools/run_tests.sh $(PYTEST)
endif

test-postgres: $(CHROMIUM) $(SYSTEM) ## The tests with PostgreSQL in place of SQLite's files (DATABASE)
	@UNGHOST_TEST_DATABASE=$(DATABASE) sh tools/run_tests.sh $(PYTEST) $(ARGS)

check: lint types imports js ## Every check that runs no Python test

fmt: $(DEVELOPMENT) ## Format the code and fix what ruff can fix
	$(BIN)/ruff format $(CODE)
	$(BIN)/ruff check --fix $(CODE)

lint: $(DEVELOPMENT) ## Style and format
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)

types: $(DEVELOPMENT) ## Static types, strict
	$(BIN)/mypy

imports: $(DEVELOPMENT) ## Which package may import which
	$(BIN)/lint-imports --no-cache

js: ## Types and tests of the page's modules (where Node is installed)
	@sh tools/check_page.sh

unit: $(DEVELOPMENT) ## The quick tests: no server, no browser
	$(PYTEST) tests/unit tests/property $(ARGS)

test-long: $(DEVELOPMENT) ## The long tests, for hours: kill servers, fuzz, compare with a model (docs/reliability.md)
	$(PYTEST) -m long $(ARGS)
	PROPERTY_EXAMPLES=100 $(LONG) tests/property $(ARGS)
	FAILPOINTS=all GARBAGE_ROUNDS=100 KILL_ROUNDS=50 $(LONG) tests/durability $(ARGS)
	KILL_ROUNDS=200 $(LONG) tests/hostile/test_kill_oracle.py $(ARGS)
	MACHINE_RUNS=500 $(LONG) tests/hostile/test_state_machine.py $(ARGS)
	OPENAPI_EXAMPLES=100 $(LONG) tests/hostile/test_openapi.py $(ARGS)
	FUZZ_EXAMPLES=5000 $(LONG) -k fuzz tests/hostile $(ARGS)

browser: $(CHROMIUM) ## The review page in a real Chromium
	$(PYTEST) tests/browser $(ARGS)

bench: $(DEVELOPMENT) ## Run all benchmarks (docs/benchmarks.md)
	@for bench in $(notdir $(basename $(wildcard benchmarks/bench_*.py))); do \
		echo "== $$bench"; $(BIN)/python -m benchmarks.$$bench $(ARGS) || exit 1; done

# What it has rendered and trained stays in this folder, and is not done again.
EXPERIMENT ?= benchmarks/.data/experiment

experiment: $(DEVELOPMENT) $(VENV)/.train ## Train on raw and on cleaned labels, for hours (docs/experiment.md; ARGS=--small: minutes)
	$(BIN)/python -m benchmarks.experiment $(EXPERIMENT) --python $(VENV)/train/bin/python $(ARGS)

# In an environment of its own: torch is larger than everything else together.
$(VENV)/.train: | $(DEVELOPMENT)
	$(BIN)/python -m venv $(VENV)/train
	$(VENV)/train/bin/pip install --quiet torch torchvision opencv-python-headless
	@touch $@

readers: $(DEVELOPMENT) $(VENV)/.readers ## Read exports with Ultralytics, Datumaro, Label Studio and others (downloads 2 GB)
	$(VENV)/readers/bin/python -m tools.check_readers $(CURDIR)/$(BIN)/python

$(VENV)/.readers: | $(DEVELOPMENT)
	$(BIN)/python -m venv $(VENV)/readers
	$(VENV)/readers/bin/pip install --quiet ultralytics supervision datumaro label-studio-sdk fiftyone
	@touch $@

lock: $(VENV)/.uv ## Lock the newest versions of other packages, with their hashes (CONTRIBUTING.md)
	$(LOCK) --output-file requirements.lock
	$(LOCK) --constraint requirements.lock --output-file requirements-cluster.lock \
		--extra cluster --extra parquet --extra postgres --extra s3

LOCK := $(VENV)/uv/bin/uv pip compile pyproject.toml --quiet --upgrade --universal --python-version 3.10 \
	--generate-hashes --no-emit-index-url --no-annotate --custom-compile-command "make lock"

$(VENV)/.uv: | $(VENV)/pyvenv.cfg
	$(BIN)/python -m venv $(VENV)/uv
	$(VENV)/uv/bin/pip install --quiet uv
	@touch $@

migrate: $(PROGRAM) ## Bring the data folder's database to the newest schema
	$(BIN)/python -m tools.migrate

docs: $(DEVELOPMENT) ## Generate the tables of the documentation from the code, and check the rest
	$(BIN)/python -m tools.reference
	$(PYTEST) tests/docs $(ARGS)

screenshots: $(CHROMIUM) ## Take the screenshots of the review page again, from a new demo
	$(BIN)/python -m tools.screenshots $(ARGS)

clean: ## Remove what make made; the data folders stay
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(SYSTEM): $(DEVELOPMENT) tools/ensure_programs.py
	$(BIN)/python -m tools.ensure_programs
	@touch $@

# Without prerequisites, and only after `|` in those of others: an existing environment is not
# replaced because a script has changed.
$(VENV)/pyvenv.cfg:
	@sh tools/make_venv.sh $(VENV)

$(PROGRAM): pyproject.toml setup.py requirements.lock | $(VENV)/pyvenv.cfg
	@echo "Installing Unghost into $(VENV) (the first time takes a minute) ..."
	@$(PIP) install --require-hashes --requirement requirements.lock
	@$(PIP) install --no-deps --editable .
	@$(BIN)/python -m compileall -q -j 0 app filter_core unghost
	@touch $@

# A recent pip chooses versions faster. Modules are not compiled here: most are never imported,
# and Python compiles the others when they are.
$(DEVELOPMENT): pyproject.toml setup.py | $(VENV)/pyvenv.cfg
	@echo "Installing Unghost and its development tools into $(VENV) ..."
	@$(PIP) install --upgrade pip
	@$(PIP) install --no-compile --editable '.[dev]'
	@touch $@ $(PROGRAM)

$(CHROMIUM): $(DEVELOPMENT) tools/ensure_chromium.py tools/ensure_programs.py
	$(BIN)/python -m tools.ensure_chromium
	@touch $@
