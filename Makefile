# make demo, make test, make bench: each sets up what it needs in .venv
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := Cargo.toml Cargo.lock pyproject.toml $(shell find rust -name '*.rs')
DEMO ?= out/demo

.PHONY: demo test lint bench wheel clean

demo: $(VENV)/installed
	$(BIN)/pbrfit demo $(DEMO) --overwrite

test: $(VENV)/tools lint
	cargo test --release
	$(BIN)/pytest

lint: $(VENV)/tools
	cargo fmt --check
	cargo clippy --all-targets -- -D warnings
	cargo clippy --all-targets --features python -- -D warnings
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest pbrfit._core

bench:
	cargo bench

wheel: $(VENV)/tools
	$(BIN)/pip wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf $(VENV) target dist out

$(VENV)/installed: $(SOURCES)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "pbrfit needs Python 3.11 or later; set PYTHON=...")'
	@command -v cargo >/dev/null || { echo "pbrfit needs a Rust toolchain: https://rustup.rs"; exit 1; }
	test -d $(VENV) || $(PYTHON) -m venv $(VENV)
	@echo "building pbrfit; the first time takes a few minutes"
	$(BIN)/pip install --quiet --editable .
	touch $@

# Without the core's own rules about when to rebuild, but with everything that tests need.
$(VENV)/tools: $(VENV)/installed
	$(BIN)/pip install --quiet --editable '.[test,lint]'
	touch $@
