#!/bin/bash
# Fuzzes every target, guided by coverage, on stable Rust without cargo-fuzz (which works with the folder, too).
#   fuzz.sh [SECONDS] [TARGETS]   SECONDS for each target, 60 by default; with 0 it only replays the corpus
# It starts from fuzz/corpus, and writes inputs that fail to fuzz/found.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-60}
targets=${2:-"images meshes jobs"}
host=$(rustc -vV | sed -n 's/^host: //p')
# libFuzzer needs this instrumentation to measure coverage.
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
