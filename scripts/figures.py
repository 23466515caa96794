#!/usr/bin/env python3
"""Checks figures in docs/ and makes its pictures: scripts/figures.py BINARY [--check] [--data FOLDER] [--only NAME ...]

Each figure here is a line of a page that the program must reproduce. A line that is not in the page is printed, and
the script fails. With `--check` it tests only figures that need nothing but the program and take seconds, that some
pictures look as the program draws them, and that every picture is shown by a page and made by a script.
Without it, the script also writes all pictures to docs/pictures. Pictures of images of other projects need the folder with
these images (BrainT1Slice.png, FatMRISlice.png, 3_fractures_100x100x100_u8.raw, mni_icbm152_t1.nii.gz, also in
its subfolders), those of lattices the examples of the library beside the program, others OPM Flow or headless Chromium.
They stay as they are where something is missing. The script needs no Python package.
"""
import argparse
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile

from pictures import Picture

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAGES = ROOT / "docs"
PICTURES_FOLDER = PAGES / "pictures"
# Wider pictures are halved.
LARGEST_WIDTH = 1000
# Largest mean difference, of 255, between a picture and what the program draws. The 256 colours of a file make up to 2.
LARGEST_DIFFERENCE = 8


class Missing(Exception):
    """A program or an image is missing."""


class Work:
    """A folder in which the program runs."""

    def __init__(self, binary, folder, data=None):
        self.binary, self.folder, self.data = pathlib.Path(binary).resolve(), pathlib.Path(folder), data

    def other(self, name):
        """Returns the path of an image of another project."""
        found = next(self.data.rglob(name), None) if self.data else None
        if not found:
            raise Missing(name)
        return found

    def run(self, line):
        """Runs the program without output. A line may also begin with `example`, `tool` or `page`."""
        kind, *words = line.split()
        if kind == "page":
            self.photograph(*words)
            return
        if kind == "example":
            program = self.binary.parent / "examples" / words.pop(0)
        elif kind == "tool":
            program = shutil.which(words[0]) or ROOT / words[0]
            words = words[1:]
        else:
            program, words = self.binary, [kind, *words, "--quiet"]
        if not pathlib.Path(program).exists():
            raise Missing(program)
        subprocess.run([program, *words], cwd=self.folder, check=True, stdout=subprocess.DEVNULL)

    def photograph(self, page, picture, width, height, kind):
        """Opens a page in headless Chromium, as on a `desk` or a dark `phone`."""
        sys.path.insert(0, str(ROOT / "tests" / "data" / "page"))
        from browser import Browser, find_browser
        if not find_browser():
            raise Missing("Chromium")
        with Browser(find_browser()) as browser:
            browser.window(int(width), int(height), dark=kind == "phone", phone=kind == "phone")
            browser.open(str(self.folder / page))
            browser.shot(self.folder / picture)

    def draw(self, name):
        """Makes a picture. In its lines `{0}` is its file, or `{0}` and `{1}` are those of two pictures side by side."""
        lines, ending = PICTURES[name], name.split(".")[-1]
        parts = [f"part{n}.{ending}" for n in range(1 + any("{1}" in line for line in lines))]
        for line in lines:
            words = [str(self.other(word[5:])) if word.startswith("data:") else word for word in line.split()]
            self.run(" ".join(words).replace("{0}", parts[0]).replace("{1}", parts[-1]))
        if ending == "svg":
            return self.folder / parts[0]
        drawn = [Picture.read(self.folder / part) for part in parts]
        drawn = [picture.halved() if picture.width > LARGEST_WIDTH else picture for picture in drawn]
        return drawn[0] if len(drawn) == 1 else drawn[0].joined(drawn[1])

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
QUICK = [("how-to/two-dimensions.md", plane), ("notes/published-methods.md", generations), ("how-to/nodes-on-edges.md", ball)]


def slices(work):
    work.run(f"mesh {work.other('BrainT1Slice.png')} -o brain.vtu --seeding canny --smooth odt")
    quality = work.json("quality brain.vtu")["quality"]
    angles = f"{quality['smallest_angle']['worst']:.1f} and {quality['largest_angle']['worst']:.1f} degrees"
    return [f"has {quality['nodes']:,} nodes, and every angle is between {angles}"]


def fractures(work):
    count = []
    for distance in ("2.7:8", "4", "8"):
        work.run(f"mesh {work.other('3_fractures_100x100x100_u8.raw')} --raw 100x100x100:u8 --feature mask"
                 f" --distance {distance} -o fractures.vtu")
        count.append(len(work.json("surface fractures.vtu -o fractures.vtp")["surfaces"]))
    return ["one surface at constant distances from 4 to 8, but not with the default distance" if count == [3, 2, 2] else str(count)]


