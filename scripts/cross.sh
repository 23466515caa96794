#!/bin/sh
# Runs cargo for a target that is not this machine: cross.sh TARGET COMMAND [ARGUMENT...]
#
# If the toolchain has the standard library of the target (`rustup target add TARGET`), it is used. Otherwise, on Debian,
# this installs the compiler that Debian keeps up to date for its browsers, with the source code of its standard library,
# which cargo then compiles for the target. The files of a target are in target/cross.
set -eu

target="$1"
command="$2"
shift 2
mkdir -p "${CARGO_TARGET_DIR:-target}/cross"
CARGO_TARGET_DIR="$(realpath "${CARGO_TARGET_DIR:-target}/cross")"
export CARGO_TARGET_DIR
variable="CARGO_TARGET_$(echo "$target" | tr 'a-z-' 'A-Z_')"
flags=""

# Puts the C library for WASI of Debian's newest release into the folder $1: those of older releases lack functions.
wasi_libc() {
    [ ! -e "$1/libc.a" ] || return 0
    apt="$CARGO_TARGET_DIR/apt"
    rm -rf "$apt"
    mkdir -p "$apt/lists/partial" "$apt/archives/partial"
    echo "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] http://deb.debian.org/debian sid main" >"$apt/sources"
    options="-qq -o Dir::Etc::sourcelist=$apt/sources -o Dir::Etc::sourceparts=- -o Dir::State::lists=$apt/lists
        -o Dir::Cache=$apt -o Dir::Cache::archives=$apt/archives -o APT::Sandbox::User=root"
    # shellcheck disable=SC2086
    (cd "$apt" && apt-get $options update && apt-get $options download wasi-libc)
    dpkg -x "$apt"/wasi-libc_*.deb "$apt/content"
    mkdir -p "$1"
    mv "$apt"/content/usr/lib/wasm32-wasi/* "$1"
    rm -rf "$apt"
}

if [ "${target%wasip1}" != "$target" ]; then
    # The program computes on the main thread, whose stack is as large as elsewhere.
    flags="-C target-feature=+simd128 -C link-arg=-zstack-size=8388608"
fi
if [ -d "$(rustc --print target-libdir --target "$target")" ]; then
    cargo=cargo
elif command -v apt-get >/dev/null 2>&1; then
    cargo=/usr/bin/cargo
    export RUSTC=/usr/bin/rustc RUSTDOC=/usr/bin/rustdoc RUSTC_BOOTSTRAP=1
    scripts/packages.sh rustc-web cargo-web rust-web-src
    set -- -Z build-std=std,panic_abort "$@"
    case "$target" in
    *-windows-gnu) scripts/packages.sh binutils-mingw-w64-x86-64 ;;
    *-wasip1)
        linker="lld-$($RUSTC -vV | sed -n 's/^LLVM version: \([0-9]*\).*/\1/p')"
        scripts/packages.sh "$linker"
        folder="$CARGO_TARGET_DIR/wasi"
        wasi_libc "$folder"
        flags="$flags -L $folder -C link-self-contained=no -C link-arg=$folder/crt1-command.o"
        export "${variable}_LINKER=wasm-ld-${linker#lld-}"
        ;;
    esac
else
    echo "error: $target: the standard library is missing; run: rustup target add $target" >&2
    exit 1
fi
export "${variable}_RUSTFLAGS=$flags"
exec "$cargo" "$command" --target "$target" --locked "$@"
