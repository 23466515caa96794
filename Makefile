# make demo   build without TetGen and CGAL, mesh the sample volume and print which files to open: needs only Rust
# make test   install missing packages and run the checks that need nothing but this repository
# make test-all   run all tests, also those against other programs (VTK, OPM Flow, Gmsh, ...), with MPI, and on
#                 images of other projects: DATA=folder
# make lint   run the lints of every kind of build and build the documentation of the library
# make without-c   test meshes, improvement and jobs in the build without TetGen and CGAL
# make portable   check that the library and the program compile for Windows, macOS and WebAssembly
# make bench   measure the table of docs/notes/measurements.md, some minutes
# make bench-networks   measure meshes of twenty random fault networks, some minutes
# make bench-labels   compare meshes of label images with those of CGAL: DATA=folder of images of other projects
# make reservoir   run a study from a seismic volume to ten years of simulation, in target/reservoir
# make mpi-test   install Open MPI if it is missing and test jobs on several processes
# make web    build a page that runs the program in a browser, target/web/atomesh.html
# make web-test   use this page in headless Chromium and compare its files with those of the program
# make wheel  build a wheel of the Python package, which needs no C libraries, in target/wheels
# make python-stubs   write the types of the Python package's options from those of the command line
# make python-test   build the Python package and run all its tests; check the program without C libraries
# make deb    build a Debian package of the program, in target/debian
# make package   build the crates as a registry would distribute them
# make spelling   check the spelling of the documentation, with codespell
# make book   build the documentation as a site, target/book/index.html, and check its links
# make figures   check figures of docs/, write its pictures and its page of options: DATA=folder of images of other projects
# make fuzz   fuzz with random files and small jobs, guided by coverage: SECONDS=60 for each of three targets
# make soak   test kills, interrupts, full disks and too little memory: RUNS=100 of each

.POSIX:
.PHONY: figures spelling fuzz soak help demo reservoir test test-all lint without-c portable web web-test mpi-test wheel python-stubs python-test deb package book bench bench-networks bench-labels validators packages

SAMPLE = data/faults.vti

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

packages:
	@scripts/packages.sh

demo:
	cargo build --release --locked --no-default-features --features cli
	@mkdir -p out
	target/release/atomesh mesh $(SAMPLE) -o out/faults.vtu --report out/faults.json --potential-out out/potential.vti
	@echo
	@echo "Open in ParaView:"
	@echo "  out/faults.vtu     the mesh (colour it by feature; clip it to look inside)"
	@echo "  $(SAMPLE)    the image of the mesh"
	@echo "  out/potential.vti  the potential b(x) that attracts the atoms"
	@echo "and out/faults.json has every figure of the table above."

reservoir: packages validators
	cargo build --locked
	.venv/bin/python scripts/reservoir.py target/debug/atomesh target/reservoir

# The workspace members that need MPI and Python are not tested.
test: packages
	cargo fmt --all --check
	python3 scripts/words.py
	python3 scripts/constants.py
	cargo test --package atomesh --package tetgen-sys --locked
	python3 scripts/figures.py target/debug/atomesh --check
	python3 scripts/reference.py target/debug/atomesh --check

lint: packages
	@scripts/packages.sh libopenmpi-dev openmpi-bin
	cargo clippy --workspace --all-targets --locked -- -D warnings
	cargo clippy --no-default-features --lib --locked -- -D warnings
	cargo clippy --no-default-features --features cli --lib --bins --locked -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --locked

without-c:
	cargo test --no-default-features --features cli --lib --locked -- mesh:: improve:: job::

# The library alone needs nothing of a system. The program needs files, so in a browser it runs as a WASI program.
portable:
	scripts/cross.sh wasm32-unknown-unknown check --no-default-features --lib
	scripts/cross.sh x86_64-pc-windows-gnu check --no-default-features --features cli
	scripts/cross.sh x86_64-apple-darwin check --no-default-features --features cli

web:
	scripts/cross.sh wasm32-wasip1 build --release --package atomesh-page
	scripts/web.py target/cross/wasm32-wasip1/release/atomesh-page.wasm target/web/atomesh.html

web-test: web validators
	cargo build --locked
	@mkdir -p target/web/pictures
	python3 -B tests/data/page/web.py target/web/atomesh.html target/debug/atomesh target/web/pictures
	python3 -B tests/data/page/workbench.py target/web/atomesh.html target/debug/atomesh target/web/pictures --axe .venv/axe.min.js

# Ignored tests run, too, and fail if a program that they need is missing.
test-all: lint without-c validators
	cargo fmt --all --check
	python3 scripts/words.py
	python3 scripts/constants.py
	cargo test --workspace --locked
	DATA="$(DATA)" scripts/ignored_tests.sh
	python3 scripts/figures.py target/debug/atomesh --check
	python3 scripts/reference.py target/debug/atomesh --check

mpi-test:
	@scripts/packages.sh libopenmpi-dev openmpi-bin
	cargo test --package atomesh-mpi --locked

wheel:
	@scripts/python.sh wheel

python-test:
	@scripts/python.sh test

python-stubs:
	@scripts/python.sh stubs

deb: packages
	@scripts/deb.sh

# Cargo assumes that crates of a registry never change, so the crates that an earlier run unpacked and built are removed
# first. The temporary registry of a workspace has no host, so the name of its folder starts with a hyphen.
package: packages
	rm -rf "$${CARGO_HOME:-$$HOME/.cargo}"/registry/src/-*/tetgen-sys-*
	cargo clean --quiet --locked -p tetgen-sys
	cargo package --workspace --exclude atomesh-python --exclude atomesh-mpi --exclude atomesh-page --locked --allow-dirty \
	    --config profile.dev.package.atomesh.opt-level=0

spelling:
	@scripts/packages.sh codespell
	codespell --ignore-words-list crate,trough,multy,wel,equil --skip '*.png,*.svg' *.md docs data/README.md python/README.md

book:
	@scripts/book.sh

bench: packages
	cargo bench --locked --bench whole

bench-networks: packages
	cargo bench --locked --bench networks

bench-labels: packages validators
	cargo build --locked --release
	@mkdir -p target/labels
	$(CXX) -O2 -DNDEBUG -std=c++17 benches/cgal_labels.cpp -o target/labels/cgal_labels -lgmp -lmpfr
	.venv/bin/python benches/labels.py target/release/atomesh target/labels/cgal_labels target/labels $(if $(DATA),--data $(DATA))

validators:
	@scripts/validators.sh

figures: packages
	cargo build --locked --bins --examples
	python3 scripts/figures.py target/debug/atomesh $(if $(DATA),--data $(DATA))
	python3 scripts/reference.py target/debug/atomesh

SECONDS = 60
fuzz: packages
	@scripts/fuzz.sh $(SECONDS)

RUNS = 100
soak: packages
	cargo build --locked
	scripts/soak.py target/debug/atomesh --kills $(RUNS) --interrupts $(RUNS) --memory $(RUNS) --disks $(RUNS)
