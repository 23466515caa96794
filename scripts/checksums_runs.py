"""The runs of scripts/checksums.py and their input images."""

import math
import re
import shlex
import struct
from array import array
from pathlib import Path

RUNS = {}


def run(name, command):
    """Adds a run. In its command `@other/file` is an output of the run `other`, `@inputs/file` a file of `write_inputs`,
    and `@data/file` a real image. Outputs without a folder are in the folder of the run."""
    if name in RUNS:
        raise ValueError(f"two runs are called {name}")
    RUNS[name] = command


# Options by number of dimensions.
MESH = {2: "mesh @faults2/image.png -o mesh.vtu --feature ridges",
        3: "mesh @faults3/image.vti -o mesh.vtu --feature ridges"}
DISTANCE = {2: "", 3: "--distance 6"}
SCALES = {2: "2,1", 3: "2,1,0.5"}


def synthetic_images():
    for kind in ("planes", "faults", "amplitude", "sphere", "shells", "blocks"):
        run(f"synth2-{kind}", f"synth {kind} --dims 64,56 -o image.npy --truth truth.npy")
        run(f"synth3-{kind}", f"synth {kind} --dims 28,26,24 --rng-seed 2 -o image.npy --truth truth.npy")
    run("faults2", "synth faults --dims 120,100 --signal-to-noise 10 -o image.png --truth truth.npy")
    run("faults3", "synth faults --dims 40,36,32 --count 2 --signal-to-noise 20 -o image.vti --truth truth.npy")
    run("amplitude2", "synth amplitude --dims 220,180 --count 2 --signal-to-noise 10 --rng-seed 4 -o image.npy")
    run("amplitude3", "synth amplitude --dims 56,48,40 --count 1 --signal-to-noise 8 --rng-seed 3 -o image.nrrd")
    run("sphere2", "synth sphere --dims 80,72 --signal-to-noise 10 -o image.npy --truth truth.npy")
    run("sphere3", "synth sphere --dims 36,34,32 --signal-to-noise 10 -o image.npy --truth truth.npy")


def features():
    images_of_kind = {
        "ridges": {2: "@faults2/image.png", 3: "@faults3/image.vti"},
        "valleys": {2: "@inputs/valleys2.npy", 3: "@inputs/valleys3.npy"},
        "edges": {2: "@sphere2/image.npy", 3: "@sphere3/image.npy"},
        "canny": {2: "@sphere2/image.npy", 3: "@sphere3/image.npy"},
        "horizons": {2: "@amplitude2/image.npy", 3: "@amplitude3/image.nrrd"},
        "faults": {2: "@amplitude2/image.npy", 3: "@amplitude3/image.nrrd"},
        "faults+horizons": {2: "@amplitude2/image.npy", 3: "@amplitude3/image.nrrd"},
        "labels": {2: "@inputs/labels2.npy", 3: "@inputs/labels3.npy"},
        "potential": {2: "@feature2-ridges/b.npy", 3: "@feature3-ridges/b.npy"},
        "auto": {2: "@amplitude2/image.npy", 3: "@sphere3/image.npy"},
    }
    for kind, images in images_of_kind.items():
        for dimension, image in images.items():
            name = f"{dimension}-{kind}"
            run(f"feature{name}", f"feature {image} -o b.npy --feature {kind} --distance 6")
            run(f"mesh{name}", f"mesh {image} -o mesh.vtu --feature {kind} --distance 7")
    run("feature2-paths", "feature @sphere2/image.npy -o b.png --feature paths --object 40,36"
        " --confidence-out confidence.npy")
    run("mesh2-paths", "mesh @sphere2/image.npy -o mesh.vtu --feature paths --object 40,36"
        " --background 2,2 --background 77,70 --background 3,69 --background 76,3 --rng-seed 5")
    run("feature3-sigma", "feature @faults3/image.vti -o b.vti --feature ridges --sigma 2 --threshold 0.2")
    run("feature3-weights", "feature @amplitude3/image.nrrd -o b.npy --feature faults+horizons"
        " --feature-weights 1,0.5")


