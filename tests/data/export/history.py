"""Prints the balances of a simulation by OPM Flow as JSON: history.py FOLDER CASE.

These are the largest relative errors of the mass of oil, water and gas over all steps, the largest and smallest totals,
and the depth, pressure and saturations of each active cell at the start."""

import json
import sys

import numpy as np
import resfo

base = f"{sys.argv[1]}/{sys.argv[2]}"


def arrays(ending):
    result = {}
    for keyword, values in resfo.read(f"{base}.{ending}"):
        result.setdefault(keyword.strip(), []).append(values)
    return result


def text(values):
    return [value.decode().strip() if isinstance(value, bytes) else str(value).strip() for value in values]


spec = arrays("SMSPEC")
names, wells = text(spec["KEYWORDS"][0]), text(spec.get("WGNAMES", spec.get("NAMES"))[0])
steps = np.array([list(map(float, values)) for values in arrays("UNSMRY")["PARAMS"]])


def vector(name, well=None):
    columns = [k for k, known in enumerate(names) if known == name and (well is None or wells[k] == well)]
    return steps[:, columns].sum(axis=1) if columns else np.zeros(len(steps))


def error(in_place, inflow, outflow):
    total = in_place + outflow - inflow
    return float(np.abs(total / total[0] - 1).max())


influx = vector("AAQT")
init, restart = arrays("INIT"), arrays("UNRST")
print(
    json.dumps(
        {
            "days": float(vector("TIME")[-1]),
            "errors": {
                "oil": error(vector("FOIP"), 0, vector("FOPT")),
                "water": error(vector("FWIP"), vector("FWIT") + influx, vector("FWPT")),
                "gas": error(vector("FGIP"), vector("FGIT"), vector("FGPT")),
            },
            "oil": [float(vector("FOIP")[0]), float(vector("FOPT")[-1])],
            "gas": [float(vector("FGIP")[0]), float(vector("FGPT")[-1])],
            "influx": float(influx[-1]),
            "observed": [float(vector("WOPRH", "P1")[0]), float(vector("WOPR", "P1")[0])],
            "depth": [float(v) for v in init["DEPTH"][0]],
            "pressure": [float(v) for v in restart["PRESSURE"][0]],
            "swat": [float(v) for v in restart["SWAT"][0]],
            "sgas": [float(v) for v in restart["SGAS"][0]],
            "tables": [int(v) for v in init["SATNUM"][0]],
        }
    )
)
