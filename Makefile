# Needs Python 3.11 or newer, git and make (on Windows: Git Bash). Everything is installed into .venv.
#   make test PYTHON=python3.13    another interpreter
#   make test JOBS=8               more test processes
#   make test ARGS="-m 'not documents and not benchmarks and not slow'"    only the quick tests
#   make train ARGS="--help"       arguments for train.py
#   make test TORCH_INDEX=         take torch from pip's usual indexes only

VENV := .venv
ifeq ($(OS),Windows_NT)
PYTHON ?= python
BIN := $(VENV)/Scripts
PY := $(BIN)/python.exe
else
PYTHON ?= python3
BIN := $(VENV)/bin
PY := $(BIN)/python
endif
# Bytecode is written when a module is first imported: most of what torch and scipy bring never is.
PIP := $(PY) -m pip --disable-pip-version-check
unexport PYTHONDONTWRITEBYTECODE
ARGS ?=
JOBS ?= 2

TORCH := $(shell sed -n 's/^\(torch==[^ ]*\).*/\1/p' constraints.txt)
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

TORCH_READY := $(VENV)/.installed-torch
BASE_READY := $(VENV)/.installed
TRAIN_READY := $(VENV)/.installed-train
TEST_READY := $(VENV)/.installed-test
DOCS_READY := $(VENV)/.installed-docs
KERNELS_READY := $(VENV)/.compiled

.DEFAULT_GOAL := help
.PHONY: help train test checks lint types format oldest environment kernels docs serve dist results clean

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1\t\2/p' $(firstword $(MAKEFILE_LIST))

# Compiling the kernels takes one core for a while; the rest of the installation, lint and site the other.
train: $(BASE_READY)  ## install what training needs, then run train.py $(ARGS)
	$(MAKE) -j 2 $(KERNELS_READY) $(TRAIN_READY)
	$(PY) train.py $(ARGS)

test: $(BASE_READY)  ## lint, build the site, compile the kernels, run the tests
	$(MAKE) -j 2 $(KERNELS_READY) checks
	$(PY) -m pytest -q -n $(JOBS) --dist worksteal $(ARGS)

checks: $(TEST_READY)
	$(MAKE) -j 2 lint docs