def meshes():
    for dimension, mesh in MESH.items():
        def vary(name, options):
            distance = DISTANCE[dimension] if "--distance" not in options else ""
            run(f"mesh{dimension}-{name}", f"{mesh} {options} {distance}")

        vary("everything", "--report report.json --trace trace.pvd --potential-out b.vti")
        run(f"mesh{dimension}-seeding-canny", f"{mesh} --seeding canny")
        for seeding in ("grown", "refine", "guide", "projection"):
            vary(f"seeding-{seeding}", f"--seeding {seeding}")
        vary("seeding-guide-few", "--seeding guide --max-atoms 100")
        for optimizer in ("descent", "genetic"):
            vary(f"optimizer-{optimizer}", f"--optimizer {optimizer}")
        vary("sampled", "--evaluator sampled")
        vary("no-slivers", "--slivers none")
        vary("min-dihedral", "--min-dihedral 25")
        vary("kappa", "--kappa 0.7")
        vary("coarse-to-fine", "--coarse-to-fine 2")
        vary("rounds", "--rounds 3")
        vary("max-evaluations", "--max-evaluations 10")
        vary("beta", "--beta 0.3")
        vary("beta-image", f"--beta @inputs/beta{dimension}.npy")
        for source in ("features", "image", "laplacian", f"@inputs/distance{dimension}.npy"):
            vary(f"distance-from-{source.split('/')[-1]}", f"--distance 5:9 --distance-from {source}")
        vary("metric", f"--metric {SCALES[dimension]}")
        vary("atoms-from", f"--atoms-from @inputs/atoms{dimension}.csv")
        vary("grown-atoms", f"--seeding grown --atoms-from @inputs/atoms{dimension}.csv")
        vary("well", f"--well @inputs/well{dimension}.csv --well-distance 3")
        vary("rng-seed", "--rng-seed 7")
        # The metric of images whose samples have different spacings along the axes.
        for metric in ("samples", "physical"):
            run(f"mesh{dimension}-spaced-{metric}", f"mesh @inputs/spaced{dimension}.nrrd -o mesh.vtu"
                f" --feature ridges --distance 7 --metric {metric}")
        run(f"cells{dimension}", f"{mesh} --cells voronoi --report report.json {DISTANCE[dimension]}")
        for name, options in {
            "seeding-refine": "--seeding refine",
            "seeding-guide": "--seeding guide",
            "seeding-grown": "--seeding grown --atoms-from @inputs/atoms{}.csv",
            "weld": "--weld 0.05",
            "distance-from-features": "--distance 5:9 --distance-from features",
            "well": "--well @inputs/well{}.csv --well-distance 3",
            "genetic": "--optimizer genetic",
            "sampled": "--evaluator sampled",
            "metric": f"--metric {SCALES[dimension]}",
            "coarse-to-fine": "--coarse-to-fine 1",
        }.items():
            distance = DISTANCE[dimension] if "--distance" not in options else ""
            run(f"cells{dimension}-{name}", f"{mesh} --cells voronoi {options.format(dimension)} {distance}")
        run(f"cells{dimension}-spaced", f"mesh @inputs/spaced{dimension}.nrrd -o mesh.vtu --feature ridges"
            " --distance 7 --metric physical --align alongside")
    run("mesh3-exude", f"{MESH[3]} --slivers exude --report report.json --distance 6")
    run("cells3-horizons", "mesh @amplitude3/image.nrrd -o mesh.vtu --feature faults+horizons --cells voronoi"
        " --distance 7")
    for scheme in ("cvt", "odt"):
        run(f"mesh2-smooth-{scheme}", f"{MESH[2]} --smooth {scheme}")
        run(f"mesh2-canny-smooth-{scheme}", f"mesh @sphere2/image.npy -o mesh.vtu --seeding canny --smooth {scheme}")
    run("mesh3-canny-canny", "mesh @sphere3/image.npy -o mesh.vtu --seeding canny --feature canny")


ALL_MESHES = ("mesh2-everything", "mesh3-everything", "cells2", "cells3", "columns")


def images():
    for ending in ("vti", "npy", "nrrd", "mha", "nii", "nii.gz"):
        run(f"convert3-{ending}", f"convert @inputs/spaced3.nrrd image.{ending}")
        run(f"convert3-back-{ending}", f"convert @convert3-{ending}/image.{ending} image.nrrd")
        run(f"convert2-{ending}", f"convert @sphere2/image.npy image.{ending}")
        run(f"info3-{ending}", f"info @convert3-{ending}/image.{ending}")
    run("convert2-png", "convert @sphere2/image.npy image.png")
    run("convert2-back-png", "convert @convert2-png/image.png image.npy")
    run("convert-raw", "convert --raw 9x8x7:u16be @inputs/bare.raw image.npy")


