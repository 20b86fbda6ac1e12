# Unghost: `make` alone lists the targets. Works with GNU make 3.81 or newer.
.DEFAULT_GOAL := help
.NOTPARALLEL:
.DELETE_ON_ERROR:
.PHONY: help demo serve setup test test-postgres test-long check fmt lint types imports js unit browser bench readers migrate docs screenshots clean

VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
PYTEST := $(BIN)/python -m pytest
# A line with the variable itself would be run by `make -n test` as well.
AGAIN := $(MAKE) --no-print-directory
# Those that are marked as long, too, and no time-out that a few hours would meet.
LONG := $(PYTEST) -m "" --capture=no --timeout=14400
# A database of a server on which the tests make and drop others.
DATABASE ?= postgresql+psycopg://postgres@127.0.0.1:5432/postgres
# Hundreds of processes would compile all that they import, each anew.
unexport PYTHONDONTWRITEBYTECODE
CODE := app filter_core unghost migrations tests benchmarks tools setup.py
# Each stamp says that a step is done; touching what it depends on does it again.
PROGRAM := $(VENV)/.program
DEVELOPMENT := $(VENV)/.development
CHROMIUM := $(VENV)/.chromium
# More is installed where CI is set.
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
test: $(CHROMIUM) $(SYSTEM) ## Set up and pass the checks and the tests, the browser's too
ifdef ARGS
	$(PYTEST) $(ARGS)
else
	@CHECK="$(AGAIN) check" $(BIN)/python -m tests.support.postgres_cluster \
		sh tools/run_tests.sh $(PYTEST)
endif

test-postgres: $(CHROMIUM) $(SYSTEM) ## The tests with PostgreSQL in place of SQLite's files (DATABASE)
	@UNGHOST_TEST_DATABASE=$(DATABASE) sh tools/run_tests.sh $(PYTEST) $(ARGS)

check: lint types imports js ## Every check that runs no Python test

fmt: $(DEVELOPMENT) ## Format the code and mend what can be mended by a machine
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

test-long: $(DEVELOPMENT) ## Kill, fuzz and compare with a model for hours; docs/reliability.md has the figures
	$(PYTEST) -m long $(ARGS)
	PROPERTY_EXAMPLES=100 $(LONG) tests/property $(ARGS)
	FAILPOINTS=all GARBAGE_ROUNDS=100 KILL_ROUNDS=50 $(LONG) tests/durability $(ARGS)
	KILL_ROUNDS=200 $(LONG) tests/hostile/test_kill_oracle.py $(ARGS)
	MACHINE_RUNS=500 $(LONG) tests/hostile/test_state_machine.py $(ARGS)
	OPENAPI_EXAMPLES=100 $(LONG) tests/hostile/test_openapi.py $(ARGS)
	FUZZ_EXAMPLES=5000 $(LONG) -k fuzz tests/hostile $(ARGS)

browser: $(CHROMIUM) ## The review page in a real Chromium
	$(PYTEST) tests/browser $(ARGS)

bench: $(DEVELOPMENT) ## Measure; the figures of docs/benchmarks.md
	@for bench in $(notdir $(basename $(wildcard benchmarks/bench_*.py))); do \
		echo "== $$bench"; $(BIN)/python -m benchmarks.$$bench $(ARGS) || exit 1; done

readers: $(DEVELOPMENT) $(VENV)/.readers ## Read exports with Ultralytics, supervision and Datumaro (downloads 2 GB)
	$(VENV)/readers/bin/python -m tools.check_readers $(CURDIR)/$(BIN)/python

$(VENV)/.readers: | $(DEVELOPMENT)
	$(BIN)/python -m venv $(VENV)/readers
	$(VENV)/readers/bin/pip install --quiet ultralytics supervision datumaro
	@touch $@

migrate: $(PROGRAM) ## Bring the data folder's database to the newest schema
	$(BIN)/python -m tools.migrate

docs: $(DEVELOPMENT) ## Write what the documentation repeats of the code, and check the rest
	$(BIN)/python -m tools.reference
	$(PYTEST) tests/docs $(ARGS)

screenshots: $(CHROMIUM) ## Take the pictures of the review page anew, from a demo of their own
	$(BIN)/python -m tools.screenshots $(ARGS)

clean: ## Remove what make made; the data folders stay
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(SYSTEM): $(DEVELOPMENT) tools/ensure_programs.py
	$(BIN)/python -m tools.ensure_programs
	@touch $@

# Order-only: an environment that is there is never thrown away because a script changed.
$(VENV)/pyvenv.cfg:
	@sh tools/make_venv.sh $(VENV)

$(PROGRAM): pyproject.toml setup.py | $(VENV)/pyvenv.cfg
	@echo "Installing Unghost into $(VENV) (the first time takes a minute) ..."
	@$(PIP) install --editable .
	@touch $@

# A recent pip takes less time to choose versions. Python compiles the modules that
# are imported: most of these never are.
$(DEVELOPMENT): pyproject.toml setup.py | $(VENV)/pyvenv.cfg
	@echo "Installing Unghost and its development tools into $(VENV) ..."
	@$(PIP) install --upgrade pip
	@$(PIP) install --no-compile --editable '.[dev]'
	@touch $@ $(PROGRAM)

$(CHROMIUM): $(DEVELOPMENT) tools/ensure_chromium.py tools/ensure_programs.py
	$(BIN)/python -m tools.ensure_chromium
	@touch $@
