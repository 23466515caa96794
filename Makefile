# make demo   install what is missing, build, mesh the sample volume, say which files to open
# make test   install what is missing, then the checks that need nothing but this repository
# make test-all   those, and the tests against other programs (VTK, OPM Flow, Gmsh, ...), by ranks of MPI, and on
#                 images made by others: DATA=folder
# make lint   the lints of every kind of build, and the documentation of the library
# make bench-networks   what becomes of twenty random fault networks, some minutes
# make bench-labels   meshes of labelled images beside CGAL's: DATA=folder with other people's images
# make reservoir   from a seismic volume to ten years of its simulation, in target/reservoir
# make mpi-test   install Open MPI if it is missing, then one job by several processes
# make wheel  the Python package for others, with all libraries that it needs, in target/wheels
# make python-test   build the Python package and run every test of it
# make deb    a Debian package of the program, in target/debian
# make package   build what a registry would give to others
# make book   the documentation as a site, target/book/index.html, with its links checked
# make figures   pictures and figures of docs/ made again: DATA=folder with other people's images
# make fuzz   random files and small jobs, led by what code they reach: SECONDS=60 for each of three targets
# make soak   kills, interrupts, full disks and too little memory: RUNS=100 of each

.POSIX:
.PHONY: figures fuzz soak help demo reservoir test test-all lint mpi-test wheel python-test deb package book bench bench-networks bench-labels validators packages

SAMPLE = data/faults.vti

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

packages:
	@scripts/packages.sh

demo: packages
	cargo build --release --locked
	@mkdir -p out
	target/release/atomesh mesh $(SAMPLE) -o out/faults.vtu --report out/faults.json --potential-out out/potential.vti
	@echo
	@echo "Open in ParaView:"
	@echo "  out/faults.vtu     the mesh (colour it by feature; clip it to look inside)"
	@echo "  $(SAMPLE)    the image it was made from"
	@echo "  out/potential.vti  the potential b(x) that pulled the atoms"
	@echo "and out/faults.json holds every figure of the table above."

reservoir: packages validators
	cargo build --locked
	.venv/bin/python scripts/reservoir.py target/debug/atomesh target/reservoir

# Without the packages that need MPI and Python.
test: packages
	cargo fmt --all --check
	cargo test --package atomesh --package tetgen-sys --locked
	python3 scripts/figures.py target/debug/atomesh --check

lint: packages
	@scripts/packages.sh libopenmpi-dev openmpi-bin
	cargo clippy --workspace --all-targets --locked -- -D warnings
	cargo clippy --no-default-features --lib --locked -- -D warnings
	cargo clippy --no-default-features --features cli --lib --bins --locked -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --locked

# Tests that are ignored without it: what they need is there, or they fail.
test-all: lint validators
	cargo fmt --all --check
	cargo test --workspace --locked
	DATA="$(DATA)" scripts/ignored_tests.sh
	python3 scripts/figures.py target/debug/atomesh --check

mpi-test:
	@scripts/packages.sh libopenmpi-dev openmpi-bin
	cargo test --package atomesh-mpi --locked

wheel: packages
	@scripts/python.sh wheel

python-test: packages
	@scripts/python.sh test

deb: packages
	@scripts/deb.sh

# Cargo takes a crate of a registry for unchanged, and so what it unpacked and built of our own from
# an earlier run: that goes first. Its registry for a workspace's crates has no host, so the folder's
# name starts with a hyphen.
package: packages
	rm -rf "$${CARGO_HOME:-$$HOME/.cargo}"/registry/src/-*/tetgen-sys-*
	cargo clean --quiet --locked -p tetgen-sys
	cargo package --workspace --exclude atomesh-python --exclude atomesh-mpi --locked --allow-dirty \
	    --config profile.dev.package.atomesh.opt-level=0

book:
	@scripts/book.sh

bench: packages
	cargo bench --locked --bench whole

bench-networks: packages
	cargo bench --locked --bench networks

bench-labels: packages validators
	cargo build --locked
	@mkdir -p target/labels
	$(CXX) -O2 -DNDEBUG -std=c++17 benches/cgal_labels.cpp -o target/labels/cgal_labels -lgmp -lmpfr
	.venv/bin/python benches/labels.py target/debug/atomesh target/labels/cgal_labels target/labels $(if $(DATA),--data $(DATA))

validators:
	@scripts/validators.sh

figures: packages
	cargo build --locked
	python3 scripts/figures.py target/debug/atomesh $(if $(DATA),--data $(DATA))

SECONDS = 60
fuzz: packages
	@scripts/fuzz.sh $(SECONDS)

RUNS = 100
soak: packages
	cargo build --locked
	scripts/soak.py target/debug/atomesh --kills $(RUNS) --interrupts $(RUNS) --memory $(RUNS) --disks $(RUNS)