def figures():
    for mesh in ALL_MESHES:
        run(f"info-{mesh}", f"info @{mesh}/mesh.vtu")
        run(f"quality-{mesh}", f"quality @{mesh}/mesh.vtu")
        run(f"validate-{mesh}", f"validate @{mesh}/mesh.vtu")
    for mesh in ALL_MESHES[:4]:
        faults = "faults2" if "2" in mesh else "faults3"
        image = f"@{faults}/image." + ("png" if "2" in mesh else "vti")
        run(f"truth-{mesh}", f"quality @{mesh}/mesh.vtu --truth @{faults}/truth.npy")
        run(f"slice-{mesh}", f"slice {image} @{mesh}/mesh.vtu -o picture.png")
    run("slice-at", "slice @faults3/image.vti @mesh3-everything/mesh.vtu -o picture.png --at 10,12,20")
    solid = "slice @faults3/image.vti @mesh3-everything/mesh.vtu -o picture.png --view 3d --color min_dihedral"
    run("slice-corner", solid)
    run("slice-cut", f"{solid} --cut y --up -x")


def surfaces():
    for mesh in (*ALL_MESHES[:4], "mesh3-faults+horizons", "cells3-horizons"):
        for ending in ("vtp", "obj", "ts"):
            run(f"surface-{mesh}-{ending}", f"surface @{mesh}/mesh.vtu -o surfaces.{ending}")
        run(f"paint-{mesh}", f"paint @{mesh}/mesh.vtu --seed auto -o painted.vtu --surface-out units.vtp")
    run("surface-image", "surface @mesh3-everything/mesh.vtu @faults3/image.vti -o surfaces.vtp --feature ridges")
    run("surface-options", "surface @mesh3-everything/mesh.vtu -o surfaces.ts --up -x --max-bend 15 --min-area 30")
    for dimension, seeds in {2: "--seed 20,20 --seed 100,80=4", 3: "--seed 6,6,6 --seed 34,30,26=4"}.items():
        image = {2: "@faults2/image.png", 3: "@faults3/image.vti"}[dimension]
        for kind in (f"mesh{dimension}-everything", f"cells{dimension}"):
            run(f"paint-{kind}-seeds", f"paint @{kind}/mesh.vtu {seeds} -o painted.vtu --image {image} --level 30"
                " --neck 0.1 --surface-out units.obj")


def flow():
    ends = {2: "--source 12,14:0.002 --sink 110,88", 3: "--source 5,6,7 --sink 34,30,26"}
    for dimension, wells in ends.items():
        for mesh in (f"mesh{dimension}-everything", f"cells{dimension}"):
            lines = "-o flow.vtu --streamlines lines.vtp --lines 12"
            run(f"flow-{mesh}", f"flow @{mesh}/mesh.vtu {wells} --faults open {lines}")
            run(f"flow-{mesh}-sides", f"flow @{mesh}/mesh.vtu --pressure xmin=2e5 --pressure xmax=1e5 --faults 0.01"
                f" --fault-thickness 0.5 --fault-multiplier 1:0.3 --viscosity 0.002 {lines}")
            run(f"flow-{mesh}-closed", f"flow @{mesh}/mesh.vtu --pressure xmin=2e5 --pressure ymax=1e5 {lines}")
            run(f"flow-{mesh}-surfaces", f"flow @{mesh}/mesh.vtu --pressure ymin=2e5 --pressure ymax=1e5 --barriers all"
                " --faults 0.1 --permeability 2e-13 -o flow.vtu")
    run("flow-tensor2", "flow @mesh2-everything/mesh.vtu --pressure xmin=2e5 --pressure xmax=1e5"
        " --permeability 2e-13,1e-13,3e-14 -o flow.vtu")
    run("flow-tensor3", "flow @mesh3-everything/mesh.vtu --pressure xmin=2e5 --pressure xmax=1e5"
        " --permeability 2e-13,1e-13,5e-14,1e-14,2e-14,3e-14 -o flow.vtu --streamlines lines.vtp --lines 12")
    run("flow-regions", "flow @paint-mesh3-everything-seeds/painted.vtu --pressure xmin=2e5 --pressure xmax=1e5"
        " --permeability @inputs/permeability.csv -o flow.vtu")
    run("flow-horizons", "flow @mesh3-faults+horizons/mesh.vtu --pressure xmin=2e5 --pressure xmax=1e5 -o flow.vtu")
    run("flow-columns", "flow @columns/mesh.vtu --pressure xmin=2e5 --pressure xmax=1e5 --faults 0.1 -o flow.vtu")


