# Two commands do everything, set-up included: `make demo` and `make test`.
PYTHON ?= python3
BIN = .venv/bin
INSTALL = $(shell command -v uv >/dev/null 2>&1 && echo "uv pip install -q --python $(BIN)/python" || echo "$(BIN)/python -m pip install -q --disable-pip-version-check")
PYTEST = $(BIN)/python -m pytest -n auto

.PHONY: demo bench-demo test test-quick test-weekly lint bench evidence drift docs kernels clean

demo: .venv/demo
	rm -rf demo
	$(BIN)/tumble simulate demo/launch --programme rough-table --seed 1
	$(BIN)/tumble calibrate demo/launch --truth demo/launch/truth.json

bench-demo: .venv/bench
	rm -rf demo/recorded demo/bench
	$(BIN)/tumble simulate demo/recorded --grade mems --rest 20 --turn-rate 30 --format csv --seed 3
	$(BIN)/tumble bench demo/bench --listen replay:demo/recorded@10x

test: kernels lint
	$(PYTEST) -m 'not weekly'

test-quick: kernels
	$(PYTEST) -q -m 'not slow and not weekly'

test-weekly: kernels
	$(PYTEST) -m weekly

lint: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: kernels
	$(BIN)/sphinx-build -q -E -W -n --keep-going docs site
	@echo "site/index.html"

# what was changed in a .pyx since is compiled again
kernels: .venv/test
	$(BIN)/python setup.py --quiet build_ext --inplace

bench: kernels
	for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

evidence: kernels
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m evidence.run
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m evidence.real.run
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m evidence.real.waved

drift: kernels
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m evidence.run --short --against evidence/results/short.json

.venv/bin/python:
	@command -v cc >/dev/null || { echo "tumble is compiled here: install a C compiler and the headers of Python (apt-get install gcc libc6-dev python3-dev)" >&2; exit 1; }
	@echo "a virtual environment: .venv (nothing is installed outside this folder)"
	$(PYTHON) -m venv .venv

.venv/demo: pyproject.toml setup.py | .venv/bin/python
	@echo "tumble and its libraries (numpy, scipy, polars, pydantic, click: some 400 MB on disk), compiled: a minute or two"
	$(INSTALL) -e .
	touch $@

.venv/bench: pyproject.toml setup.py | .venv/bin/python
	@echo "tumble with the page at the bench and the laboratory: a minute or two"
	$(INSTALL) -e '.[bench,lab]'
	touch $@

.venv/test: pyproject.toml setup.py | .venv/bin/python
	@echo "tumble with all extras and the tools that check it (some 1.4 GB): several minutes"
	$(INSTALL) -e '.[dev]'
	touch $@ .venv/demo

clean:
	rm -rf .venv demo site build
	find src -name '*.so' -delete
