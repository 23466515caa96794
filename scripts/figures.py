#!/usr/bin/env python3
"""Checks figures in docs/ and writes its pictures: scripts/figures.py BINARY [--check] [--data FOLDER]

Each figure here is a line of a page that the program must reproduce. A line that is not in the page is printed, and
the script fails. With `--check` it tests only figures that need nothing but the program and take seconds. Without it,
the script also writes the pictures to target/figures under their names in docs/pictures/, where they have a
smaller size.
Pictures of images of other projects need the folder with these images (BrainT1Slice.png,
FatMRISlice.png, 3_fractures.raw, SEISMIC3D.sgy), and are skipped without it. Pictures of simulation results are not made here; their
pages show the commands. The script needs no Python package.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent


class Work:
    """A folder in which the program runs."""

    def __init__(self, binary, folder):
        self.binary, self.folder = pathlib.Path(binary).resolve(), folder

    def run(self, line):
        """Runs the program without output."""
        subprocess.run([self.binary, *line.split(), "--quiet"], cwd=self.folder, check=True, stdout=subprocess.DEVNULL)

    def json(self, line):
        """Runs the program and returns its JSON output."""
        command = [self.binary, *line.split(), "--json", "--quiet"]
        return json.loads(subprocess.run(command, cwd=self.folder, check=True, stdout=subprocess.PIPE).stdout)


def plane_row(work, name, image, mesh):
    """Returns a row of the table of how-to/two-dimensions.md."""
    work.run(f"synth {image} --dims 256,256 -o slice.png --truth truth.npy")
    work.run(f"mesh slice.png -o mesh.vtu {mesh}")
    report = work.json("quality mesh.vtu --truth truth.npy")
    quality, faces = report["quality"], report["fidelity"]["tagged_faces"]
    angles = f"{quality['smallest_angle']['worst']:.1f} to {quality['largest_angle']['worst']:.1f}"
    ratio = f"{quality['mean_ratio']['worst']:.3f} | {quality['mean_ratio_mean']:.3f}"
    return f"| {name} | {quality['cells']} | {angles} | {ratio} | {faces['coverage_one']:.3f} | {faces['precision']:.3f} |"


def plane(work):
    rows = [plane_row(work, "the picture above (d 6 to 18)", "faults --signal-to-noise 20 --rng-seed 1",
                      "--distance 6:18 --distance-from features")]
    images = [(f"`faults`, seed {seed}", f"faults --rng-seed {seed}") for seed in (1, 2, 3, 4)]
    images += [(f"`{kind}`", kind) for kind in ("planes", "shells", "sphere", "blocks")]
    return rows + [plane_row(work, name, f"{image} --signal-to-noise 10", "--distance 8") for name, image in images]


def generations(work):
    work.run("synth faults -o slice.npy --dims 128,112")
    report = work.json("mesh slice.npy --feature horizons --distance 8 --seeding guide --optimizer genetic --slivers none "
                      "--trace lattices.pvd -o evolved.vtu")
    trace = report["trace"]
    rows = [trace[n] for n in (0, 12, 24, 48, 72, 108)]
    return [f"| {n} | {row['worst_quality']:.3f} | {row['mean_quality']:.3f} | {row['energy']:.3f} |"
            for n, row in zip((0, 12, 24, 48, 72, 108), rows)]


def ball(work):
    work.run("synth sphere --dims 128,128,128 --signal-to-noise inf -o ball.vti")
    quality = work.json("mesh ball.vti -o ball.vtu --seeding canny --feature canny --slivers none")["quality"]
    return [f"has {quality['nodes']:,} and {quality['cells']:,}."]


# Pages with the functions that return their figures.
QUICK = [("how-to/two-dimensions.md", plane), ("notes/published-methods.md", generations), ("how-to/use-few-nodes.md", ball)]


def slices(work):
    work.run(f"mesh {work.data}/BrainT1Slice.png -o brain.vtu --seeding canny --smooth odt")
    quality = work.json("quality brain.vtu")["quality"]
    angles = f"{quality['smallest_angle']['worst']:.1f} and {quality['largest_angle']['worst']:.1f} degrees"
    return [f"has {quality['nodes']:,} nodes, and every angle is between {angles}"]


def fractures(work):
    count = set()
    for distance in ("2.7:8", "4", "5", "6", "8"):
        work.run(f"mesh {work.data}/3_fractures.raw --raw 100x100x100:u8 --feature mask --distance {distance} -o fractures.vtu")
        count.add(len(work.json("surface fractures.vtu -o fractures.vtp")["surfaces"]))
    number = ["no", "one", "two", "three", "four", "five", "six"]
    return [f"{number[count.pop()]} surfaces at any distance from 2.7 to 8" if len(count) == 1 else str(count)]


# Pages with figures of images of other projects.
WITH_DATA = [("how-to/use-few-nodes.md", slices), ("how-to/take-surfaces-elsewhere.md", fractures)]

UNIT = ["synth amplitude -o image.vti --dims 96,120,80 --count 1 --rng-seed 3 --signal-to-noise 8",
        "mesh image.vti -o mesh.vtu --distance 5 --feature faults+horizons",
        "paint mesh.vtu --seed 62,75,40=1 --seed 62,14,40=1 -o painted.vtu --surface-out unit.vtp"]
SURVEY = ["synth amplitude --dims 96,128,112 --count 2 --rng-seed 3 --signal-to-noise 8 -o survey.sgy",
          "mesh survey.sgy -o mesh.vtu --feature faults+horizons --velocity 2500"]
# Pictures with the commands of their pages. Those of the reservoir tutorial are made by `make reservoir`.
PICTURES = {
    "tutorial-survey-body.png": [*SURVEY, "slice survey.sgy mesh.vtu -o {} --view 3d"],
    "tutorial-survey-surfaces.png": [*SURVEY, "surface mesh.vtu -o surfaces.vtp", "slice surfaces.vtp -o {} --view 3d"],
    "tutorial-scan-body.png": ["synth blocks --dims 56,48,40 --count 2 --rng-seed 4 -o scan.nii.gz",
                               "mesh scan.nii.gz -o mesh.vtu --distance 4 --label 0:name=fat --label 1:name=bone"
                               " --label 2:name=muscle --label 3:name=cartilage",
                               "slice scan.nii.gz mesh.vtu -o {} --view 3d --color region"],
    "two-dimensions-mesh.png": ["synth faults --dims 256,256 --signal-to-noise 20 --rng-seed 1 -o slice.png",
                                "mesh slice.png -o mesh.vtu --distance 6:18 --distance-from features",
                                "slice slice.png mesh.vtu -o {}"],
    "two-dimensions-disc.png": ["synth sphere --dims 256,256 --signal-to-noise 10 -o disc.png",
                                "mesh disc.png -o disc.vtu --feature edges", "slice disc.png disc.vtu -o {}"],
    "figures-sections.png": ["synth amplitude --dims 128,112,96 --count 3 -o amplitude.vti",
                             "mesh amplitude.vti -o both.vtu --feature faults+horizons --distance 6",
                             "slice amplitude.vti both.vtu -o {}"],
    "figures-potential.png": ["synth faults --dims 256,256 --signal-to-noise 20 --rng-seed 1 -o slice.png",
                              "mesh slice.png -o mesh.vtu --distance 6:18 --distance-from features",
                              "feature slice.png -o b.vti --distance 8", "slice b.vti mesh.vtu -o {}"],
    "figures-cells.png": ["synth faults --dims 256,256 --signal-to-noise 20 --rng-seed 1 -o slice.png",
                          "mesh slice.png -o cells.vtu --cells voronoi --distance 8", "slice slice.png cells.vtu -o {}"],
    "editing.png": ["synth faults -o slice.png --dims 160,120 --signal-to-noise 10", "mesh slice.png -o mesh.vtu",
                    "edit mesh.vtu slice.png -o edited.vtu --add 40.5,60 --move 150:104,58 --remove 90",
                    "slice slice.png edited.vtu -o {}"],
    "editing-cells.png": ["synth faults -o slice.png --dims 160,120 --signal-to-noise 10",
                          "mesh slice.png -o cells.vtu --cells voronoi",
                          "edit cells.vtu slice.png -o edited.vtu --add 40.5,60 --move 150:104,58 --remove 90",
                          "slice slice.png edited.vtu -o {}"],
    "mesh-labels.png": ["synth sphere --dims 64,64,64 --signal-to-noise 20 -o ball.nrrd",
                        "mesh ball.nrrd -o first.vtu --feature edges --distance 4",
                        "segment ball.nrrd first.vtu --object 32,32,32 --background 2,2,2 -o cells.vtu --labels-out labels.nrrd",
                        "mesh labels.nrrd -o mesh.vtu --label 1:distance=3,name=ball",
                        "slice mesh.vtu -o {} --view 3d --cut x --color region"],
    "faults-image.png": [f"slice {ROOT}/data/faults.vti -o {{}} --view 3d --at 79,0,0"],
    "faults.png": [f"mesh {ROOT}/data/faults.vti -o faults.vtu", "slice faults.vtu -o {} --view 3d --at 15,65,50"],
    "slice-3d.png": ["synth amplitude --dims 128,112,96 --count 3 -o amplitude.vti",
                     "mesh amplitude.vti -o both.vtu --feature faults+horizons --distance 6",
                     "slice amplitude.vti both.vtu -o {} --view 3d"],
    "voronoi.png": ["synth faults -o faults.vti --truth distance.npy --dims 128,128,128",
                    "mesh faults.vti --align alongside --cells voronoi --distance 8 -o cells.vtu",
                    "slice cells.vtu -o {} --view 3d"],
    "flow.png": [f"mesh {ROOT}/data/faults.vti -o faults.vtu --distance 5",
                 "flow faults.vtu --source 15,60,20 --sink 60,12,20 --faults 0.01 -o flow.vtu --streamlines lines.vtp --lines 40",
                 "slice flow.vtu lines.vtp -o {} --view 3d --cut z --color pressure"],
    "flow-plane.png": ["synth planes -o faults.vti --dims 160,120 --count 4 --rng-seed 5",
                       "mesh faults.vti -o faults.vtu --distance 5 --feature ridges",
                       "flow faults.vtu --source 15,20 --sink 145,100 --faults 0.01 -o flow.vtu --streamlines lines.vtp --lines 30",
                       "slice faults.vti flow.vtu lines.vtp -o {} --color pressure"],
    "surfaces.png": ["synth faults -o faults.vti --dims 170,150,128", "mesh faults.vti -o mesh.vtu",
                     "surface mesh.vtu -o surfaces.vtp", "slice surfaces.vtp -o {} --view 3d"],
    "unit.png": [*UNIT, "slice image.vti painted.vtu -o {} --view 3d --cut z --up -x --color region"],
    "unit-surface.png": [*UNIT, "slice unit.vtp -o {} --view 3d --up -x"],
}
PICTURES_WITH_DATA = {
    "canny.png": ["mesh {data}/BrainT1Slice.png -o brain.vtu --seeding canny --smooth odt",
                  "slice {data}/BrainT1Slice.png brain.vtu -o {}"],
    "paths.png": ["mesh {data}/FatMRISlice.png -o paths.vtu --feature paths --object 128,128",
                  "slice {data}/FatMRISlice.png paths.vtu -o {}"],
    "surfaces-fractures.png": ["mesh {data}/3_fractures.raw --raw 100x100x100:u8 --feature mask -o mesh.vtu",
                               "surface mesh.vtu -o surfaces.vtp", "slice surfaces.vtp -o {} --view 3d"],
    "horizons.png": ["mesh {data}/SEISMIC3D.sgy -o mesh.vtu --feature horizons",
                     "slice {data}/SEISMIC3D.sgy mesh.vtu -o {} --view 3d"],
}


def compare(work, page, figures):
    """Prints the figures that a page does not have, and returns True if it has all."""
    text = " ".join((ROOT / "docs" / page).read_text().split())
    missing = [line for line in figures(work) if line not in text]
    for line in missing:
        print(f"docs/{page} does not have: {line}")
    return not missing


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("binary")
    parser.add_argument("--check", action="store_true", help="only compare figures that take seconds")
    parser.add_argument("--data", type=pathlib.Path, help="folder of images of other projects")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        work = Work(options.binary, folder)
        work.data = options.data and options.data.resolve()
        figures = QUICK + (WITH_DATA if work.data and not options.check else [])
        # The list makes sure that all pages are compared, even after one that differs.
        agree = all([compare(work, page, find) for page, find in figures])
        if not options.check:
            out = ROOT / "target" / "figures"
            out.mkdir(parents=True, exist_ok=True)
            for name, lines in {**PICTURES, **(PICTURES_WITH_DATA if work.data else {})}.items():
                for line in lines:
                    work.run(line.replace("{data}", str(work.data)).replace("{}", str(out / name)))
                print(f"wrote {out / name}")
    print("docs agree" if agree else "docs differ")
    sys.exit(not agree)


if __name__ == "__main__":
    main()
