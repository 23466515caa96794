#!/bin/sh
# Installs the missing system packages of atomesh with TetGen and CGAL: these, a C++ compiler, and the libclang that generates
# the bindings of TetGen. On systems other than Debian and Ubuntu it prints the packages and stops.
#   packages.sh [PACKAGE...]   installs these packages, too
set -eu

packages="g++ libtet1.5-dev libcgal-dev libclang-dev $*"

if ! command -v cargo >/dev/null 2>&1; then
    echo "error: cargo: not found; install Rust from https://rustup.rs" >&2
    exit 1
fi

if ! command -v dpkg >/dev/null 2>&1 || ! command -v apt-get >/dev/null 2>&1; then
    echo "error: system packages: no apt here; install the equivalents of these packages: $packages" >&2
    echo "       then: cargo build --release; or without them: cargo build --release --no-default-features --features cli" >&2
    exit 1
fi

missing=""
for package in $packages; do
    if ! dpkg -s "$package" 2>/dev/null | grep -q '^Status: install ok installed'; then
        missing="$missing $package"
    fi
done
[ -n "$missing" ] || exit 0

as_root=""
if [ "$(id -u)" -ne 0 ]; then
    if ! command -v sudo >/dev/null 2>&1; then
        echo "error: system packages: not root and no sudo; ask an administrator to install:$missing" >&2
        exit 1
    fi
    as_root="sudo"
fi

echo "Installing the missing system packages:$missing"
$as_root apt-get update -qq
$as_root env DEBIAN_FRONTEND=noninteractive \
    apt-get install -y -qq --no-install-recommends $missing