def segmentation():
    marks = {2: "--object 40,36:44,40 --background 3,3 --background 76,68",
             3: "--object 18,17,16 --background 2,2,2:5,5,5 --background 33,31,29"}
    for dimension, marked in marks.items():
        image = f"@sphere{dimension}/image.npy"
        for kind in ("tets", "voronoi"):
            name = f"segment{dimension}-{kind}"
            run(f"{name}-mesh", f"mesh {image} -o mesh.vtu --feature edges --distance 5 --cells {kind}")
            run(name, f"segment {image} @{name}-mesh/mesh.vtu {marked} -o cells.vtu --labels-out labels.npy"
                " --surface-out object.vtp --lambda 0.5 --voxels")
    run("segment3-obj", "segment @sphere3/image.npy @segment3-tets-mesh/mesh.vtu -o cells.vtu --sigma 0.2"
        f" {marks[3]} --labels-out labels.nrrd --surface-out object.obj --truth @inputs/object3.npy")


def edits():
    many = {2: "--add 60.5,50 --move 40:62,70 --remove 33", 3: "--add 20.5,20,15 --move 200:10,12,14 --remove 150"}
    for dimension, options in many.items():
        image = {2: "@faults2/image.png", 3: "@faults3/image.vti"}[dimension]
        edit = f"edit @mesh{dimension}-everything/mesh.vtu {image} -o edited.vtu"
        run(f"edit{dimension}", f"{edit} {options}")
        run(f"edit{dimension}-free", f"{edit} {options} --free")
        run(f"edit{dimension}-file", f"{edit} --edits @inputs/edits{dimension}.csv")
        run(f"edit{dimension}-twice", f"edit @edit{dimension}/edited.vtu {image} -o edited.vtu --remove 60")
    run("edit3-horizons", "edit @mesh3-faults+horizons/mesh.vtu @amplitude3/image.nrrd -o edited.vtu --add 28.5,20,20")
    run("edit3-spaced", "edit @mesh3-spaced-physical/mesh.vtu @inputs/spaced3.nrrd -o edited.vtu --add 130,30,14")


def columns():
    run("columns", "columns @cells2/mesh.vtu --horizon 0 --horizon @inputs/base.npy --horizon 40 --layers 2,3"
        " -o mesh.vtu")
    run("columns-thickness", "columns @cells2/mesh.vtu --horizon 0 --horizon @inputs/base.npy --layer-thickness 4"
        " --least-thickness 11 --z-unit m -o mesh.vtu")
    run("columns-triangles", "columns @mesh2-everything/mesh.vtu --horizon 0 --horizon 10 -o mesh.vtu")
    run("columns-map", "mesh @amplitude3/image.nrrd -o mesh.vtu --feature horizons --distance 7")
    run("columns-surface", "surface @columns-map/mesh.vtu -o surfaces.vtp --up x")
    run("columns-of-surface", "columns @cells2/mesh.vtu --horizon -50 --horizon @columns-surface/surfaces.vtp:1"
        " --horizon 90 -o mesh.vtu")


def export_formats():
    """Yields the export formats that src/export declares: name, extension (empty for a folder), whether the format
    uses depth, and supported contents."""
    source = Path(__file__).parent.parent / "src/export"
    entry = re.compile(r'ExportFormat = ExportFormat \{\s+name: "(\w+)",.*?extensions: &\[(?:"(\w+)")?'
                       r'.*?uses_depth: (\w+),\s+supported_content: (.*?)\s+deck_path:', re.DOTALL)
    for folder in ("simulators", "corner_point", "meshers"):
        for path in sorted((source / folder).rglob("*.rs")):
            for name, extension, uses_depth, contents in entry.findall(path.read_text()):
                contents = contents.replace("NAMES_AND_ROCK", "::Porosity, ::Permeability")
                contents = contents.replace("CONNECTION_LIST", "::Porosity, ::Permeability, ::Faults")
                yield name, extension, uses_depth == "true", re.findall(r"::(\w+)", contents)


