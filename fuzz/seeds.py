#!/usr/bin/env python3
"""Writes the initial corpus of the fuzz targets with a built atomesh: fuzz/seeds.py BINARY FOLDER [FILES...].

FILES are images and meshes that once caused a failure."""

import os
import struct
import subprocess
import sys
import tempfile

# The order must be that of ENDINGS in src/images.rs.
ENDINGS = ["npy", "vti", "nrrd", "mha", "nii", "tif", "png", "sgy", "inr", "nii.gz", "vtk", "mhd", "nhdr", "dcm"]

binary, target, *files = sys.argv[1:]
binary = os.path.abspath(binary)
for kind in ("images", "meshes", "jobs"):
    os.makedirs(os.path.join(target, kind), exist_ok=True)


def write_seed(kind, name, first, content):
    with open(os.path.join(target, kind, name), "wb") as out:
        out.write(bytes([first]) + content)


def content(path):
    with open(path, "rb") as file:
        return file.read()


def image(name, path):
    ending = next((e for e in sorted(ENDINGS, key=len, reverse=True) if path.endswith("." + e)), None)
    if ending and os.path.getsize(path) < 30000:
        write_seed("images", name, ENDINGS.index(ending), content(path))


def mesh(name, path):
    if os.path.getsize(path) < 40000:
        write_seed("meshes", name, 0, content(path))


def survey(lines=4, samples=9):
    """Returns a small SEG-Y volume of IEEE floats."""
    head = bytearray(3600)
    struct.pack_into(">hhh", head, 3216, 4000, 0, samples)
    struct.pack_into(">h", head, 3224, 5)
    traces = []
    for i in range(lines):
        for j in range(lines):
            header = bytearray(240)
            struct.pack_into(">h", header, 70, 1)
            struct.pack_into(">hh", header, 114, samples, 4000)
            struct.pack_into(">iiii", header, 180, 1000 + 25 * j, 2000 + 12 * i, 10 + i, 20 + j)
            values = [(i - j) * k * 0.5 for k in range(samples)]
            traces.append(bytes(header) + struct.pack(f">{samples}f", *values))
    return bytes(head) + b"".join(traces)


def corner_points():
    """Returns a corner-point grid of 2 x 1 x 2 cells, with a fault between the columns."""
    pillars = [f"{x} {y} 0 {x + 1} {y} 9" for y in (0, 5) for x in (0, 5, 10)]
    depths = [" ".join(str(2 + 2 * ((level + 1) // 2) + corner // 2) for corner in range(4))
              for level in range(4) for _ in range(2)]
    return "\n".join(["SPECGRID", "2 1 2 1 F /", "COORD", *pillars, "/", "ZCORN", *depths, "/", "ACTNUM", "3*1 0 /",
                      "PORO", "2*.1 .2 1D-1 /", "FIPNUM", "1 2*2 3 /", "FAULTS", "'F' 1 1 1 1 1 2 I /", "/", ""])


with tempfile.TemporaryDirectory() as folder:
    def run(*arguments):
        subprocess.run([binary, *arguments, "--quiet"], cwd=folder, check=True)

    in_folder = lambda name: os.path.join(folder, name)
    run("synth", "sphere", "-o", "b.npy", "--dims", "9,8,8")
    run("synth", "sphere", "-o", "s.npy", "--dims", "24,20")
    for ending in ("npy", "vti", "nrrd", "mha", "nii", "nii.gz"):
        run("convert", "b.npy", "c." + ending)
        image("space-" + ending, in_folder("c." + ending))
    for ending in ("npy", "png", "nrrd"):
        run("convert", "s.npy", "d." + ending)
        image("plane-" + ending, in_folder("d." + ending))
    with open(in_folder("l.sgy"), "wb") as out:
        out.write(survey())
    image("survey", in_folder("l.sgy"))
    with open(in_folder("g.grdecl"), "w") as out:
        out.write(corner_points())
    run("convert", "g.grdecl", "g.EGRID")
    for ending in ("grdecl", "EGRID"):
        write_seed("images", "grid-" + ending, 0, content(in_folder("g." + ending)))
    run("mesh", "b.npy", "-o", "t.vtu", "--distance", "3", "--feature", "edges")
    run("mesh", "b.npy", "-o", "v.vtu", "--distance", "3", "--cells", "voronoi")
    run("mesh", "s.npy", "-o", "p.vtu", "--distance", "5")
    run("mesh", "s.npy", "-o", "q.vtu", "--distance", "6", "--cells", "voronoi")
    for name in "tvpq":
        mesh("made-" + name, in_folder(name + ".vtu"))
scans = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../tests/data/dicom")
for name in sorted(os.listdir(scans)):
    if name.endswith(".dcm"):
        image("scan-" + name, os.path.join(scans, name))
for path in files:
    name = os.path.basename(path)
    (mesh if path.endswith(".vtu") else image)(name, path)
for n in range(40):
    # Draws of any length.
    write_seed("jobs", f"draw-{n}", n, bytes((37 * n * k + n) % 251 for k in range(1, 60 + n)))