lint: $(TEST_READY)  ## ruff, import contracts, types, workflow files
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows $(wildcard .github/workflows/*.yml)

format: $(TEST_READY)  ## let ruff format the code and repair what it can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Pyright is a program of Node; it does not follow an editable install, hence PYTHONPATH.
types: $(TEST_READY)  ## whether every public name of soil_env has a complete type; needs npx
	PATH="$(CURDIR)/$(BIN):$$PATH" PYTHONPATH="$(CURDIR)" npx --yes pyright@1.1.414 --ignoreexternal --verifytypes soil_env

# Without torch, so without the agents; an environment of its own.
OLDEST := .venv-oldest
oldest:  ## the quick tests of soil_env with the oldest versions that pyproject.toml allows
	$(PYTHON) -m venv $(OLDEST)
	$(OLDEST)/bin/python -m pip install -q uv
	$(OLDEST)/bin/uv pip install -q --python $(OLDEST) --resolution lowest-direct -e ".[logs,test,tune]"
	$(OLDEST)/bin/python -m soil_env.cli warmup
	$(OLDEST)/bin/python -m pytest -q -n $(JOBS) --dist worksteal -m "not documents and not benchmarks and not slow" \
		--ignore=tests/agents --ignore=tests/benchmarks --ignore=tests/project $(ARGS)

environment: $(TEST_READY)  ## only .venv with the pinned versions, for tests one by one

kernels: $(BASE_READY)  ## compile what most tests use, once for all test processes
	$(PY) -m soil_env.cli warmup
	@touch $(KERNELS_READY)

docs: $(DOCS_READY)  ## execute the notebooks, build the documentation into site/; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

serve: docs  ## build the site and show it at http://127.0.0.1:8000, without network
	$(PY) -m http.server --bind 127.0.0.1 --directory site 8000

dist: $(TEST_READY)  ## wheel and sdist into dist/
	$(PIP) install -q --no-compile -c constraints.txt build
	$(PY) -m build

# QUICK=1: the same commands with few courses, drives and tables, into runs/quick.
# What goes on where it was interrupted works in a folder named by the code: else it would find the results of other
# code, those of docs/results among them, and measure nothing.
RESULTS := $(if $(QUICK),runs/quick,docs/results)
MADE = runs/$(if $(QUICK),quick_)results_$(shell $(PY) -c 'from soil_env_agents.cells import code_version as v; print(v())')
results: $(TEST_READY)  ## make the tables of docs/results anew, in hours; QUICK=1: in minutes, into runs/quick, and compared with docs/results
	$(eval MADE := $(MADE))
	$(BIN)/soil-env study --config configs/study_default_policy.yaml --out $(MADE)/agents $(if $(QUICK),--courses 100 --tuning_courses 100)
	mkdir -p $(RESULTS)
	sed -e 's/^# .*/# Agents and rules/' -e '/study.png/d' $(MADE)/agents/study.md > $(RESULTS)/agents.md
	$(PY) -m benchmarks.gravity --out $(RESULTS)
	$(PY) -m benchmarks.rigs --out $(RESULTS)
	$(PY) -m benchmarks.prediction --out $(RESULTS)
	$(if $(QUICK),,$(PY) -m benchmarks.next_runs --out $(MADE)/next_runs && cp $(MADE)/next_runs/next_runs.* $(RESULTS))
	$(if $(QUICK),,$(PY) -m benchmarks.continuum loop --out $(MADE)/continuum && cp $(MADE)/continuum/continuum.* $(RESULTS))
	$(PY) -m benchmarks.identification --out $(MADE)/identification --courses $(if $(QUICK),30,60) && cp $(MADE)/identification/identification.* $(RESULTS)
	$(PY) -m benchmarks.robustness --out $(RESULTS) $(if $(QUICK),--courses 20)
	$(PY) -m benchmarks.discovery run --held-out --entrant workflow --seed 20261129 --limit $(if $(QUICK),12,240) --out $(MADE)/discovery --publish $(RESULTS)
	$(PY) -m benchmarks.throughput --out $(RESULTS) $(if $(QUICK),--smoke)
	$(if $(QUICK),$(PY) -m pytest -q tests/project/test_results.py)

clean:  ## remove .venv, build products and caches; runs/ stays
	rm -rf $(VENV) $(OLDEST) build dist site *.egg-info .pytest_cache .ruff_cache .mypy_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(PY):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "Python 3.11 or newer is needed; name one with PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# torch goes first and alone. On Linux PyPI's build brings several GB of CUDA libraries, PyTorch's own index has
# the CPU build. Where that index cannot be reached, the install below takes torch from pip's usual indexes.
$(TORCH_READY): constraints.txt | $(PY)
	@test -z "$(TORCH_INDEX)" \
	  || $(PIP) install -q --no-compile --no-deps --retries 1 --timeout 15 --index-url $(TORCH_INDEX) $(TORCH) \
	  || echo "No CPU build of torch from $(TORCH_INDEX); going on with pip's usual indexes."
	@touch $@

# Kernels that nothing has changed since are not loaded again only to see that they are there.
$(KERNELS_READY): pyproject.toml constraints.txt $(shell find soil_env -name '*.py') | $(BASE_READY)
	$(MAKE) kernels

# What soil_env itself needs: enough to compile the kernels while the rest is installed.
$(BASE_READY): pyproject.toml constraints.txt | $(PY)
	$(PIP) install -q --no-compile -c constraints.txt -e .
	@touch $@

$(TRAIN_READY): pyproject.toml constraints.txt $(BASE_READY) $(TORCH_READY)
	$(PIP) install -q --no-compile -c constraints.txt -e '.[train]'
	@touch $@

$(TEST_READY): pyproject.toml constraints.txt $(BASE_READY) $(TORCH_READY)
	$(PIP) install -q --no-compile -c constraints.txt -e '.[train,export,logs,test,docs]'
	@touch $(BASE_READY) $(TRAIN_READY) $(DOCS_READY) $@

# The pages are made from the sources, none of which is imported; the notebooks, executed apart, need torch.
$(DOCS_READY): pyproject.toml constraints.txt $(BASE_READY) $(TORCH_READY)
	$(PIP) install -q --no-compile -c constraints.txt -e '.[train,docs]'
	@touch $@
