# Everything runs in .venv, made from requirements.lock on first use and again when lock or pyproject.toml change.
# Another interpreter: make setup PYTHON=python3.12. Arguments: make test PYTEST_ARGS="-k rows", make demo ARGS=...

PYTHON ?= python3
UV ?= uv
ARGS ?=
PYTEST_ARGS ?=
LOCK_ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

# the site reads the sources without importing them, so its tools live apart from the stack
DOCS_VENV := .venv-docs
DOCS_STAMP := $(DOCS_VENV)/.installed
DOCS_REQUIREMENTS = $(PYTHON) -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["docs"], sep="\n")'

# A sourced ROS workspace puts its own pinocchio and pytest plugins on this path, ahead of the locked ones.
unexport PYTHONPATH

.DEFAULT_GOAL := help
.PHONY: help setup demo test lint format bench docs docs-output lock clean distclean

help: ## This list.
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP) ## Make .venv from the lock, compile the kernels; nothing to do when it is up to date.

demo: $(STAMP) ## The first run: simulation, report and video.
	$(BIN)/safewbc demo $(ARGS)

test: $(STAMP) ## All tests.
	$(BIN)/python -m pytest $(PYTEST_ARGS)

lint: $(STAMP) ## Lint, format and types, of the tests too; changes nothing.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(STAMP) ## Format, and mend what lint can mend.
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs-output: $(STAMP) ## The tables of docs/output.md, made from the declarations.
	$(BIN)/python -m experiments.cli.output_page docs/output.md

bench: $(STAMP) ## Time of one tick, by stage.
	$(BIN)/safewbc bench tick $(ARGS)

docs: $(DOCS_STAMP) ## The documentation as a site in build/site; a warning is an error.
	NO_MKDOCS_2_WARNING=1 $(DOCS_VENV)/bin/mkdocs build --strict
	@echo "open build/site/index.html"

lock: ## Remake requirements.lock (needs uv); LOCK_ARGS=--upgrade for newer versions.
	$(UV) pip compile pyproject.toml --extra dev --universal --python-version 3.11 --fork-strategy fewest \
		--generate-hashes --no-header --no-emit-index-url --no-annotate --quiet --output-file requirements.lock $(LOCK_ARGS)

clean: ## Remove caches and builds; keeps .venv and runs.
	rm -rf build dist .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . \( -path ./$(VENV) -o -path ./$(DOCS_VENV) \) -prune -o -type d -name __pycache__ -exec rm -rf {} +

distclean: clean ## Remove .venv too.
	rm -rf $(VENV) $(DOCS_VENV)

$(DOCS_STAMP): pyproject.toml
	$(PYTHON) -m venv $(DOCS_VENV)
	$(DOCS_REQUIREMENTS) > $(DOCS_VENV)/requirements.txt
	$(DOCS_VENV)/bin/python -m pip install --disable-pip-version-check --quiet -r $(DOCS_VENV)/requirements.txt
	@touch $@

$(STAMP): requirements.lock pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) not found: safewbc needs Python 3.11 or newer" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("safewbc needs Python 3.11 or newer; $(PYTHON) is %d.%d. Name another: make setup PYTHON=python3.12" % sys.version_info[:2])'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --disable-pip-version-check --no-deps --no-build-isolation -e .
	@echo "compiling the kernels and checking what works here, about half a minute:"
	@$(BIN)/safewbc doctor || echo "set-up is done all the same; see above for what does not work" >&2
	@touch $@
