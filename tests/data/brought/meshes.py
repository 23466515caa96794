"""Brings meshes of other programs into atomesh, in every way in which they are written.

A box of two named bodies, with a named surface between them and a named side, is written by Gmsh, meshio and VTK in their
formats, with each kind of cell, number type, name of the array of regions, and encoding. An independent reader finds the
volume of each body in each file. Then `atomesh export --to msh` must keep the volumes, and the names where the file has
them; Gmsh reads them back.

    meshes.py ATOMESH FOLDER [--only FORMAT,...] [--list]

The combinations are generated as in `matrix.py`. A combination is right, wrong (other volumes or names, without a word), or
refused (exit code 1). The program prints a table and fails if any is wrong, or more than one in ten is refused.
"""

import argparse
import os
import subprocess
import sys

import gmsh
import meshio
import numpy as np
from matrix import pairwise, print_table

# Far corner of the box, and the place of the wall between the bodies along x.
SIZE, WALL = (4.0, 3.0, 2.0), 1.0
ORIGIN = (600000.0, 6000000.0, -2000.0)
NAMES = {"plain": ("Sand", "Shale"), "spaces": ("Top Sand", "Base Shale 2"), "case": ("Bone", "bone")}
VOLUMES = (WALL * SIZE[1] * SIZE[2], (SIZE[0] - WALL) * SIZE[1] * SIZE[2])