def exports():
    filled = "--porosity 0.2 --permeability 100,100,10 --permeability-unit mD"
    rock = f"{filled} --faults 0.01 --depth-at-top 2000"
    wells = "--injector 10,10,10:5 --producer 32,30,24:180"
    for form, extension, uses_depth, contents in export_formats():
        file = f"out.{extension}" if extension else "out"
        options = filled if "Permeability" in contents else ""
        options += " --faults 0.01" if "Faults" in contents else ""
        options += " --depth-at-top 2000" if uses_depth else ""
        for mesh in ALL_MESHES:
            down = " --down z" if mesh == "columns" else ""
            thick = " --thickness 5" if "2" in mesh else ""
            run(f"export-{form}-{mesh}", f"export @{mesh}/mesh.vtu --to {form} -o {file} {options}{down}{thick}")
    run("export-opm-wells", f"export @cells3/mesh.vtu --to opm -o out.DATA {rock} {wells} --no-gravity --days 100")
    run("export-opm-oil", f"export @cells3/mesh.vtu --to opm -o out.DATA {rock} --fluid oil-water"
        " --pressure-at-top 220")
    run("export-opm-trajectory", f"export @cells3-well/mesh.vtu --to opm -o out.DATA {rock}"
        " --injector A=@inputs/well3.csv:50 --producer B=32,30,24:150 --well-radius 0.1")
    run("export-disv-wells", "export @columns/mesh.vtu --to disv -o model --down z --porosity 0.2 --permeability 100"
        " --permeability-unit mD --depth-at-top 1000 --injector 20,20,10:5 --producer 100,80,20:90")
    run("export-mrst-images", "export @cells3/mesh.vtu --to mrst -o out.mat --down z"
        " --porosity @inputs/porosity3.npy:harmonic --permeability @inputs/porosity3.npy --permeability-unit mD"
        " --region @inputs/labels3.npy"
        " --property amplitude=@inputs/valleys3.npy:nearest --depth-at-top 100")
    run("export-resqml-regions", "export @paint-cells3-seeds/painted.vtu --to resqml -o out.epc --porosity 0.2"
        " --permeability @inputs/permeability.csv --permeability-unit m2 --depth-at-top 100 --length-unit ft")
    run("export-grdecl-grid", f"export @cells3/mesh.vtu --to grdecl -o out.GRDECL {rock} --grid 9,8,7")
    run("export-grdecl-regions", "export @paint-cells3-horizons/painted.vtu --to grdecl -o out.GRDECL --porosity 0.2"
        " --permeability 100 --permeability-unit mD --down x --depth-at-top 1000")


def large():
    """Adds large meshes, which are processed in many parts and whose arrays have several blocks."""
    run("large", "synth faults --dims 110,96,84 --signal-to-noise 10 --rng-seed 4 -o image.npy --truth truth.npy")
    for kind in ("tets", "voronoi"):
        mesh = f"large-{kind}"
        run(mesh, f"mesh @large/image.npy -o mesh.vtu --feature ridges --distance 6 --cells {kind}")
        run(f"{mesh}-quality", f"quality @{mesh}/mesh.vtu --truth @large/truth.npy")
        run(f"{mesh}-surface", f"surface @{mesh}/mesh.vtu -o surfaces.vtp")
        run(f"{mesh}-flow", f"flow @{mesh}/mesh.vtu --source 10,12,9 --sink 100,80,70 --faults 0.01 -o flow.vtu"
            " --streamlines lines.vtp")
        run(f"{mesh}-export", f"export @{mesh}/mesh.vtu --to openfoam -o case")


