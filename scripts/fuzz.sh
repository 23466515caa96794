#!/bin/bash
# Fuzzes every target for so many seconds (60 unless given as the first argument), from the kept corpus:
# coverage-guided, on stable Rust, without cargo-fuzz (with which the folder works as well). New findings
# are left in fuzz/found. With 0 seconds the corpus is only replayed.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-60}
targets=${2:-"images meshes jobs"}
host=$(rustc -vV | sed -n 's/^host: //p')
# What libFuzzer needs to see which code has been reached.
export RUSTFLAGS="--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=3 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table"
cargo build --release --locked --manifest-path fuzz/Cargo.toml --target "$host" --target-dir target/fuzz
mkdir -p fuzz/found
for target in $targets; do
    binary=target/fuzz/$host/release/$target
    case $seconds in
    0) "$binary" -timeout=20 -rss_limit_mb=4096 -artifact_prefix=fuzz/found/ -runs=0 "fuzz/corpus/$target" ;;
    *)
        new=$(mktemp -d)
        "$binary" -timeout=20 -rss_limit_mb=4096 -artifact_prefix=fuzz/found/ -max_len=40000 \
            -max_total_time="$seconds" -print_final_stats=1 "$new" "fuzz/corpus/$target"
        rm -r "$new"
        ;;
    esac
done
