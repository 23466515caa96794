#!/bin/sh
# Builds and tests the Python package:
#   python.sh wheel   builds a wheel for distribution, in target/wheels
#   python.sh test    builds it unoptimised and runs every test: pytest, types, notebooks, and a run with nothing but
#                     NumPy. It also checks the program without C libraries.
#   python.sh stubs   writes the types of options, python/package/atomesh/_options.pyi
# Tools and the packages of the tests are installed from PyPI into target/python.
set -eu
cd "$(dirname "$0")/.."

venv=target/python/venv
tested_with="numpy pytest mypy pyvista xarray SimpleITK nibabel meshio tqdm pandas nbclient ipykernel matplotlib"

# install MODULE PACKAGES...: installs the packages unless the module can be imported.
install() {
    module="$1"
    shift
    [ -x "$venv/bin/python" ] || python3 -m venv "$venv"
    "$venv/bin/python" -c "import $module" 2>/dev/null ||
        "$venv/bin/pip" install --quiet --disable-pip-version-check "$@"
}

# build PROFILE: builds the wheel as the only file in target/wheels. It fails if the wheel needs a library that not every
# Linux has.
build() {
    install maturin "maturin>=1.13,<2"
    rm -rf target/wheels
    "$venv/bin/maturin" build --manifest-path python/Cargo.toml --locked --quiet --profile "$1" --auditwheel check \
        --out target/wheels
    ls -l target/wheels | awk 'NR > 1 { print "wheel: target/wheels/" $NF ", " $5 " bytes" }'
}

# check_libraries FILE: fails if a program or module needs libraries other than those of C and of the compiler.
check_libraries() {
    other="$(ldd "$1" | awk '$1 !~ /^(linux-vdso|libc|libm|libgcc_s|.*\/ld-linux[^\/]*)\.so/ { print $1 }')"
    if [ -n "$other" ]; then
        echo "error: $1: it needs" $other >&2
        exit 1
    fi
}

# Builds the program without C libraries. It has the library of the wheel, so only linking takes time. Checks which libraries
# it needs, and that it makes the same mesh as the program that `make test` has built, if there is one.
program() {
    default=target/debug/atomesh
    # A run that was stopped leaves links to the same file.
    rm -f target/python/atomesh
    [ ! -x $default ] || ln -f $default target/python/default
    cargo build --package atomesh --package atomesh-python --no-default-features --features atomesh/cli \
        --bin atomesh --locked --quiet
    mv $default target/python/atomesh
    check_libraries target/python/atomesh
    target/python/atomesh mesh data/faults.vti -o target/python/atomesh.vtu --quiet
    [ -x target/python/default ] || return 0
    mv target/python/default $default
    $default mesh data/faults.vti -o target/python/default.vtu --quiet
    cmp target/python/atomesh.vtu target/python/default.vtu
}

# Tests the wheel in a new virtual environment with nothing but NumPy.
alone() {
    rm -rf target/python/alone
    python3 -m venv target/python/alone
    target/python/alone/bin/pip install --quiet --disable-pip-version-check target/wheels/*.whl
    for module in target/python/alone/lib/python*/site-packages/atomesh/_native*.so; do
        check_libraries "$module"
    done
    (cd target/python && alone/bin/python ../../python/alone.py)
}

case "${1:-}" in
wheel)
    build release
    alone
    ;;
test)
    install nbclient $tested_with
    build dev
    alone
    program
    "$venv/bin/pip" install --quiet --disable-pip-version-check --force-reinstall --no-deps target/wheels/*.whl
    "$venv/bin/python" python/stubs.py --check
    mkdir -p target/python/scripts
    "$venv/bin/python" python/notebooks.py --scripts target/python/scripts
    (cd python && "../$venv/bin/mypy" --config-file pyproject.toml --cache-dir ../target/python/mypy \
        package/atomesh ../target/python/scripts)
    # Tests compare the package with the program that `make test` has built, if there is one.
    [ ! -x target/debug/atomesh ] || export ATOMESH_BINARY="$PWD/target/debug/atomesh"
    (cd python && "../$venv/bin/pytest" -p no:cacheprovider)
    "$venv/bin/python" python/notebooks.py
    ;;
stubs)
    install nbclient $tested_with
    build dev
    "$venv/bin/pip" install --quiet --disable-pip-version-check --force-reinstall --no-deps target/wheels/*.whl
    "$venv/bin/python" python/stubs.py
    ;;
*)
    sed -n '2,6s/^# //p' "$0" >&2
    exit 2
    ;;
esac
