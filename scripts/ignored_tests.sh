#!/bin/sh
# Runs the tests that plain `cargo test` ignores: those against other programs, which `make validators` installs,
# and those on images made by others, if their folder is there: DATA=folder, or ../shared/data.
set -eu
cd "$(dirname "$0")/.."

data=${DATA:-$PWD/../shared/data}
if [ -d "$data" ]; then
    export ATOMESH_DATA="$data"
    set --
else
    echo "note: no folder of images made by others: their tests are left out (make test-all DATA=folder)"
    set -- --skip real_data
fi
# Of the whole workspace: for one package alone Cargo would compile with other features.
cargo test --locked --workspace --lib --test main -- --ignored "$@"
