#!/bin/sh
# Runs the tests that `cargo test` ignores: slow tests, tests against other programs, which `make validators` installs,
# and tests on images of other projects if their folder exists (DATA=folder, else ../shared/data).
set -eu
cd "$(dirname "$0")/.."

data=${DATA:-$PWD/../shared/data}
if [ -d "$data" ]; then
    export ATOMESH_DATA="$data"
    set --
else
    echo "note: no folder of images of other projects: their tests are skipped (make test-all DATA=folder)"
    set -- --skip real_data
fi
# With --workspace, since Cargo would compile a single package with other features.
cargo test --locked --workspace --lib --test main -- --ignored "$@"
