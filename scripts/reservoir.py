#!/usr/bin/env python
"""Runs a reservoir study from a seismic volume to a simulation: scripts/reservoir.py BINARY FOLDER [--distance D]

A synthetic survey is written as SEG-Y. Its fault and horizons become a mesh, and the layers between them have rock
properties. OPM Flow simulates ten years of water injection. Then every available solver computes the steady pressures
of the same cells, which are compared. The script prints each command and the figures, which are also in
FOLDER/figures.json. See docs/tutorials/reservoir.md. It needs the Python modules in .venv, which `make validators`
installs, and OPM Flow as `flow`.
"""
import argparse
import json
import pathlib
import re
import shutil
import subprocess
import sys

import numpy as np
import resfo

import simulated

VALIDATORS = pathlib.Path(__file__).resolve().parent.parent / "tests/data/export"
# The survey has samples of 12.5 m x 12.5 m x 4 ms, or 6 m at 3000 m/s.
SPACING, VELOCITY = 12.5, 3000
# Metric in which rock with a vertical permeability of a tenth of the horizontal one is isotropic.
METRIC = f"{6 / SPACING * 10 ** 0.5:.5f},1,1"
WEST, EAST = (600_300, 6_000_500), (601_150, 6_000_300)
NEAR_FAULT = (600_740, 6_000_500)
# Seeds as an interpreter picks them: west and east of the fault, layer by layer downwards.
LAYERS = {1: [(WEST, -15), (NEAR_FAULT, -8), (WEST, -60), (EAST, -40), (EAST, -110)],
          2: [(WEST, -160), (EAST, -155), (EAST, -235)],
          3: [(WEST, -300), (WEST, -372), (EAST, -340)]}
# Porosity, horizontal and vertical permeability (mD) of seal, sand and silt. Unpainted cells are seal.
ROCK = {0: (0.05, 0.1, 0.01), 1: (0.05, 0.1, 0.01), 2: (0.22, 200, 20), 3: (0.12, 20, 2)}
# Open intervals of the wells: x, y, top and bottom of the sand.
WELLS = {"I1": (600_125, 6_000_375, -100, -225), "P1": (600_625, 6_000_625, -105, -230),
         "P2": (601_062, 6_000_125, -150, -280)}
INJECTED, PRODUCED_AT = 2500, 180
# Points in the sand on both sides of the fault, between whose cells the steady flow is.
HIGH, LOW, STEADY = (600_125, 6_000_375, -160), (601_062, 6_000_125, -235), 30
FAULTS = 0.001