# Pages with figures of images of other projects.
WITH_DATA = [("how-to/nodes-on-edges.md", slices), ("how-to/take-surfaces-elsewhere.md", fractures)]

UNIT = ["synth amplitude -o image.vti --dims 96,120,80 --count 1 --rng-seed 3 --signal-to-noise 8",
        "mesh image.vti -o mesh.vtu --distance 5 --feature faults+horizons",
        "paint mesh.vtu --seed 62,75,40=1 --seed 62,14,40=1 -o painted.vtu --surface-out unit.vtp"]
SURVEY = ["synth amplitude --dims 96,128,112 --count 2 --rng-seed 3 --signal-to-noise 8 -o survey.sgy",
          "mesh survey.sgy -o mesh.vtu --feature faults+horizons --velocity 2500"]
SLICE = ["synth faults --dims 256,256 --signal-to-noise 20 --rng-seed 1 -o slice.png"]
SMALL_SLICE = ["synth faults --dims 192,132 --signal-to-noise 20 --rng-seed 1 -o slice.png"]
BOTH = ["synth amplitude --dims 128,112,96 --count 3 -o amplitude.vti",
        "mesh amplitude.vti -o both.vtu --feature faults+horizons --distance 6"]
SIMULATED = ["tool flow CASE.DATA --output-dir=out",
             f"tool {ROOT}/.venv/bin/python {ROOT}/scripts/simulated.py CASE.vtu out CASE pressure.vtu"]
