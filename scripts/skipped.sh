#!/bin/sh
# Says how many checks were skipped, and for want of what: skipped.sh FILE, with a line for each.
set -eu

if [ -s "$1" ]; then
    echo "skipped checks: $(wc -l <"$1" | tr -d ' '), for want of"
    sort "$1" | uniq -c
else
    echo "skipped checks: none"
fi
