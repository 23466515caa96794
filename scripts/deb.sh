#!/bin/sh
# Builds a Debian package in target/debian, with manual pages and completions for shells.
#   deb.sh [PROFILE]   uses this profile of Cargo, release by default
# Installs cargo-deb from crates.io into target/tools if it is missing.
set -eu
cd "$(dirname "$0")/.."

profile="${1:-release}"
folder="$profile"
[ "$profile" = dev ] && folder=debug

tool="$(command -v cargo-deb || true)"
if [ -z "$tool" ]; then
    tool=target/tools/bin/cargo-deb
    [ -x "$tool" ] || cargo install --quiet --locked --root target/tools 'cargo-deb@^3'
fi

cargo build --locked --profile "$profile"
rm -rf target/deb
mkdir -p target/deb/man target/deb/bin
cp "target/$folder/atomesh" target/deb/bin/atomesh
strip target/deb/bin/atomesh
target/deb/bin/atomesh man --quiet -o target/deb/man
gzip -9n target/deb/man/*
for shell in bash zsh fish; do
    target/deb/bin/atomesh completions "$shell" >"target/deb/$shell"
done
"$tool" deb --no-build --no-strip