# Pictures with the commands of their pages. Those of the reservoir tutorial are made by `make reservoir`.
PICTURES = {
    "tutorial-survey-body.png": [*SURVEY, "slice survey.sgy mesh.vtu -o {0} --view 3d"],
    "tutorial-survey-surfaces.png": [*SURVEY, "surface mesh.vtu -o surfaces.vtp", "slice surfaces.vtp -o {0} --view 3d"],
    "tutorial-scan-body.png": ["synth blocks --dims 56,48,40 --count 2 --rng-seed 4 -o scan.nii.gz",
                               "mesh scan.nii.gz -o mesh.vtu --distance 4 --label 0:name=fat --label 1:name=bone"
                               " --label 2:name=muscle --label 3:name=cartilage",
                               "slice scan.nii.gz mesh.vtu -o {0} --view 3d --color region"],
    "two-dimensions-mesh.png": ["synth faults --dims 256,256 --signal-to-noise 20 --rng-seed 1 -o slice.png",
                                "mesh slice.png -o mesh.vtu --distance 6:18 --distance-from features",
                                "slice slice.png mesh.vtu -o {0}"],
    "two-dimensions-disc.png": ["synth sphere --dims 256,256 --signal-to-noise 10 -o disc.png",
                                "mesh disc.png -o disc.vtu --feature edges", "slice disc.png disc.vtu -o {0}"],
    "figures-sections.png": ["synth amplitude --dims 128,112,96 --count 3 -o amplitude.vti",
                             "mesh amplitude.vti -o both.vtu --feature faults+horizons --distance 6",
                             "slice amplitude.vti both.vtu -o {0}"],
    "figures-potential.png": ["synth faults --dims 256,256 --signal-to-noise 20 --rng-seed 1 -o slice.png",
                              "mesh slice.png -o mesh.vtu --distance 6:18 --distance-from features",
                              "feature slice.png -o b.vti --distance 8", "slice b.vti mesh.vtu -o {0}"],
    "figures-cells.png": ["synth faults --dims 256,256 --signal-to-noise 20 --rng-seed 1 -o slice.png",
                          "mesh slice.png -o cells.vtu --cells voronoi --distance 8", "slice slice.png cells.vtu -o {0}"],
    "editing.png": ["synth faults -o slice.png --dims 160,120 --signal-to-noise 10", "mesh slice.png -o mesh.vtu",
                    "edit mesh.vtu slice.png -o edited.vtu --add 40.5,60 --move 150:104,58 --remove 90",
                    "slice slice.png mesh.vtu -o {0}", "slice slice.png edited.vtu -o {1}"],
    "editing-cells.png": ["synth faults -o slice.png --dims 160,120 --signal-to-noise 10",
                          "mesh slice.png -o cells.vtu --cells voronoi",
                          "edit cells.vtu slice.png -o edited.vtu --add 40.5,60 --move 150:104,58 --remove 90",
                          "slice slice.png cells.vtu -o {0}", "slice slice.png edited.vtu -o {1}"],
    "mesh-labels.png": ["synth blocks --dims 56,48,40 --count 2 --rng-seed 4 -o labels.nrrd",
                        "mesh labels.nrrd -o mesh.vtu --distance 4 --label 1:distance=3,name=bone --label 0:name=fat",
                        "slice mesh.vtu -o {0} --view 3d --cut y --color region"],
    "own-surfaces.png": ["synth amplitude -o survey.vti --dims 56,64,48 --count 1",
                         "mesh survey.vti -o found.vtu --feature faults+horizons --surfaces picks.vtp",
                         "mesh survey.vti --surface picks.vtp -o mesh.vtu --feature none",
                         "slice survey.vti mesh.vtu -o {0} --view 3d --up -x"],
    "faults-image.png": [f"slice {ROOT}/data/faults.vti -o {{0}} --view 3d --at 79,0,0"],
    "faults.png": [f"mesh {ROOT}/data/faults.vti -o faults.vtu", "slice faults.vtu -o {0} --view 3d --at 15,65,50"],
    "slice-3d.png": ["synth amplitude --dims 128,112,96 --count 3 -o amplitude.vti",
                     "mesh amplitude.vti -o both.vtu --feature faults+horizons --distance 6",
                     "slice amplitude.vti both.vtu -o {0} --view 3d"],
    "voronoi.png": ["synth faults -o faults.vti --truth distance.npy --dims 128,128,128",
                    "mesh faults.vti --align alongside --cells voronoi --distance 8 -o cells.vtu",
                    "slice cells.vtu -o {0} --view 3d"],
    "flow.png": [f"mesh {ROOT}/data/faults.vti -o faults.vtu --distance 5",
                 "flow faults.vtu --source 15,60,20 --sink 60,12,20 --faults 0.01 -o flow.vtu --streamlines lines.vtp --lines 40",
                 "slice flow.vtu lines.vtp -o {0} --view 3d --cut z --color pressure"],
    "flow-plane.png": ["synth planes -o faults.vti --dims 160,120 --count 4 --rng-seed 5",
                       "mesh faults.vti -o faults.vtu --distance 5 --feature ridges",
                       "flow faults.vtu --source 15,20 --sink 145,100 --faults 0.01 -o flow.vtu --streamlines lines.vtp --lines 30",
                       "slice faults.vti flow.vtu lines.vtp -o {0} --color pressure"],
    "surfaces.png": ["synth faults -o faults.vti --dims 170,150,128", "mesh faults.vti -o mesh.vtu",
                     "surface mesh.vtu -o surfaces.vtp", "slice surfaces.vtp -o {0} --view 3d"],
    "unit.png": [*UNIT, "slice image.vti painted.vtu -o {0} --view 3d --cut z --up -x --color region"],
    "unit-surface.png": [*UNIT, "slice unit.vtp -o {0} --view 3d --up -x"],
    "beyond-the-image.png": [f"mesh {ROOT}/data/faults.vti --distance 6 --pad above=80,below=60,sides=60 -o padded.vtu",
                             "slice padded.vtu -o {0} --view 3d --cut y --color region"],
    "figures-pair.svg": [*SLICE, "example lattice slice.png {0} atom.png distance.png"],
    "figures-atom.png": [*SLICE, "example lattice slice.png pair.svg {0} distance.png"],
    "figures-distance.png": [*SLICE, "example lattice slice.png pair.svg atom.png {0}"],
    "two-dimensions-before.png": [*SLICE, "example potential slice.png 8 {0} after.png"],
    "two-dimensions-after.png": [*SLICE, "example potential slice.png 8 before.png {0}"],
    "guide-tables.png": [*SMALL_SLICE, "example seeds 8 draw slice.png", "tool mv guide.png {0}"],
    "projection.png": [*SMALL_SLICE, "example seeds 8 draw slice.png", "tool mv projection.png {0}"],
    "genetic.png": [*SMALL_SLICE, "mesh slice.png --distance 8 --seeding guide --optimizer genetic -o evolved.vtu",
                    "slice slice.png evolved.vtu -o {0}"],
    "page.png": [*BOTH, "report amplitude.vti both.vtu -o page.html", "page page.html {0} 1000 633 desk"],
    "page-phone.png": [*BOTH, "report amplitude.vti both.vtu -o page.html", "page page.html {0} 360 640 phone"],
    "reservoir.png": [f"mesh {ROOT}/data/faults.vti --cells voronoi --distance 6 -o cells.vtu",
                      "export cells.vtu --to opm -o CASE.DATA --down z --depth-at-top 2000 --no-gravity --porosity 0.2"
                      " --permeability 100 --permeability-unit mD --faults 0.001 --injector 10,10,10:5 --producer 70,60,55:190",
                      *SIMULATED, "slice pressure.vtu -o {0} --view 3d --cut y --color simulated_pressure"],
    "canny.png": ["mesh data:BrainT1Slice.png -o brain.vtu --seeding canny --smooth odt",
                  "slice data:BrainT1Slice.png brain.vtu -o {0}"],
    "paths.png": ["feature data:FatMRISlice.png -o b.png --feature paths --object 128,128 --confidence-out confidence.vti",
                  "mesh data:FatMRISlice.png -o paths.vtu --feature paths --object 128,128",
                  "slice confidence.vti paths.vtu -o {0}", "slice data:FatMRISlice.png paths.vtu -o {1}"],
    "segmentation-brain.png": ["mesh data:mni_icbm152_t1.nii.gz -o mni.vtu --feature edges --distance 5 --slivers none",
                               "segment data:mni_icbm152_t1.nii.gz mni.vtu --object -33,17,27:-27,23,33"
                               " --object 27,17,27:33,23,33 --background -98,120,-72:98,134,-60 --background -41,1,-6:-37,5,-2"
                               " --background -5,13,3:-1,17,7 --background -14,43,-21:-10,47,-17 -o white.vtu",
                               "slice data:mni_icbm152_t1.nii.gz mni.vtu -o {0}",
                               "slice data:mni_icbm152_t1.nii.gz white.vtu -o {1} --color label"],
    "surfaces-fractures.png": ["mesh data:3_fractures_100x100x100_u8.raw --raw 100x100x100:u8 --feature mask -o mesh.vtu",
                               "surface mesh.vtu -o surfaces.vtp", "slice surfaces.vtp -o {0} --view 3d"],
    "columns.png": ["synth planes -o faultmap.png --dims 160,120 --count 3 --rng-seed 5",
                    "mesh faultmap.png --cells voronoi --distance 8 --feature ridges -o map.vtu",
                    "columns map.vtu --horizon 2000 --horizon 2012 --horizon 2020 --layers 3,5 -o cells.vtu",
                    "export cells.vtu --to opm -o CASE.DATA --down z --porosity 0.2 --permeability 100,100,10"
                    " --permeability-unit mD --faults 0.001 --injector 20,20,2010:50 --producer 140,100,2010:90",
                    *SIMULATED, "slice pressure.vtu -o {0} --view 3d --up -z --color simulated_pressure"],
}
# Pictures that `--check` draws again.
CHECKED = ("faults-image.png", "faults.png", "two-dimensions-mesh.png", "figures-potential.png", "flow-plane.png", "unit.png")
# What the names of pictures by another script begin with.
MADE_ELSEWHERE = {"tutorial-reservoir-": "scripts/reservoir.py"}