def with_gmsh(case, path):
    """Writes a mesh of Gmsh; overlapping groups hold all cells."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        gmsh.model.add("box")
        occ = gmsh.model.occ
        x, y, z = ORIGIN if case["place"] == "far" else (0.0, 0.0, 0.0)
        a = occ.addBox(x, y, z, WALL, SIZE[1], SIZE[2])
        b = occ.addBox(x + WALL, y, z, SIZE[0] - WALL, SIZE[1], SIZE[2])
        occ.fragment([(3, a)], [(3, b)])
        occ.synchronize()
        bodies = sorted((tag for _, tag in gmsh.model.getEntities(3)), key=lambda tag: occ.getCenterOfMass(3, tag)[0])
        for number, (body, name) in enumerate(zip(bodies, NAMES[case["names"]])):
            gmsh.model.addPhysicalGroup(3, [body], 5 + number, name)
        if case["groups"] != "plain":
            number = 1 if case["groups"] == "all first" else 90
            gmsh.model.addPhysicalGroup(3, bodies, number, "everything")
        wall = [t for _, t in gmsh.model.getEntities(2) if abs(occ.getCenterOfMass(2, t)[0] - x - WALL) < 1e-6]
        gmsh.model.addPhysicalGroup(2, wall, 20, "wall")
        side = [t for _, t in gmsh.model.getEntities(2) if abs(occ.getCenterOfMass(2, t)[0] - x) < 1e-6]
        gmsh.model.addPhysicalGroup(2, side, 21, "inlet")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 1.0)
        gmsh.option.setNumber("Mesh.MshFileVersion", 2.2 if case["version"] == "2.2" else 4.1)
        gmsh.option.setNumber("Mesh.Binary", int(case["encoding"] == "binary"))
        gmsh.model.mesh.generate(3)
        if case["order"] == "second":
            gmsh.model.mesh.setOrder(2)
        gmsh.write(path)
    finally:
        gmsh.finalize()
    return {"names": True, "sides": True}


def structured(case):
    """Nodes and hexahedra of the box, and the body of each."""
    x = np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.0])
    y, z = np.linspace(0, SIZE[1], 4), np.linspace(0, SIZE[2], 3)
    origin = np.array(ORIGIN if case["place"] == "far" else (0.0, 0.0, 0.0))
    nodes = np.array([(a, b, c) for c in z for b in y for a in x]) + origin
    nx, ny = len(x), len(y)
    index = lambda i, j, k: (k * ny + j) * nx + i
    cells, body = [], []
    for k in range(len(z) - 1):
        for j in range(ny - 1):
            for i in range(nx - 1):
                cells.append([index(i, j, k), index(i + 1, j, k), index(i + 1, j + 1, k), index(i, j + 1, k),
                              index(i, j, k + 1), index(i + 1, j, k + 1), index(i + 1, j + 1, k + 1), index(i, j + 1, k + 1)])
                body.append(int(x[i] >= WALL))
    return nodes, np.array(cells), np.array(body)


# Divisions of a hexahedron that match those of its neighbours.
TETRAHEDRA = [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)]
WEDGES = [(0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7)]


def cells_of(case):
    nodes, cells, body = structured(case)
    kind = case["cells"]
    if kind == "hexahedron":
        return nodes, cells, body, kind
    parts = TETRAHEDRA if kind == "tetra" else WEDGES
    return nodes, np.concatenate([cells[:, list(p)] for p in parts]), np.concatenate([body] * len(parts)), kind


LABELS = {"small": (1, 2), "zero": (0, 7), "large": (100, 40000), "negative": (-3, 5), "huge": (2**33, 2**33 + 1)}


def labels_of(case, body):
    return np.array(LABELS[case["labels"]])[body].astype(case["type"])


def with_meshio(case, path):
    nodes, cells, body, kind = cells_of(case)
    values = labels_of(case, body)
    mesh = meshio.Mesh(nodes, [(kind, cells)], cell_data={case["array"]: [values]})
    if case["format"] == "meshio-msh":
        mesh.cell_data = {"gmsh:physical": [values.astype(int)], "gmsh:geometrical": [values.astype(int)]}
        mesh.field_data = {n: np.array([label, 3]) for n, label in zip(NAMES[case["names"]], LABELS[case["labels"]])}
        mesh.write(path, file_format="gmsh22" if case["version"] == "2.2" else "gmsh", binary=case["encoding"] == "binary")
        return {"names": True, "sides": False}
    if case["format"] == "meshio-exodus":
        parts = [(kind, cells[body == b]) for b in (0, 1)]
        meshio.Mesh(nodes, parts).write(path)
    elif case["format"] == "meshio-vtu":
        mesh.write(path, binary=case["encoding"] == "binary", compression="zlib" if case["version"] == "2.2" else None)
    else:
        mesh.write(path, file_format="vtk42" if case["version"] == "2.2" else "vtk51", binary=case["encoding"] == "binary")
    return {"names": False, "sides": False}


def with_vtk(case, path):
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid
    from vtkmodules.vtkIOLegacy import vtkUnstructuredGridWriter
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    nodes, cells, body, kind = cells_of(case)
    grid, points, array = vtkUnstructuredGrid(), vtkPoints(), vtkCellArray()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(nodes), deep=True))
    grid.SetPoints(points)
    array.ImportLegacyFormat(numpy_to_vtkIdTypeArray(np.hstack([np.full((len(cells), 1), cells.shape[1]), cells]).ravel(), deep=True))
    grid.SetCells({"tetra": 10, "hexahedron": 12, "wedge": 13}[kind], array)
    values = numpy_to_vtk(labels_of(case, body), deep=True)
    values.SetName(case["array"])
    if case["encoding"] == "scalars":
        grid.GetCellData().SetScalars(values)
    else:
        grid.GetCellData().AddArray(values)
    if case["format"] == "vtk-xml":
        writer = vtkXMLUnstructuredGridWriter()
        if case["encoding"] == "text":
            writer.SetDataModeToAscii()
        if case["version"] == "2.2":
            writer.SetCompressorTypeToLZ4()
    else:
        writer = vtkUnstructuredGridWriter()
        if case["encoding"] == "binary":
            writer.SetFileTypeToBinary()
        if case["version"] == "2.2":
            writer.SetFileVersion(42)
    writer.SetFileName(path)
    writer.SetInputData(grid)
    writer.Write()
    return {"names": False, "sides": False}


KINDS = ["tetra", "hexahedron", "wedge"]
TYPES = ["u1", "i1", "u2", "i2", "i4", "u4", "i8", "u8", "f4", "f8"]
ARRAYS = ["region", "material", "CellEntityIds", "gmsh:physical", "medit:ref", "cell_tags", "MaterialIds", "attribute"]


def writer(write, ending, **dimensions):
    standard = {"cells": ["tetra"], "type": ["i4"], "labels": ["small"], "array": ["region"], "names": ["plain"],
                "encoding": ["text", "binary"], "version": ["4.1", "2.2"], "place": ["near", "far"], "groups": ["plain"],
                "order": ["first"]}
    return {"write": write, "ending": ending, "dimensions": {**standard, **dimensions}}


WRITERS = {
    "gmsh": writer(with_gmsh, ".msh", names=list(NAMES), groups=["plain", "all first", "all last"], order=["first", "second"]),
    # Gmsh refuses files of version 4.1 of meshio, which have no entities.
    "meshio-msh": writer(with_meshio, ".msh", names=list(NAMES), labels=["small", "large"], version=["2.2"]),
    "meshio-exodus": writer(with_meshio, ".e", cells=["tetra"], encoding=["binary"], version=["4.1"]),
    "meshio-vtu": writer(with_meshio, ".vtu", cells=KINDS, type=TYPES, labels=list(LABELS), array=ARRAYS),
    "meshio-vtk": writer(with_meshio, ".vtk", cells=KINDS, type=TYPES, labels=list(LABELS), array=ARRAYS),
    "vtk-xml": writer(with_vtk, ".vtu", cells=KINDS, type=TYPES, labels=list(LABELS), array=ARRAYS,
                      encoding=["text", "binary", "scalars"]),
    "vtk-legacy": writer(with_vtk, ".vtk", cells=KINDS, type=TYPES, labels=list(LABELS), array=ARRAYS,
                         encoding=["text", "binary", "scalars"]),
}


def fits(case):
    """True if the number type holds the labels."""
    dtype = np.dtype(case["type"])
    labels = LABELS[case["labels"]]
    if dtype.kind == "f":
        return all(float(np.array(label, dtype)) == label for label in labels)
    return np.iinfo(dtype).min <= min(labels) and max(labels) <= np.iinfo(dtype).max


def cases():
    for name, entry in WRITERS.items():
        yield from pairwise({"format": [name], **entry["dimensions"]}, fits)


def volumes_in(path):
    """The volume of each physical volume of a mesh of Gmsh, by its name."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        gmsh.open(path)
        out = {}
        for dim, tag in gmsh.model.getPhysicalGroups(3):
            total = 0.0
            for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
                for kind in gmsh.model.mesh.getElementTypes(3, entity):
                    tags = gmsh.model.mesh.getElementsByType(kind, entity)[0]
                    total += float(np.sum(gmsh.model.mesh.getElementQualities(tags, "volume")))
            out[gmsh.model.getPhysicalName(dim, tag)] = total
        surfaces = {gmsh.model.getPhysicalName(d, t) for d, t in gmsh.model.getPhysicalGroups(2)}
        return out, surfaces
    finally:
        gmsh.finalize()


