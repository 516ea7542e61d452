# `make demo` and `make test` need Python 3.11+ and make, nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := results/demo
SLOTS := 60000
PAPER_SLOTS := 180000
RUNS := 5000000
RUN := $(DEMO)/paper/mappo+slots=$(SLOTS)/seed-0
PAPER := $(DEMO)/paper/mappo-paper+slots=$(PAPER_SLOTS)/seed-0

.PHONY: help install check demo test fast lint types docs bench results audit fuzz faults lock clean

help:
	@echo "make demo    train MAPPO, and as the paper has it; evaluate both beside rules; draw the figures (about 4 minutes)"
	@echo "make check   before a push: lint, types, pages and the fast tests (some minutes)"
	@echo "make test    run all tests"
	@echo "make docs    the documentation site, into site/"
	@echo "make lint    ruff, and the prose of the pages; make types: mypy; make bench: speed, side by side; make results: the numbers of the pages"
	@echo "make audit   known vulnerabilities of the locked versions; make fuzz: a night of fuzzing"
	@echo "make faults  every fault at every write of every command and learner (hours); CI plays some of them"

install: $(VENV)/.compiled

$(VENV)/.installed: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "uavaou needs Python 3.11 or newer: make PYTHON=python3.11 ..."; exit 1; }
	@echo "Installing into $(VENV) (about two minutes) ..."
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/pip install --quiet --disable-pip-version-check --no-compile -r requirements.lock
	@$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.compiled: $(VENV)/.installed
	@echo "Compiling what every command needs (one to two minutes, once) ..."
	@$(BIN)/uavaou fly tiny --quiet --out $(VENV)/first-flight > /dev/null
	@$(BIN)/uavaou train tiny --slots 100 --set algorithm.critic_rollouts=0 --quiet --out $(VENV)/first-flight > /dev/null
	@touch $@

demo: install
	@rm -rf $(DEMO)
	@$(BIN)/uavaou train --scenario paper --slots $(SLOTS) --out $(DEMO)
	@$(BIN)/uavaou train --scenario paper --algorithm mappo-paper --slots $(PAPER_SLOTS) --out $(DEMO)
	@$(BIN)/uavaou eval $(RUN) $(PAPER) --policy any-map --policy local-greedy-parts --policy best-first --episodes 100
	@$(BIN)/uavaou plot figures $(RUN) $(PAPER) --out $(DEMO)/figures
	@$(BIN)/uavaou plot trajectories $(RUN) --out $(DEMO)/figures

# Bytecode is cached even where the environment forbids it: tests start many processes, and each would compile the package.
test fast: export PYTHONDONTWRITEBYTECODE =
fast: install
	$(BIN)/python -m pytest -q -n 2 --dist worksteal -m "not slow"

test: install
	$(BIN)/python -m pytest -q -n 3 --dist worksteal  # one more than cores: some wait for other processes
	@$(BIN)/python -m tests.browser  # the last line says whether the tests in a browser were left out

check: lint types docs fast

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m tests.prose

types: $(VENV)/.installed
	$(BIN)/mypy

# A broken link is an error.
docs: export NO_MKDOCS_2_WARNING = 1
docs: $(VENV)/.installed
	$(BIN)/mkdocs build --strict --quiet
	@echo "site/index.html"

bench: install
	$(BIN)/python -m benchmarks

# The numbers of README and other pages, from the committed tables.
results: install
	$(BIN)/python -m benchmarks.pages

# Known vulnerabilities of the locked versions, from the Python Packaging Advisory Database.
audit:
	rm -rf .audit-venv && $(PYTHON) -m venv .audit-venv
	.audit-venv/bin/pip install --quiet --disable-pip-version-check pip-audit
	.audit-venv/bin/pip-audit --strict --requirement requirements.lock --no-deps --disable-pip --progress-spinner off
	rm -rf .audit-venv

fuzz: install
	$(BIN)/pip install --quiet --disable-pip-version-check atheris
	$(BIN)/python tests/fuzz/loaders.py .fuzz-corpus $(RUNS)

# For some of them: make faults ONLY="tests/runs/test_faults.py -k qmix". To go on after a stop: add --tally FILE to ONLY.
faults: ONLY ?= tests/runs/test_faults.py tests/cli/test_faults.py tests/experiments/test_study_faults.py tests/experiments/test_tune_faults.py
faults: install
	$(BIN)/python -m pytest -q -n 2 --dist worksteal --exhaustive $(ONLY)

lock:
	rm -rf .lock-venv && $(PYTHON) -m venv .lock-venv
	.lock-venv/bin/pip install --quiet torch==2.13.0 hatchling
	.lock-venv/bin/pip install --quiet --no-build-isolation -e '.[dev]'
	{ echo "# Written by 'make lock': everything that pyproject.toml asks for, at the versions tested together."; \
	  .lock-venv/bin/pip freeze --exclude-editable | sed -E 's/^(torch==[0-9.]+).*/\1/; s/ @ .*//'; } > requirements.lock
	rm -rf .lock-venv

clean:
	rm -rf $(VENV) .audit-venv .fuzz-corpus .pytest_cache .mypy_cache .ruff_cache .hypothesis
