# Each target sets up .venv by itself, and lint the tools that check the web page; nothing but pip and npm goes to the network.
# PYTHON chooses the interpreter and VENV the folder it is set up in: make test PYTHON=python3.12 VENV=.venv-3.12
# TESTS are further arguments of pytest: make test TESTS=tests/maps

SHELL := /bin/bash
PYTHON ?= $(firstword $(foreach name,python3 python3.13 python3.12 python3.11 python3.14,\
	$(shell command -v $(name) >/dev/null && $(name) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $(name))))
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
PAGE_TOOLS := client/node_modules/.installed

.PHONY: demo serve test test-all lint format docs figures clean

demo: $(INSTALLED)
	$(BIN)/rholoc demo

serve: $(INSTALLED)
	$(BIN)/rholoc serve

# Four at a time on two cores, for browsers and servers are mostly waited for, and so one thread each for arithmetic; a
# module's tests stay together where they can, for they share what they are about.
# Where the environment forbids bytecode, each of hundreds of processes would compile every module anew.
test test-all figures: export OPENBLAS_NUM_THREADS = 1
test test-all figures: export OMP_NUM_THREADS = 1
test test-all: export PYTHONDONTWRITEBYTECODE =
# Databases wait for the disk longer than most tests compute: their files are kept in memory where 8 GB are free.
MEMORY := $(shell [ "$$(df --output=avail /dev/shm 2>/dev/null | tail -1)" -gt 8000000 ] 2>/dev/null && echo /dev/shm)
test test-all: export TMPDIR := $(or $(TMPDIR),$(MEMORY),/tmp)
PYTEST := $(BIN)/python -m pytest --dist worksteal

test: $(INSTALLED)
	$(PYTEST) -n 4 -m "not slow" $(TESTS)

test-all: test
	$(PYTEST) -n 4 -m slow $(TESTS)

# What the documents quote, measured again: it fails where something is worse. WRITE=1 puts the new figures there.
figures: $(INSTALLED)
	$(BIN)/python benchmarks/figures.py $(if $(WRITE),--write)

lint: $(INSTALLED) $(PAGE_TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	npm --prefix client run --silent lint
	npm --prefix client run --silent types
	npm --prefix client run --silent test

format: $(INSTALLED) $(PAGE_TOOLS)
	$(BIN)/python client/write_sync.py
	$(BIN)/python client/js/write_types.py
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	npm --prefix client run --silent format

docs: $(INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet -f docs/site/mkdocs.yml
	@echo "site/index.html"

clean:
	rm -rf $(VENV) .venv-* demo-output site client/node_modules

$(PAGE_TOOLS): client/package.json
	@command -v npm >/dev/null || { echo "The web page is checked with Node.js 20 or later, which was not found: install nodejs and npm."; exit 1; }
	npm --prefix client install --silent
	@touch $@

# `-e .` twice: pip before 23.3 does not see that rholoc[dev,docs] is the rholoc that the lab asks for.
$(INSTALLED): pyproject.toml client/pyproject.toml benchmarks/lab/pyproject.toml server/constraints.txt
	@$(if $(PYTHON),,echo "rholoc needs Python 3.11 or later; none was found. Install one, or name it: make PYTHON=/path/to/python3.12"; exit 1)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { echo "$(PYTHON) is not Python 3.11 or later. Name one that is: make PYTHON=/path/to/python3.12"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { echo "$(PYTHON) has no venv module: install it (Debian: apt install python3-venv)."; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c server/constraints.txt -e ./client -e ./benchmarks/lab -e . -e '.[server,dev,docs]'
	@touch $@
