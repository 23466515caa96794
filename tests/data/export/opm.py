"""Prints results of OPM Flow as JSON: opm.py FOLDER CASE.

These are pore volumes, transmissibilities as (cell, cell, T) with numbers from 0, depths, and the last pressures."""

import json
import sys

import resfo


def arrays(ending):
    result = {}
    for keyword, values in resfo.read(f"{sys.argv[1]}/{sys.argv[2]}.{ending}"):
        # The last report overwrites those before it.
        result[keyword.strip()] = values
    return result


init, grid, restart = arrays("INIT"), arrays("EGRID"), arrays("UNRST")
# OPM Flow stores connections of neighbours in the row of boxes separately.
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
