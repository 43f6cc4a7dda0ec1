# Two commands do everything, set-up included: `make demo` and `make test`.
PYTHON ?= python3
BIN = .venv/bin
INSTALL = $(shell command -v uv >/dev/null 2>&1 && echo "uv pip install -q --python $(BIN)/python" || echo "$(BIN)/python -m pip install -q --disable-pip-version-check")

.PHONY: demo bench-demo test test-quick lint bench evidence drift docs kernels clean

demo: .venv/demo
	rm -rf demo
	$(BIN)/tumble simulate demo/launch --programme rough-table --seed 1
	$(BIN)/tumble calibrate demo/launch --truth demo/launch/truth.json

bench-demo: .venv/bench
	rm -rf demo/recorded demo/bench
	$(BIN)/tumble simulate demo/recorded --grade mems --rest 20 --turn-rate 30 --format csv --seed 3
	$(BIN)/tumble bench demo/bench --listen replay:demo/recorded@10x --browser

test: .venv/test kernels lint
	$(BIN)/python -m pytest -n auto

test-quick: .venv/test kernels
	$(BIN)/python -m pytest -q -n auto -m 'not slow'

lint: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: .venv/test
	$(BIN)/sphinx-build -q -E -W -n --keep-going docs site
	@echo "site/index.html"

kernels: .venv/test
	$(BIN)/python hatch_build.py

bench: .venv/test kernels
	for script in benchmarks/*.py; do $(BIN)/python $$script || exit 1; done

evidence: .venv/test kernels
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m evidence.run
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m evidence.real.run

drift: .venv/test kernels
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m evidence.run --short --against evidence/results/short.json

.venv/bin/python:
	@echo "a virtual environment: .venv (nothing is installed outside this folder)"
	$(PYTHON) -m venv .venv

.venv/demo: pyproject.toml hatch_build.py | .venv/bin/python
	@echo "tumble and its libraries (numpy, scipy, polars, pydantic, rich, click: some 400 MB on disk), and its loops compiled: a minute or two"
	$(INSTALL) -e .
	touch $@

.venv/bench: pyproject.toml hatch_build.py | .venv/bin/python
	@echo "tumble with the page at the bench and reports: a minute or two"
	$(INSTALL) -e '.[bench,report]'
	touch $@

.venv/test: pyproject.toml hatch_build.py | .venv/bin/python
	@echo "tumble with all extras and the tools that check it (some 1.4 GB): several minutes"
	$(INSTALL) -e '.[dev]'
	touch $@ .venv/demo

clean:
	rm -rf .venv demo site
	find src -name '*.so' -delete
