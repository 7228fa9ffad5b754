# The whole house in six words: reproduce, test, test-slow, check, lock, clean. Everything happens in .venv, built from the lock file.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
STAMP := $(VENV)/.installed
JOBS ?= auto

.PHONY: help reproduce test test-slow check lock clean
.DEFAULT_GOAL := help

help:  ## this list
	@grep -E '^[a-z-]+:.*##' Makefile | sed -E 's/:.*## /\t/' | expand -t 14

reproduce: $(STAMP)  ## write every figure and its data into figures/ (quick profile)
	$(RUN) -m experiments run --all --jobs $$(nproc)

test: $(STAMP)  ## run the tests but the slow ones, in parallel
	$(RUN) -m pytest -n $(JOBS) --dist worksteal -m "not slow"

test-slow: $(STAMP)  ## run the slow ones: kernels run to their laws, images, whole documents, kills
	$(RUN) -m pytest -n $(JOBS) --dist worksteal -m slow

check: $(STAMP)  ## style, types, and the floors
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/pyright
	$(VENV)/bin/lint-imports

lock:  ## renew requirements.lock from pyproject.toml (needs the command uv)
	uv pip compile --universal --python-version 3.11 --fork-strategy fewest --all-extras --generate-hashes \
	  --no-annotate --no-header --no-emit-index-url --no-emit-find-links --upgrade pyproject.toml -o requirements.lock

clean:  ## remove the environment and every cache
	rm -rf $(VENV) .cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "mcmc1d needs Python 3.11 or newer; name one: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	$(PYTHON) -m venv --clear $(VENV)
	$(RUN) -m pip install --disable-pip-version-check --quiet --require-hashes --no-deps -r requirements.lock
	$(RUN) -m pip install --disable-pip-version-check --quiet --no-deps --no-build-isolation --editable .
	@touch $@
