"""Prints what OPM Flow wrote of a case as JSON: opm.py FOLDER CASE. Pore volumes, transmissibilities
as (cell, cell, T) from 0 on, depths, and the last pressures."""

import json
import sys

import resfo


def arrays(ending):
    found = {}
    for keyword, values in resfo.read(f"{sys.argv[1]}/{sys.argv[2]}.{ending}"):
        # Of several reports the last.
        found[keyword.strip()] = values
    return found


init, grid, restart = arrays("INIT"), arrays("EGRID"), arrays("UNRST")
# What joins neighbours in the row of boxes is kept apart from what joins others.
pairs = [(i, i + 1, float(t)) for i, t in enumerate(init["TRANX"]) if t != 0]
others = zip(grid.get("NNC1", ()), grid.get("NNC2", ()), init.get("TRANNNC", ()))
pairs += [(int(a) - 1, int(b) - 1, float(t)) for a, b, t in others]
print(
    json.dumps(
        {
            "porv": [float(v) for v in init["PORV"]],
            "depth": [float(v) for v in init["DEPTH"]],
            "t": pairs,
            "tranx": [float(t) for t in init["TRANX"]],
            "pressure": [float(v) for v in restart["PRESSURE"]],
            "swat": [float(v) for v in restart.get("SWAT", ())],
        }
    )
)
