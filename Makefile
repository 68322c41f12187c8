# SPDX-License-Identifier: GPL-3.0-or-later
# `make help` lists what there is. On a fresh machine with Python 3.11: `make demo`, `make test`.
SHELL := /bin/bash
PYTHON ?=
VENV := .venv
STAMP := $(VENV)/.made-by-make
DATA := $(or $(FEMORS_DATA),../shared/data)
BLENDER_DIR := $(or $(FEMORS_BLENDER_DIR),$(HOME)/.cache/femors/blender)
BENCH_VENV := $(HOME)/.cache/femors/bench-$(shell cksum < requirements/bench.txt | cut -d' ' -f1)
FETCH := ../shared/tools/get-blender.sh

DOCS_VENV := $(HOME)/.cache/femors/docs-$(shell cksum < requirements/docs.txt | cut -d' ' -f1)

.PHONY: help setup demo docs test test-package lint lock package format bench bench-quick blender clean distclean
.DEFAULT_GOAL := help

help: ## what there is to make
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1|\2/p' $(MAKEFILE_LIST) | column -t -s '|' 2>/dev/null \
	  || sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1: \2/p' $(MAKEFILE_LIST)
	@echo "The command line: $(VENV)/bin/python -m femors_addon --help"

setup: $(STAMP) ## .venv with Blender as a Python module (bpy), NumPy, SciPy and the test tools

$(STAMP): requirements/venv.txt requirements/make_venv.sh
	@requirements/make_venv.sh "$(VENV)" "$(PYTHON)"
	@touch $@

demo: setup ## two bones of its own making, morphed through the real operator: .blend, .stl, report, PNG
	@$(VENV)/bin/python demo/run.py

docs: setup $(DOCS_VENV)/.made ## the manual, into docs_output/: open docs_output/index.html
	@OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m docs.make
	@NO_MKDOCS_2_WARNING=1 $(DOCS_VENV)/bin/python -m mkdocs build --strict --quiet
	@echo "docs_output/index.html"

$(DOCS_VENV)/.made: | setup
	@requirements/make_tools.sh "$(@D)" requirements/docs.txt $(VENV)/bin/python

test: setup ## core tests, Blender tests on the bpy wheel, and in a real blender and its window where there is one
	@tests/run_all.sh

package: setup ## one zip for each platform into dist/, with all it needs: what users install
	@$(VENV)/bin/python -m package.build
	@TZ=Asia/Tokyo PYTHONHASHSEED=1 $(VENV)/bin/python -m package.build --check

test-package: package ## install the Linux zip into real Blenders and bpy wheels, test it there, uninstall it
	@tests/run_installed.sh

lock: setup ## fetch the wheels that package/targets.py names; write requirements/wheels.lock.toml
	@$(VENV)/bin/python -m package.lock

lint: setup ## ruff and mypy
	@bad=0; for check in "ruff check ." "ruff format --check ." mypy; do \
	  echo "$$check"; $(VENV)/bin/$$check || bad=1; done; exit $$bad

format: setup ## let ruff rewrite the layout of the code
	$(VENV)/bin/ruff format .

bench: setup ## figures on real bones, which need ../shared/data
	@[ -d "$(DATA)" ] || { echo "make bench: there is no folder $(DATA) with the bones (FEMORS_DATA=... names another)"; exit 1; }
	@$(VENV)/bin/python tests/bench/bench_morph.py
	@$(VENV)/bin/python tests/bench/bench_overclosure.py
	@requirements/make_tools.sh "$(BENCH_VENV)" requirements/bench.txt $(VENV)/bin/python
	@$(VENV)/bin/python tests/bench/bench_peers.py --python "$(BENCH_VENV)/bin/python"

bench-quick: setup ## the morph beside Blender's Shrinkwrap, growth and operation counts, within two minutes
	@$(VENV)/bin/python tests/bench/counting.py
	@$(VENV)/bin/python tests/bench/bench_peers.py --quick

blender: ## fetch real Blender binaries (Debian's trixie and sid) for the tests
	@[ -x "$(FETCH)" ] || { echo "make blender: there is no $(FETCH); install Blender yourself and set BLENDER=/path/to/blender"; exit 1; }
	@$(FETCH) trixie "$(BLENDER_DIR)"
	@$(FETCH) sid "$(BLENDER_DIR)"

clean: ## remove what tests and demos leave; .venv stays
	rm -rf .pytest_cache .ruff_cache .mypy_cache .hypothesis demo_output test_output bench_output docs_output docs/reference docs/files dist
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean ## remove .venv too
	rm -rf $(VENV)