class Case:
    """The program, the folder of the study, and its figures."""

    def __init__(self, binary, folder):
        self.binary, self.folder, self.figures = pathlib.Path(binary).resolve(), folder, {}

    def atomesh(self, line):
        """Runs a verb and returns its report."""
        print(f"$ atomesh {line}", flush=True)
        command = [self.binary, *line.split(), "--json", "--quiet"]
        return json.loads(subprocess.run(command, cwd=self.folder, check=True, stdout=subprocess.PIPE).stdout)

    def flow(self, case, out, *options):
        """Runs OPM Flow and returns the number of its linear iterations."""
        line = ["flow", f"{case}.DATA", f"--output-dir={out}", *options]
        print("$", *line, flush=True)
        stdout = subprocess.run([*line, "--threads-per-process=1"], cwd=self.folder, check=True,
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout
        return int(re.search(r"Overall Linear Iterations:\s+(\d+)", stdout)[1])

    def table(self, name, columns, row):
        """Writes a CSV file with a line for each region of rock."""
        lines = [",".join(["region", *columns])]
        lines += [",".join(map(str, [number, *row(rock)])) for number, rock in ROCK.items()]
        (self.folder / name).write_text("\n".join(lines) + "\n")

    def solve(self, script, *arguments):
        """Returns the pressures that an independent solver computes."""
        result = subprocess.run([sys.executable, VALIDATORS / script, *map(str, arguments)], cwd=self.folder,
                               check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        return np.array(json.loads(result.stdout)["pressure"])


def survey(case):
    """Writes a survey with two to three clear reflectors and a steep fault as SEG-Y."""
    case.atomesh("synth amplitude -o survey.sgy --dims 64,100,80 --count 1 --signal-to-noise 8")


def model(case, distance):
    """Meshes the survey with cells that conform to the fault and the horizons, and paints the layers."""
    mesh = case.atomesh(f"mesh survey.sgy -o cells.vtu --cells voronoi --feature faults+horizons --threshold 1.2"
                        f" --velocity {VELOCITY} --metric {METRIC} --distance {distance}")
    surfaces = case.atomesh("surface cells.vtu -o surfaces.vtp")["surfaces"]
    seeds = [f"--seed {x},{y},{z}={layer}" for layer, places in LAYERS.items() for (x, y), z in places]
    layers = case.atomesh(f"paint cells.vtu -o layers.vtu {' '.join(seeds)}")["regions"]
    case.atomesh("slice survey.sgy layers.vtu -o layers.png --color region")
    case.table("porosity.csv", ["porosity"], lambda rock: rock[:1])
    case.table("permeability.csv", ["kx", "ky", "kz"], lambda rock: (rock[1], rock[1], rock[2]))
    for name, (x, y, top, bottom) in WELLS.items():
        (case.folder / f"{name}.csv").write_text(f"x,y,z,radius\n{x},{y},{top},0.1\n{x},{y},{bottom},0.1\n")
    case.figures["surfaces"] = [{key: surface[key] for key in ("kind", "area", "dip")} for surface in surfaces]
    case.figures["layers"] = {str(layer["region"]): layer["volume"] for layer in layers}
    return mesh


def export(case, to, out, options):
    """Exports the model to a format and returns the report."""
    return case.atomesh(f"export layers.vtu --to {to} -o {out} --depth-at-top 2000 --porosity porosity.csv"
                        f" --permeability permeability.csv --permeability-unit mD {options}")


def read(folder, case, ending):
    """Returns the arrays of a file of OPM Flow, each with all of its reports."""
    arrays = {}
    for name, values in resfo.read(folder / f"{case}.{ending}"):
        arrays.setdefault(name.strip(), []).append(values)
    return arrays


def ten_years(case):
    """Simulates oil that water displaces, with the fault open and nearly closed."""
    wells = f"--injector I1.csv:{INJECTED} --producer P1.csv:{PRODUCED_AT} --producer P2.csv:{PRODUCED_AT}"
    fluid = f"--fluid oil-water {wells}"
    export(case, "opm", "OPEN.DATA", fluid)
    report = export(case, "opm", "CASE.DATA", f"{fluid} --faults {FAULTS}")
    case.figures["model"] = report["checks"]
    case.figures["iterations"] = {"open, ILU(0)": case.flow("OPEN", "open"),
                                  f"{FAULTS}, ILU(0)": case.flow("CASE", "ilu"),
                                  f"{FAULTS}, CPR": case.flow("CASE", "cpr", "--linear-solver=cpr")}
    mesh = simulated.simulated(case.folder / "CASE.vtu", case.folder / "cpr", "CASE")
    simulated.write(mesh, case.folder / "simulated.vtu")
    for name in ("pressure", "swat"):
        case.atomesh(f"slice simulated.vtu -o {name}.png --view 3d --cut y --color simulated_{name}")

    out = case.folder / "cpr"
    pore_volumes = np.array(read(out, "CASE", "INIT")["PORV"][0], dtype=float)
    mean = [float((np.array(p, dtype=float) * pore_volumes).sum() / pore_volumes.sum())
            for p in read(out, "CASE", "UNRST")["PRESSURE"]]
    names = [name.decode().strip() for name in read(out, "CASE", "SMSPEC")["KEYWORDS"][0]]
    first, last = (dict(zip(names, map(float, read(out, "CASE", "UNSMRY")["PARAMS"][step]))) for step in (0, -1))
    case.figures["ten years"] = {
        "pore volume, m3": float(pore_volumes.sum()), "oil in place, sm3": first["FOIP"] + first["FOPT"],
        "oil left, sm3": last["FOIP"], "oil produced, sm3": last["FOPT"], "water injected, sm3": last["FWIT"],
        "water produced, sm3": last["FWPT"], "mean pressure, bar": [mean[0], mean[-1]]}


def scaled(pressure, high, low):
    """Returns pressures scaled to 0 in one cell and 1 in another."""
    return (pressure - pressure[low]) / (pressure[high] - pressure[low])


def compare_solvers(case):
    """Compares the steady flow of water between two cells through the nearly closed fault in every available solver."""
    ends = [",".join(map(str, point)) for point in (HIGH, LOW)]
    faults = f"--faults {FAULTS}"
    wells = f"--injector {ends[0]}:{STEADY} --producer {ends[1]}:195"
    report = export(case, "opm", "STEADY.DATA", f"{faults} {wells} --no-gravity --days 365000")
    high, low = (well["cells"][0][0] for well in report["wells"])
    case.flow("STEADY", "steady", "--solver-max-time-step-in-days=365000", "--linear-solver-reduction=1e-6",
              "--linear-solver-max-iter=2000")
    pressures = {"OPM Flow": np.array(read(case.folder / "steady", "STEADY", "UNRST")["PRESSURE"][-1], dtype=float)}
    export(case, "mrst", "blocks.mat", f"{faults} {wells}")
    pressures["MRST's grid, SciPy"] = case.solve("mrst.py", "blocks.mat") / 1e5
    export(case, "darts", "blocks.conn", f"{faults} {wells}")
    pressures["open-DARTS"] = case.solve("steady.py", "blocks.conn", "blocks.cells", "blocks.wells")
    # `flow` takes permeabilities in m2.
    case.table("permeability-m2.csv", ["kx", "ky", "kz"],
               lambda rock: [k * 9.86923266716013e-16 for k in (rock[1], rock[1], rock[2])])
    case.atomesh(f"flow layers.vtu -o flow.vtu --permeability permeability-m2.csv {faults}"
                 f" --source {ends[0]}:1e-4 --sink {ends[1]}:1e-4")
    ours = scaled(simulated.cell_array(case.folder / "flow.vtu", "pressure"), high, low)
    case.figures["range, bar"] = float(np.ptp(pressures["OPM Flow"]))
    case.figures["apart"] = {name: float(np.abs(scaled(p, high, low) - ours).max()) for name, p in pressures.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--distance", default="8", help="distance between sites, in samples [default: 8]")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    case = Case(arguments.binary, arguments.folder.resolve())
    survey(case)
    model(case, arguments.distance)
    if shutil.which("flow") is None:
        sys.exit("no OPM Flow here: the cells are made, but not simulated (make validators installs it)")
    ten_years(case)
    compare_solvers(case)
    (case.folder / "figures.json").write_text(json.dumps(case.figures, indent=1) + "\n")
    print(json.dumps(case.figures, indent=1))


if __name__ == "__main__":
    main()