def real_images(data):
    """Adds runs on the files in the folder `data` that exist."""
    def mesh(name, file, options):
        if (data / file).is_file():
            run(f"data-{name}", f"mesh @data/{file} -o mesh.vtu {options}")
            run(f"data-{name}-surface", f"surface @data-{name}/mesh.vtu -o surfaces.vtp")

    mesh("f3", "seismic3d/f3.sgy", "--distance 5")
    mesh("f3-cells", "seismic3d/f3.sgy", "--distance 5 --feature horizons --cells voronoi")
    mesh("f3-sparse", "seismic3d/f3_sparse.sgy", "--distance 5 --feature faults+horizons --metric samples")
    mesh("head", "medical/HeadMRVolume.mhd", "--distance 6 --feature edges")
    mesh("head-canny", "medical/HeadMRVolume.mhd", "--seeding canny")
    mesh("lanl-labels", "synthetic_faults3d_lanl/train_0_fsem.bin",
         "--raw 64x64x64:f32le --distance 9 --feature labels")
    mesh("lanl-faults", "synthetic_faults3d_lanl/train_0_dhr.bin",
         "--raw 64x64x64:f32le --distance 10 --feature faults")
    mesh("slice-faults", "fault3d_f3/f3_fault_timeslice_t30_A.png", "--distance 8")
    mesh("slice-cells", "fault3d_f3/f3_fault_timeslice_t30_A.png", "--distance 8 --cells voronoi")
    mesh("section", "fault2d_f3/f3d75s.dat", "--raw 222x440:f32be --distance 10 --feature faults+horizons")
    mesh("section-faults", "fault2d_f3/fv.dat", "--raw 222x440:f32be --distance 8 --feature ridges")
    mesh("brain", "image2d/BrainT1Slice.png", "--seeding canny --smooth odt")
    mesh("fat", "image2d/FatMRISlice.png", "--feature paths --object 128,128")
    mesh("woman", "image2d/VisibleWomanHeadSlice.png", "--distance 5:12 --distance-from features")
    for folder in ("formats_segy", "formats_nrrd", "formats_nifti_mgh_etc", "formats_metaimage", "image2d"):
        for file in sorted((data / folder).rglob("*")):
            if file.is_file() and file.suffix not in (".md", ".txt"):
                inside = str(file.relative_to(data))
                name, quoted = inside.replace("/", "-"), shlex.quote(f"@data/{inside}")
                run(f"read-{name}", f"info {quoted}")
                run(f"convert-{name}", f"convert {quoted} image.npy")
    # Inputs that once caused failures. Changes of their results are allowed but must be noticed.
    for name, command in {
        "checker": "mesh 2d-checker.npy --seeding canny --feature auto -o out.vtu",
        "rings": "mesh 2d-rings.npy --seeding canny --feature auto -o out.vtu",
        "canny": "mesh inv_canny.npy --seeding canny --feature horizons -o out.vtu",
        "fcc": "mesh inv_fcc_well.npy --feature faults+horizons --distance 2.7 --well inv_fcc_well.csv -o out.vtu",
        "projection": "mesh inv_proj_well.npy --feature faults --seeding projection --distance 2.7 --threshold 0.01"
                      " --optimizer descent --well inv_proj_well.csv -o out.vtu",
        "empty": "mesh empty_mesh.npy --feature auto --distance 2 --min-dihedral 60 -o out.vtu",
        "well": "mesh well_panic.npy -o out.vtu --distance 3 --well well_panic.csv",
        "edit": "edit t2.vtu i2.npy -o out.vtu --add=0.2716134623554075,0",
        "spade": "edit edit_panic_spade.vtu i2.npy -o out.vtu --add 5,6 --remove 3",
        "flips": "edit edit_panic_flips.vtu i3.npy -o out.vtu --add 5,6,7 --remove 3",
        "tetgen": "validate validate_tetgen_abort.vtu",
        "holed": "validate holed.vtu", "inverted": "validate inverted.vtu", "overlap": "validate overlap.vtu",
        "palette": "info palette_panic.png", "ramp": "convert ramp.npy ramp.mha", "msb": "info msb-1.mha",
        "axismins": "info axismins.nrrd", "imagej1": "info imagej1ifd.tif", "imagejzct": "info imagejzct.tif",
        "nii": "info n-1-2d.nii", "range": "convert range3e38.npy range.png",
    }.items():
        words = [f"@data/repro/{word}" if (data / "repro" / word).is_file() else word for word in command.split()]
        if words != command.split():
            run(f"repro-{name}", shlex.join(words))

def add_all(data):
    """Adds all runs, and those on real images if there is a folder of them."""
    for add in (synthetic_images, features, meshes, images, figures, surfaces, flow, segmentation, edits, columns,
                exports, large):
        add()
    if data:
        real_images(data)


