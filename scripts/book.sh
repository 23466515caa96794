#!/bin/sh
# Checks all links of docs/, and builds the book of docs/ in target/book with mdBook. If this version of mdBook is not in
# target/mdbook, the script builds it there, unoptimised and without its server (a minute on two cores).
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