def compare(work, page, figures):
    """Prints the figures that a page does not have, and returns True if it has all."""
    text = " ".join((PAGES / page).read_text().split())
    missing = [line for line in figures(work) if line not in text]
    for line in missing:
        print(f"docs/{page} does not have: {line}")
    return not missing


def unnamed():
    """Yields the pictures that no page shows, or that no script makes."""
    pages = [*PAGES.rglob("*.md"), ROOT / "README.md"]
    shown = " ".join(page.read_text(encoding="utf-8") for page in pages)
    for file in sorted(PICTURES_FOLDER.iterdir()):
        if file.name not in shown:
            yield f"docs/pictures/{file.name}: no page shows it"
        if file.name not in PICTURES and not file.name.startswith(tuple(MADE_ELSEWHERE)):
            yield f"docs/pictures/{file.name}: no script makes it; add it to scripts/figures.py"


def write(work, name):
    """Writes a picture, unless something that it needs is missing."""
    try:
        picture = work.draw(name)
    except Missing as missing:
        print(f"docs/pictures/{name} stays as it is: {missing} is missing")
        return
    if isinstance(picture, Picture):
        picture.write(PICTURES_FOLDER / name)
    else:
        shutil.copy(picture, PICTURES_FOLDER / name)
    print(f"wrote docs/pictures/{name}")


def is_current(work, name):
    """Returns True if a picture looks as the program draws it."""
    difference = work.draw(name).difference(Picture.read(PICTURES_FOLDER / name))
    if difference > LARGEST_DIFFERENCE:
        print(f"docs/pictures/{name}: differs by {difference:.1f} of 255; run make figures")
    return difference <= LARGEST_DIFFERENCE


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("binary")
    parser.add_argument("--check", action="store_true", help="write nothing, and compare only what takes seconds")
    parser.add_argument("--data", type=pathlib.Path, help="folder of images of other projects")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="only write these pictures")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        work = Work(options.binary, folder, options.data and options.data.resolve())
        figures = [] if options.only else QUICK + (WITH_DATA if work.data and not options.check else [])
        # The lists make sure that all are compared, even after one that differs.
        agree = [compare(work, page, find) for page, find in figures]
        if options.check:
            agree += [is_current(work, name) for name in CHECKED]
        else:
            for name in options.only or PICTURES:
                write(work, name)
        for error in unnamed():
            agree.append(False)
            print(error)
    print("docs agree" if all(agree) else "docs differ")
    sys.exit(not all(agree))


if __name__ == "__main__":
    main()
