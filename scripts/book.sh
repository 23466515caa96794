#!/bin/sh
# Makes the book of docs/ in target/book with mdBook, which is built into target/mdbook if that version
# is not there yet (a minute on two cores: unoptimised, without its server), and checks all links.
set -eu
cd "$(dirname "$0")/.."

version=0.5.4
mdbook=target/mdbook/bin/mdbook

python3 scripts/links.py
if [ "$("$mdbook" --version 2>/dev/null)" != "mdbook v$version" ]; then
    cargo install mdbook --version "$version" --locked --debug --quiet \
        --no-default-features --features search --root target/mdbook --target-dir target/mdbook/build
    rm -rf target/mdbook/build
fi
"$mdbook" build
