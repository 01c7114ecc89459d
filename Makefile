# Needs Python 3.11 or newer, git and make. Everything is installed into .venv.
#   make test PYTHON=python3.11    another interpreter
#   make train ARGS="--help"       arguments for train.py
#   make test TORCH_INDEX=         take torch from pip's usual indexes only

PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip --disable-pip-version-check
ARGS ?=

TORCH := $(shell sed -n 's/^\(torch==[^ ]*\).*/\1/p' constraints.txt)
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

TRAIN_READY := $(VENV)/.installed-train
TEST_READY := $(VENV)/.installed-test

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help train test lint docs dist bench clients clean

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1\t\2/p' $(firstword $(MAKEFILE_LIST))

train: $(TRAIN_READY)  ## install what training needs, then run train.py $(ARGS)
	$(PY) train.py $(ARGS)

test: lint docs  ## lint, check the import contracts, build the site, run the tests
	SDL_VIDEODRIVER=dummy SDL_AUDIODRIVER=dummy MPLBACKEND=Agg $(PY) -m pytest -q $(ARGS)

lint: $(TEST_READY)  ## ruff and import-linter only
	$(VENV)/bin/ruff check .
	$(VENV)/bin/lint-imports

docs: $(TEST_READY)  ## build the documentation into site/; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict

dist: $(TEST_READY)  ## wheel and sdist into dist/
	$(PIP) install -q -c constraints.txt build
	$(PY) -m build

bench: $(TRAIN_READY)  ## run the studies of benchmarks/ and renew their pages in docs/
	$(PY) benchmarks/identification.py $(ARGS)
	$(PY) benchmarks/throughput.py $(ARGS)

clients: $(TRAIN_READY)  ## smoke runs in rl-zoo3, RLlib, Minari and Ray, each in an environment of its own
	$(PY) -m benchmarks.clients $(ARGS)

clean:  ## remove .venv, build products and caches; runs/ stays
	rm -rf $(VENV) build dist site *.egg-info .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(PY):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "Python 3.11 or newer is needed; name one with PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# torch goes first and alone. On Linux PyPI's build brings several GB of CUDA libraries, PyTorch's own index has
# the CPU build. Where that index cannot be reached, the install below takes torch from pip's usual indexes.
$(TRAIN_READY): pyproject.toml constraints.txt | $(PY)
	@test -z "$(TORCH_INDEX)" \
	  || $(PIP) install -q --no-deps --retries 1 --timeout 15 --index-url $(TORCH_INDEX) $(TORCH) \
	  || echo "No CPU build of torch from $(TORCH_INDEX); going on with pip's usual indexes."
	$(PIP) install -q -c constraints.txt -e '.[train]'
	@touch $@

$(TEST_READY): $(TRAIN_READY)
	$(PIP) install -q -c constraints.txt -e '.[train,recurrent,test,docs]'
	@touch $@
