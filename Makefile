# make demo, make test, make bench: each sets up what it needs in .venv
# make test-slow: the tests that take more than two seconds each, which make test leaves out
# make bench-needs: what leaving out parts of a fit saves
# make bench-growth: time and memory of a fit from 0.25 to 16 MP, 4 to 64 pictures (an hour, 13 GiB)
# make bench-users: 12 to 60 photographs as cameras make them, from files to maps (10 minutes, 8 GiB)
# make test-acquire: the tests that need PyTorch, diffusers, transformers and openai, in .venv-acquire
#   (5 GB); they download no weights
# make test-fuzz: 100,000 damaged files, and inputs led by coverage, in .venv-fuzz; needs a C++ compiler
#   (FUZZ_CASES, FUZZ_SECONDS for each target that is led, FUZZ_SEED, FUZZ_JOBS)
# make test-sanitizer: the vector kernels under LLVM's AddressSanitizer; Linux (ten minutes)
# make test-cluster: the tests that need dask.distributed, in .venv-cluster; schedulers and workers are
#   processes of this machine
# make test-arrays: any arrays for any argument, EXAMPLES of them for each call, others in each run
# make test-limits: Ctrl-C at random times of every command on a large scene (an hour)
# make test-soak: 2,000 small scenes in one process and in a pool (an hour): memory, open files, what is left
# make test-reliability: batches killed a hundred times and gone on with, told to end at random times,
#   on full disks, without rights, beside another batch (half an hour; Linux, as root all of it)
# make cycles-env: Blender as a Python module in .venv-cycles (1 GB), for renders by Cycles
# make site: the documentation as pages in out/site, in .venv-site; the notebooks are executed for it
# make gallery DATA=DIR: fits of public sets of pictures with their live pages, which make site takes
#   up; half an hour
# make evidence DATA=DIR: every suite, one after the other, and the tables of the documentation from
#   them; a day on two cores, or SUITES="table1 solvers"; goes on where it was interrupted
# make bench-peers: our objective beside PyTorch, JAX, numba and numpy, in .venv-peers (5 GB)
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PEERS := .venv-peers
CYCLES := .venv-cycles
SITE := .venv-site
ACQUIRE := .venv-acquire
FUZZ := .venv-fuzz
CLUSTER := .venv-cluster
CYCLES_PYTHON ?= python3.11
CYCLES_NEEDS := evaluation/pbrfit_evaluation/cycles/requirements.txt
SOURCES := Cargo.toml Cargo.lock pyproject.toml $(shell find rust -name '*.rs')
PYTHON_SOURCES := $(shell find python evaluation -name '*.py')
DEMO ?= out/demo
NOTEBOOKS := $(wildcard docs/notebooks/*.ipynb)
# of gallery: the folder of the public sets
DATA ?= $(PBRFIT_DATA)
# of evidence
SUITES ?= table1 convergence solvers ablation normals uncertainty everyday transport lamps heldout review gap stability peers
OF_table1 = --textures $(DATA)
OF_convergence = --real $(DATA)/visiont3lab_shrek
OF_heldout = $(DATA)
# of bench-peers: what `python -m peers --help` lists
PEERS_OPTIONS ?=
FUZZ_CASES ?= 100000
FUZZ_SECONDS ?= 30
FUZZ_SEED ?= 0
FUZZ_JOBS ?= 2
# LLVM counts covered branches and compared values for libFuzzer.
FUZZ_LLVM := -coverage-level=4 -coverage-inline-8bit-counters -coverage-pc-table -coverage-trace-compares
FUZZ_FLAGS := -Cpasses=sancov-module $(patsubst -%,-Cllvm-args=-sanitizer-%,$(FUZZ_LLVM)) --cfg fuzzing
# of test: Python tests at once
TEST_JOBS ?= 2
# One BLAS thread in each of the processes, which are as many as there are cores.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/pytest --numprocesses $(TEST_JOBS) --dist worksteal --durations 30
# of test-arrays
EXAMPLES ?= 2000

.PHONY: demo test test-rust test-slow test-acquire test-cluster test-arrays test-limits test-soak test-fuzz test-short-reliability test-sanitizer test-reliability lint lint-rust lint-python bench bench-growth bench-needs bench-users bench-peers cycles-env evidence site gallery wheel clean

demo: $(VENV)/installed
	$(BIN)/pbrfit demo $(DEMO) --overwrite

# Rust's half and Python's side by side: the last crate of each build takes one core alone.
test:
	$(MAKE) --jobs 2 test-rust lint-python
	$(PYTEST) -m "not slow"

test-rust: lint-rust
	cargo test --profile editable

test-slow: $(VENV)/tools
	$(PYTEST) -m slow

test-acquire: $(ACQUIRE)/installed
	$(ACQUIRE)/bin/pytest tests/acquire

test-fuzz: $(FUZZ)/installed target/fuzz/built
	PYTHONPATH=tests $(FUZZ)/bin/python -m fuzz --cases $(FUZZ_CASES) --seed $(FUZZ_SEED) --jobs $(FUZZ_JOBS)
	PYTHONPATH=tests $(FUZZ)/bin/python -m fuzz.guided --seconds $(FUZZ_SECONDS) --jobs $(FUZZ_JOBS)

# A sanitizer is for nightly compilers, but for this variable.
test-sanitizer:
	RUSTC_BOOTSTRAP=1 RUSTFLAGS=-Zsanitizer=address cargo test --target-dir target/sanitizer \
		--target $$(rustc -vV | sed -n 's/^host: //p') objective

# Of test-fuzz and test-reliability what fits into a minute.
test-short-reliability: $(VENV)/tools
	PYTHONPATH=tests $(BIN)/python -m fuzz --cases 300
	$(BIN)/python tests/reliability/kills.py --kills 1 --scenes 2

test-cluster: $(CLUSTER)/installed
	$(CLUSTER)/bin/pytest tests/cluster

test-arrays: $(VENV)/tools
	PBRFIT_EXAMPLES=$(EXAMPLES) $(BIN)/pytest tests/python/commands/test_array_interface.py \
		tests/python/model/test_boundary.py

test-limits: $(VENV)/tools
	$(BIN)/python tests/reliability/signals.py commands --times 5

test-soak: $(VENV)/tools
	$(BIN)/python tests/soak/soak.py
	$(BIN)/python tests/soak/soak.py --jobs 2

test-reliability: $(VENV)/tools
	$(BIN)/python tests/reliability/kills.py
	$(BIN)/python tests/reliability/signals.py batches
	$(BIN)/pytest tests/reliability
	$(BIN)/python tests/reliability/allocations.py

lint: lint-rust lint-python

lint-rust:
	cargo fmt --check
	cargo clippy --profile editable --all-targets --features python -- -D warnings

lint-python: $(VENV)/tools
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest pbrfit._core

bench:
	cargo bench

bench-needs: $(VENV)/installed
	$(BIN)/python benches/needs.py --docs docs

bench-growth: $(VENV)/installed
	$(BIN)/python benches/growth.py

bench-users: $(VENV)/installed
	$(BIN)/python benches/users.py

evidence: $(VENV)/tools
	@test -n "$(DATA)" || { echo "evidence: where are the public sets? set DATA=..."; exit 1; }
	@$(foreach suite,$(SUITES),$(BIN)/pbrfit evaluate $(suite) $(OF_$(suite)) --out out/evidence/$(suite) \
		--resume --docs docs || echo "evidence: $(suite) says more above";)

bench-peers: $(PEERS)/installed
	mkdir -p out
	cargo bench --bench machine -- --json > out/machine.json
	PYTHONPATH=benches $(PEERS)/bin/python -m peers --machine out/machine.json --docs docs $(PEERS_OPTIONS)

cycles-env: $(CYCLES)/installed

site: $(SITE)/installed $(NOTEBOOKS:docs/%.ipynb=out/%.md)
	NO_MKDOCS_2_WARNING=1 $(SITE)/bin/mkdocs build --quiet
	@echo "out/site/index.html"

out/notebooks/%.md: docs/notebooks/%.ipynb tools/notebook_page.py $(PYTHON_SOURCES) $(SOURCES) | $(SITE)/installed
	$(SITE)/bin/python tools/notebook_page.py $< --out out/notebooks

gallery: $(SITE)/installed
	@test -n "$(DATA)" || { echo "gallery: where are the public sets? set DATA=..."; exit 1; }
	$(SITE)/bin/python tools/gallery.py $(DATA)

wheel: $(VENV)/tools
	$(BIN)/pip wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf $(VENV) $(PEERS) $(CYCLES) $(ACQUIRE) $(CLUSTER) $(FUZZ) $(SITE) target dist out

$(VENV)/bin/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "pbrfit needs Python 3.11 or later; set PYTHON=...")'
	@command -v cargo >/dev/null || { echo "pbrfit needs a Rust toolchain: https://rustup.rs"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@echo "building pbrfit; the first time takes a few minutes"

$(VENV)/installed: $(SOURCES) | $(VENV)/bin/pip
	$(BIN)/pip install --quiet --editable .
	touch $@

# The package too, with everything that tests need.
$(VENV)/tools: $(SOURCES) | $(VENV)/bin/pip
	$(BIN)/pip install --quiet --editable '.[test,lint,notebooks]' --editable evaluation
	touch $(VENV)/installed $@

# Peers one by one: what cannot be installed is left out, with a message here and in the results.
$(PEERS)/installed: $(SOURCES) $(PYTHON_SOURCES) benches/peers/requirements.txt
	test -d $(PEERS) || $(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install --quiet . ./evaluation
	@grep -v '^#' benches/peers/requirements.txt | while read -r peer; do \
		echo "installing $$peer"; \
		$(PEERS)/bin/pip install --quiet "$$peer" < /dev/null || echo "bench-peers: no $$peer; going on without"; \
	done
	touch $@

$(ACQUIRE)/installed: $(SOURCES)
	test -d $(ACQUIRE) || $(PYTHON) -m venv $(ACQUIRE)
	@echo "installing PyTorch, diffusers, transformers and openai: 5 GB"
	$(ACQUIRE)/bin/pip install --quiet --editable '.[test,diffusion,openai,segment]' --editable evaluation
	touch $@

$(FUZZ)/installed: $(SOURCES)
	test -d $(FUZZ) || $(PYTHON) -m venv $(FUZZ)
	$(FUZZ)/bin/pip install --quiet --editable '.[test]' --editable evaluation
	@$(FUZZ)/bin/pip install --quiet atheris || echo "test-fuzz: no atheris for this machine; going on without"
	touch $@

target/fuzz/built: $(SOURCES) $(wildcard tests/fuzz/rust/Cargo.* tests/fuzz/rust/targets/*.rs)
	RUSTFLAGS='$(FUZZ_FLAGS)' cargo build --release --manifest-path tests/fuzz/rust/Cargo.toml \
		--target-dir target/fuzz --target $$(rustc -vV | sed -n 's/^host: //p')

$(CLUSTER)/installed: $(SOURCES)
	test -d $(CLUSTER) || $(PYTHON) -m venv $(CLUSTER)
	$(CLUSTER)/bin/pip install --quiet --editable '.[test,cluster]' --editable evaluation
	touch $@

$(SITE)/installed: $(SOURCES)
	test -d $(SITE) || $(PYTHON) -m venv $(SITE)
	$(SITE)/bin/pip install --quiet --editable '.[docs]' --editable evaluation
	touch $@

$(CYCLES)/installed: $(CYCLES_NEEDS)
	@$(CYCLES_PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null \
		|| { echo "cycles-env: bpy's wheels are for Python 3.11, and $(CYCLES_PYTHON) is none; set CYCLES_PYTHON=..."; exit 1; }
	test -d $(CYCLES) || $(CYCLES_PYTHON) -m venv $(CYCLES)
	@echo "installing Blender as a module: 1 GB"
	@$(CYCLES)/bin/pip install --quiet --requirement $(CYCLES_NEEDS) \
		|| { echo "cycles-env: no bpy for this machine; it has wheels for Linux and Windows on x86-64 and for macOS"; exit 1; }
	@$(CYCLES)/bin/python -c 'import bpy, OpenEXR' \
		|| { echo "cycles-env: bpy does not load; on Linux it needs the X11 and OpenGL libraries (libx11-6 libxi6 libxxf86vm1 libxfixes3 libxkbcommon0 libsm6 libgl1 libegl1)"; exit 1; }
	touch $@
