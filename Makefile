# make demo, make test, make bench: each sets up what it needs in .venv
# make bench-peers: our objective beside PyTorch, JAX and numpy, in .venv-peers (5 GB)
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PEERS := .venv-peers
SOURCES := Cargo.toml Cargo.lock pyproject.toml $(shell find rust -name '*.rs')
PYTHON_SOURCES := $(shell find python -name '*.py')
DEMO ?= out/demo
# of bench-peers: threads of every peer, and what else `python -m peers --help` lists
THREADS ?= 2
PEERS_OPTIONS ?=

.PHONY: demo test lint bench bench-peers wheel clean

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

bench-peers: $(PEERS)/installed
	mkdir -p out
	cargo bench --bench machine -- --threads $(THREADS) --json > out/machine.json
	PYTHONPATH=benches $(PEERS)/bin/python -m peers --threads $(THREADS) --machine out/machine.json $(PEERS_OPTIONS)

wheel: $(VENV)/tools
	$(BIN)/pip wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf $(VENV) $(PEERS) target dist out

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

# Peers one by one: what cannot be installed is left out, with a message here and in the results.
$(PEERS)/installed: $(SOURCES) $(PYTHON_SOURCES) benches/peers/requirements.txt
	test -d $(PEERS) || $(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install --quiet .
	@grep -v '^#' benches/peers/requirements.txt | while read -r peer; do \
		echo "installing $$peer"; \
		$(PEERS)/bin/pip install --quiet "$$peer" < /dev/null || echo "bench-peers: no $$peer; going on without"; \
	done
	touch $@