def needs_of(command):
    return {need for need in re.findall(r"@([^/\s]+)/", command) if need not in ("inputs", "data")}


def selected(pattern):
    """Returns the names of the runs that match, and the list of these and all that they need, in order."""
    chosen = {name for name in RUNS if pattern.search(name)}
    required, todo = set(), list(chosen)
    while todo:
        name = todo.pop()
        if name not in required:
            required.add(name)
            todo.extend(needs_of(RUNS[name]))
    ordered, done = [], set()

    def add(name):
        if name not in done:
            done.add(name)
            for need in sorted(needs_of(RUNS[name])):
                add(need)
            ordered.append(name)

    for name in RUNS:
        if name in required:
            add(name)
    return chosen, ordered


# --- input images ---


def write_inputs(folder):
    """Writes images, wells and tables, with nothing but basic arithmetic and roots, which are exact on every platform."""
    folder.mkdir()

    def write_npy(name, dims, value, kind="f"):
        (folder / name).write_bytes(npy_head(dims, kind) + samples(dims, value, kind).tobytes())

    def npy_head(dims, kind):
        shape = ", ".join(str(n) for n in reversed(dims))
        head = f"{{'descr': '<{kind}{array(kind).itemsize}', 'fortran_order': False, 'shape': ({shape}), }}"
        head += " " * (-(len(head) + 11) % 64) + "\n"
        return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode()

    def samples(dims, value, kind="f"):
        nx, ny, nz = (*dims, 1)[:3]
        return array(kind, (value(x, y, z) for z in range(nz) for y in range(ny) for x in range(nx)))

    def crossing_planes(x, y, z):
        """Returns the values of two planes that cross (two lines in 2-D)."""
        u = (x - 0.4 * y + 0.2 * z - 12) / 2
        v = (0.3 * x + y - 0.1 * z - 28) / 2
        return 1 / (1 + u * u) ** 2 + 0.7 / (1 + v * v) ** 2

    plane, space = (120, 100), (40, 36, 32)
    for dims, name in ((plane, "2"), (space, "3")):
        write_npy(f"valleys{name}.npy", dims, lambda x, y, z: 1 - crossing_planes(x, y, z))
        write_npy(f"labels{name}.npy", dims, lambda x, y, z: int(x + y // 3 > 22) + 2 * int(y > 20 + z // 4), "i")
        write_npy(f"beta{name}.npy", dims, lambda x, y, z: (x + y) / 400)
        write_npy(f"distance{name}.npy", dims, lambda x, y, z: 5 + math.sqrt(x * x + y * y) / 12)
    write_npy("porosity3.npy", space, lambda x, y, z: 0.1 + (x + 2 * y + z) / 1000)
    write_npy("object3.npy", (36, 34, 32), lambda x, y, z: int((x - 18) ** 2 + (y - 17) ** 2 + (z - 16) ** 2 < 81), "i")
    write_npy("base.npy", plane, lambda x, y, z: 10 + (x * x + 60 * y) / 2000)
    (folder / "bare.raw").write_bytes(b"".join(struct.pack(">H", 7 * i % 1000) for i in range(9 * 8 * 7)))
    for dims, name in (((80, 70, 1), "spaced2"), ((40, 36, 32), "spaced3")):
        head = (f"NRRD0004\ntype: float\ndimension: 3\nspace dimension: 3\nsizes: {' '.join(map(str, dims))}\n"
                "space directions: (2,0,0) (0,1,0) (0,0,0.5)\nspace origin: (100,10,1)\n"
                'space units: "m" "m" "m"\nendian: little\nencoding: raw\n\n')
        (folder / f"{name}.nrrd").write_bytes(head.encode() + samples(dims, crossing_planes).tobytes())
    texts = {
        "atoms2.csv": "30,40\n71.5,52.25\n", "atoms3.csv": "12,13,14\n25.5,20.25,18\n",
        "well2.csv": "30,40,0.2\n71.5,62.25,0.2\n", "well3.csv": "20,12,0,0.1\n21,14,16,0.1\n27,18,25,0.1\n",
        "edits2.csv": "add,30,41\nremove,50\n", "edits3.csv": "add,30,20,11\nremove,250\n",
        "permeability.csv": "0,1e-13\n1,2e-13\n2,5e-14\n4,1e-14\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