def judge(atomesh, case, folder, name):
    entry = WRITERS[case["format"]]
    path = name + entry["ending"]
    os.chdir(folder)
    has = entry["write"](case, path)
    info = subprocess.run([atomesh, "info", path], capture_output=True, text=True)
    if info.returncode:
        return "refused", "info: " + (info.stderr.strip().splitlines() or ["?"])[0]
    simplices = case["cells"] == "tetra"
    target, out = ("msh", "out.msh") if simplices else ("geos", "out.vtu")
    result = subprocess.run([atomesh, "export", path, "--to", target, "-o", out, "--quiet"], capture_output=True, text=True)
    if result.returncode:
        return "refused", (result.stderr.strip().splitlines() or ["?"])[0]
    if not simplices:
        volumes = volumes_by_attribute(out)
        if len(volumes) != 2 or not np.allclose(sorted(volumes), sorted(VOLUMES), rtol=1e-6):
            return "wrong", f"volumes {volumes}, right {VOLUMES}"
        return "right", ""
    volumes, surfaces = volumes_in(out)
    whole = volumes.pop("everything", None)
    if whole is not None and abs(whole - sum(VOLUMES)) > 1e-6 * whole or case["groups"] != "plain" and whole is None:
        return "wrong", f"the group of all cells has the volume {whole}"
    if len(volumes) != 2 or not np.allclose(sorted(volumes.values()), sorted(VOLUMES), rtol=1e-6):
        return "wrong", f"volumes {volumes}, right {VOLUMES}"
    if has["names"]:
        for label, right in zip(NAMES[case["names"]], VOLUMES):
            if abs(volumes.get(label, -1) - right) > 1e-6 * right:
                return "wrong", f"'{label}' has the volume {volumes.get(label)}, right {right}"
    if has["sides"] and not {"wall", "inlet"} <= surfaces:
        return "wrong", f"surfaces {surfaces}"
    return "right", ""


def volumes_by_attribute(path):
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(path)
    sizes = vtkCellSizeFilter()
    sizes.SetInputConnection(reader.GetOutputPort())
    sizes.Update()
    data = sizes.GetOutput().GetCellData()
    number, volume = vtk_to_numpy(data.GetArray("attribute")), vtk_to_numpy(data.GetArray("Volume"))
    # Faces of surfaces are cells of their own, without a volume.
    volumes = [float(volume[number == n].sum()) for n in np.unique(number)]
    return [v for v in volumes if v > 0]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("atomesh")
    parser.add_argument("folder")
    parser.add_argument("--only", help="writers, separated by commas")
    parser.add_argument("--list", action="store_true", help="print the combinations only")
    args = parser.parse_args()
    os.makedirs(args.folder, exist_ok=True)
    atomesh, folder = os.path.abspath(args.atomesh), os.path.abspath(args.folder)
    only = args.only.split(",") if args.only else None
    table = {}
    for n, case in enumerate(cases()):
        if only and case["format"] not in only:
            continue
        words = " ".join(f"{k}={case[k]}" for k in case if k != "format")
        if args.list:
            print(case["format"], words)
            continue
        verdict, why = judge(atomesh, case, folder, f"{case['format']}{n}")
        counts = table.setdefault(case["format"], {"right": 0, "wrong": 0, "refused": 0})
        counts[verdict] += 1
        if verdict != "right":
            print(f"{verdict}: {case['format']}{n}: {words} | {why}", file=sys.stderr)
    return print_table(table)


if __name__ == "__main__":
    sys.exit(main())
