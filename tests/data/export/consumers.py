"""Prints what programs read of one model in all formats as JSON: consumers.py FOLDER [NAME ...].

FOLDER has the exports `m.FORMAT` of a model. The result has an entry for each reader (or for those named): either
the volumes of the named regions, and for each named surface its area, the sum of its area vectors and the volume
that its triangles enclose (about the middle of the model), or an error. Readers whose module is not installed are
missing."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

folder = Path(sys.argv[1])
wanted = sys.argv[2:]
READERS = {}
# Programs print to the standard output, too.
output = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)


def reader(name, *modules):
    def add(function):
        if all(importlib.util.find_spec(module) for module in modules):
            READERS[name] = function
        return function

    return add


def volumes(points, tets):
    corners = np.asarray(points)[np.asarray(tets)[:, :4]]
    edges = corners[:, 1:] - corners[:, :1]
    return float(np.linalg.det(edges).sum() / 6)


def surface(points, triangles, middle):
    a, b, c = (np.asarray(points)[np.asarray(triangles)[:, k]] - middle for k in range(3))
    normals = np.cross(b - a, c - a) / 2
    return {
        "area": float(np.linalg.norm(normals, axis=1).sum()),
        "vector": normals.sum(axis=0).tolist(),
        "volume": float((a * normals).sum() / 3),
    }


def summary(points, regions, faces):
    """Measures named tetrahedra and named triangles."""
    points = np.asarray(points, float)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return {
        "low": points.min(axis=0).tolist(),
        "high": points.max(axis=0).tolist(),
        "regions": {name: volumes(points, tets) for name, tets in regions.items() if len(tets)},
        "surfaces": {name: surface(points, tris, middle) for name, tris in faces.items() if len(tris)},
    }


def by_number(cells, numbers, names):
    """Returns the cells of each name, whose number `names` has."""
    numbers = np.asarray(numbers)
    return {names.get(int(n), str(int(n))): np.asarray(cells)[numbers == n] for n in np.unique(numbers)}


def vtk_arrays(grid):
    from vtkmodules.util.numpy_support import vtk_to_numpy

    cells = grid.GetCells()
    types = np.array([grid.GetCellType(i) for i in range(grid.GetNumberOfCells())])
    offsets, ids = (vtk_to_numpy(a) for a in (cells.GetOffsetsArray(), cells.GetConnectivityArray()))
    pick = lambda kind, size: np.array([ids[offsets[i] : offsets[i] + size] for i in np.flatnonzero(types == kind)])
    data = grid.GetCellData()
    values = {data.GetArrayName(i): vtk_to_numpy(data.GetArray(i)) for i in range(data.GetNumberOfArrays())}
    return vtk_to_numpy(grid.GetPoints().GetData()), pick(10, 4), pick(5, 3), values, types


def table(path):
    """Returns the names by number of a table of names."""
    import csv

    rows = list(csv.DictReader(open(path)))
    regions = {int(r["written"]): r["name"] for r in rows if r["kind"] == "region"}
    return regions, {int(r["number"]): r["name"] for r in rows if r["kind"] == "face"}


def comments(path, sign):
    """Returns the names by number of the comments of a file, of regions and of faces."""
    import re

    text = open(path).read()
    of = lambda kind: {
        int(number): name for name, number in re.findall(rf"^{sign}\s*{kind} -?\d+ '(.*)' is (\d+)$", text, re.M)
    }
    return of("region"), of("face")


def gmsh_groups(path):
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(path))
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    index = {tag: i for i, tag in enumerate(tags)}
    points, regions, faces = coordinates.reshape(-1, 3), {}, {}
    for dim, group in gmsh.model.getPhysicalGroups():
        name, nodes = gmsh.model.getPhysicalName(dim, group), []
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, group):
            for kind, found in zip(*gmsh.model.mesh.getElements(dim, entity)[::2]):
                nodes.append(found.reshape(-1, dim + 1))
        cells = np.vectorize(index.get)(np.concatenate(nodes))
        (regions if dim == 3 else faces)[name] = cells
    gmsh.finalize()
    return summary(points, regions, faces)


@reader("Gmsh, msh", "gmsh")
def _():
    return gmsh_groups(folder / "m4.msh")


@reader("Gmsh, msh2", "gmsh")
def _():
    return gmsh_groups(folder / "m2.msh")


def meshio_groups(module, path, kind=None):
    meshio = importlib.import_module(module)
    mesh = meshio.read(path, kind) if kind else meshio.read(path)
    return mesh


def meshio_msh(module, path):
    mesh = meshio_groups(module, path, "gmsh")
    regions, faces = {}, {}
    for block, numbers in zip(mesh.cells, mesh.cell_data["gmsh:physical"]):
        dim, target = (3, regions) if block.type == "tetra" else (2, faces)
        names = {int(n): name for name, (n, d) in mesh.field_data.items() if d == dim}
        for name, cells in by_number(block.data, numbers, names).items():
            target[name] = np.concatenate([target[name], cells]) if name in target else cells
    return summary(mesh.points, regions, faces)


@reader("meshio, msh", "meshio")
def _():
    return meshio_msh("meshio", folder / "m4.msh")


@reader("meshio++, msh2", "meshioplusplus")
def _():
    return meshio_msh("meshioplusplus", folder / "m2.msh")


@reader("meshio, xdmf", "meshio", "h5py")
def _():
    import meshio

    mesh, facets = meshio.read(folder / "m.xdmf"), meshio.read(folder / "m_facets.xdmf")
    names = lambda mesh: {int(n): name for name, (n, _) in mesh.field_data.items()}
    regions = by_number(mesh.cells[0].data, mesh.cell_data["region"][0], names(mesh))
    faces = by_number(facets.cells[0].data, facets.cell_data["facet"][0], names(facets))
    return summary(mesh.points, regions, faces)


@reader("meshio, medit", "meshio")
def _():
    import meshio

    mesh = meshio.read(folder / "m.mesh")
    (regions, faces), found = comments(folder / "m.mesh", "#"), [{}, {}]
    for block, numbers in zip(mesh.cells, mesh.cell_data["medit:ref"]):
        at = 0 if block.type == "tetra" else 1
        found[at] = by_number(block.data, numbers, (regions, faces)[at])
    return summary(mesh.points, *found)


@reader("meshio, inp", "meshio")
def _():
    import meshio

    mesh = meshio.read(folder / "m.inp")
    regions = {}
    for name, blocks in mesh.cell_sets.items():
        cells = [block.data[members] for block, members in zip(mesh.cells, blocks) if len(members)]
        if name != "EALL" and cells:
            regions[name] = np.concatenate(cells)
    return summary(mesh.points, regions, {})


@reader("VTK, vtkhdf", "vtkmodules")
def _():
    from vtkmodules.vtkIOHDF import vtkHDFReader

    source = vtkHDFReader()
    source.SetFileName(str(folder / "m.vtkhdf"))
    source.Update()
    points, tets, _, values, _ = vtk_arrays(source.GetOutputDataObject(0))
    regions, _ = table(folder / "m.vtkhdf.names.csv")
    return summary(points, by_number(tets, values["region"], regions), {})


@reader("VTK, geos", "vtkmodules")
def _():
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    source = vtkXMLUnstructuredGridReader()
    source.SetFileName(str(folder / "m-geos.vtu"))
    source.Update()
    points, tets, triangles, values, types = vtk_arrays(source.GetOutputDataObject(0))
    regions, faces = table(folder / "m-geos.vtu.names.csv")
    attribute = values["attribute"]
    named = by_number(tets, attribute[types == 10], regions), by_number(triangles, attribute[types == 5], faces)
    return summary(points, *named)


def vtk_blocks(source):
    """Yields the leaves of composite data with their names."""
    from vtkmodules.vtkCommonDataModel import vtkCompositeDataSet

    def leaves(data, name):
        if not data.IsA("vtkCompositeDataSet"):
            yield name, data
            return
        for i in range(data.GetNumberOfBlocks()):
            metadata = data.GetMetaData(i) if data.HasMetaData(i) else None
            block = metadata.Get(vtkCompositeDataSet.NAME()) if metadata else ""
            if data.GetBlock(i):
                yield from leaves(data.GetBlock(i), f"{name}/{block}")

    yield from leaves(source.GetOutputDataObject(0), "")


def joined(parts):
    """Joins pieces, each with its own points, and measures them."""
    points, regions, faces, start = [], {}, {}, 0
    for kind, name, nodes, cells in parts:
        (regions if kind == "region" else faces)[name] = cells + start
        points.append(nodes)
        start += len(nodes)
    return summary(np.concatenate(points), regions, faces)


@reader("VTK, exodus", "vtkmodules")
def _():
    from vtkmodules.vtkIOExodus import vtkExodusIIReader

    source = vtkExodusIIReader()
    source.SetFileName(str(folder / "m.exo"))
    source.UpdateInformation()
    for kind in (source.ELEM_BLOCK, source.SIDE_SET):
        for i in range(source.GetNumberOfObjects(kind)):
            source.SetObjectStatus(kind, i, 1)
    source.Update()
    parts = []
    for name, grid in vtk_blocks(source):
        points, tets, triangles, _, _ = vtk_arrays(grid)
        kind, name = name.strip("/").split("/", 1)
        is_block = kind == "Element Blocks"
        parts.append(("region" if is_block else "face", name, points, tets if is_block else triangles))
    return joined(parts)


@reader("VTK, cgns", "vtkmodules")
def _():
    from vtkmodules.vtkIOCGNSReader import vtkCGNSReader

    source = vtkCGNSReader()
    source.SetFileName(str(folder / "m.cgns"))
    source.UpdateInformation()
    source.LoadBndPatchOn()
    source.EnableAllCellArrays()
    source.Update()
    regions, _ = table(folder / "m.cgns.names.csv")
    parts = []
    for name, grid in vtk_blocks(source):
        points, tets, triangles, values, _ = vtk_arrays(grid)
        if len(tets):
            for region, cells in by_number(tets, values["region"], regions).items():
                parts.append(("region", region, points, cells))
        else:
            parts.append(("face", name.rsplit("/", 1)[1], points, triangles))
    return joined(parts)


@reader("CalculiX, inp")
def _():
    sets = [line.split("ELSET=")[1].strip() for line in open(folder / "m.inp") if line.startswith("*ELSET")]
    prints = "".join(f"*EL PRINT, ELSET={name}, TOTALS=ONLY\nEVOL\n" for name in sets)
    solids = "".join(f"*SOLID SECTION, ELSET={name}, MATERIAL=M\n" for name in sets)
    (folder / "job.inp").write_text(
        f"*INCLUDE, INPUT=m.inp\n*MATERIAL, NAME=M\n*ELASTIC\n1.,0.\n{solids}*STEP\n*STATIC\n"
        f"*BOUNDARY\nNXMIN,1,3,0.\n*DSLOAD\nSXMAX,P,1.\n{prints}*END STEP\n"
    )
    subprocess.run(["ccx", "job"], cwd=folder, check=True, capture_output=True)
    found, name = {}, None
    for line in open(folder / "job.dat"):
        words = line.split()
        if "set" in words and "volume" in line:
            name = words[words.index("set") + 1]
        elif name and len(words) == 1:
            found[name], name = float(words[0]), None
    return {"regions": found, "surfaces": {}}


@reader("OpenFOAM, openfoam")
def _():
    import re

    command = ["checkMesh", "-case", "foam", "-allTopology", "-allGeometry"]
    environment = {"WM_PROJECT_DIR": "/usr/share/openfoam", "PATH": "/usr/bin:/bin"}
    text = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment).stdout
    of = lambda heading: re.search(rf"{heading}.*?\n\s*\n", text, re.S).group(0).splitlines()[2:]
    rows = [line.split() for line in of("Checking basic cellZone addressing")]
    patches = [line.split()[0] for line in of("Checking patch topology") if " ok " in line]
    volumes = {words[0]: float(words[3]) for words in rows if len(words) > 3 and words[1].isdigit()}
    return {"regions": volumes, "surfaces": {}, "patches": patches, "skewness": "highly skew faces" not in text}


@reader("Netgen, msh2", "netgen")
def _():
    from netgen.read_gmsh import ReadGmsh

    mesh = ReadGmsh(str(folder / "m2.msh"))
    points = np.array([p.p for p in mesh.Points()])
    regions, faces = {}, {}
    for e in mesh.Elements3D():
        regions.setdefault(mesh.GetMaterial(e.index), []).append([v.nr - 1 for v in e.vertices])
    for e in mesh.Elements2D():
        faces.setdefault(mesh.GetBCName(e.index - 1), []).append([v.nr - 1 for v in e.vertices])
    return summary(points, {n: np.array(c)[:, [0, 1, 2, 3]] for n, c in regions.items()}, {n: np.array(c) for n, c in faces.items()})


@reader("MFEM, msh2", "mfem")
def _():
    import mfem.ser as mfem

    mesh = mfem.Mesh(str(folder / "m2.msh"), 1, 0, False)
    points = np.array([mesh.GetVertexArray(i) for i in range(mesh.GetNV())])
    names = {}
    for line in open(folder / "m2.msh"):
        words = line.split(maxsplit=2)
        if len(words) == 3 and words[2].startswith('"'):
            names[int(words[1])] = words[2].strip().strip('"')
        if line.startswith("$EndPhysicalNames"):
            break
    of = lambda count, nodes, number: by_number(
        [nodes(i) for i in range(count)], [number(i) for i in range(count)], names
    )
    regions = of(mesh.GetNE(), mesh.GetElementVertices, mesh.GetAttribute)
    faces = of(mesh.GetNBE(), mesh.GetBdrElementVertices, mesh.GetBdrAttribute)
    return summary(points, regions, faces)


@reader("scikit-fem, msh", "skfem", "meshio")
def _():
    import skfem

    mesh = skfem.MeshTet.load(str(folder / "m4.msh"))
    regions = {name: mesh.t[:, cells].T for name, cells in mesh.subdomains.items() if not name.startswith("gmsh:")}
    faces = {n: mesh.facets[:, np.asarray(f)].T for n, f in (mesh.boundaries or {}).items() if not n.startswith("gmsh:")}
    return summary(mesh.p.T, regions, faces)


@reader("toughio, msh2", "toughio")
def _():
    import toughio

    mesh = toughio.read_mesh(str(folder / "m2.msh"))
    names = {int(n): name for name, (n, d) in mesh.field_data.items() if d == 3}
    block = next(i for i, b in enumerate(mesh.cells) if b.type == "tetra")
    start = sum(len(b.data) for b in mesh.cells[:block])
    tets = mesh.cells[block].data
    return summary(mesh.points, by_number(tets, mesh.cell_data["material"][start : start + len(tets)], names), {})


@reader("pyNastran, nastran", "pyNastran")
def _():
    import re

    # pyNastran 1.3.4 calls a function that NumPy 2.4 no longer has.
    if not hasattr(np, "in1d"):
        np.in1d = np.isin
    from pyNastran.bdf.bdf import BDF

    model = BDF(debug=None)
    model.read_bdf(str(folder / "m.bdf"), xref=False)
    text = open(folder / "m.bdf").read()
    names = {int(n): name for n, name in re.findall(r"^\$ Femap Property (\d+) : (.*)$", text, re.M)}
    nodes = sorted(model.nodes)
    index = {n: i for i, n in enumerate(nodes)}
    points = np.array([model.nodes[n].xyz for n in nodes])
    regions, faces = {}, {}
    for element in model.elements.values():
        target = regions if element.type == "CTETRA" else faces
        target.setdefault(names[element.pid], []).append([index[n] for n in element.nodes])
    return summary(points, *({n: np.array(c) for n, c in t.items()} for t in (regions, faces)))


@reader("meshio++, nastran", "meshioplusplus")
def _():
    import meshioplusplus

    mesh = meshioplusplus.read(folder / "m.bdf")
    found = {"tetra": {}, "triangle": {}}
    starts = np.cumsum([0] + [len(block.data) for block in mesh.cells])
    for region in mesh.regions:
        members = np.asarray(region.entries)
        for block, start, end in zip(mesh.cells, starts, starts[1:]):
            inside = members[(members >= start) & (members < end)] - start
            if len(inside):
                found[block.type].setdefault(region.name, []).extend(np.asarray(block.data)[inside])
    regions, faces = ({n: np.array(c) for n, c in cells.items()} for cells in found.values())
    return summary(mesh.points, regions, faces)


@reader("trimesh, stl", "trimesh")
def _():
    import trimesh

    scene = trimesh.load(folder / "m.stl", force="scene", process=False)
    faces = {name: (part.vertices, part.faces) for name, part in scene.geometry.items()}
    return joined([("face", name, np.asarray(p), np.asarray(f)) for name, (p, f) in faces.items()])


@reader("PyMeshLab, obj", "pymeshlab")
def _():
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(folder / "m.obj"))
    mesh = meshes.current_mesh()
    return summary(mesh.vertex_matrix(), {}, {"all": mesh.face_matrix()})


@reader("VTK, stl", "vtkmodules")
def _():
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOGeometry import vtkSTLReader

    source = vtkSTLReader()
    source.ScalarTagsOn()
    source.SetFileName(str(folder / "m.stl"))
    source.Update()
    data = source.GetOutput()
    points = vtk_to_numpy(data.GetPoints().GetData()).astype(float)
    triangles = vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    tags = vtk_to_numpy(data.GetCellData().GetArray(0)).astype(int)
    names = [line.split()[1] for line in open(folder / "m.stl") if line.startswith("solid")]
    return summary(points, {}, by_number(triangles, tags, dict(enumerate(names))))


@reader("DOLFINx, xdmf", "dolfinx")
def _():
    from mpi4py import MPI
    from dolfinx.io import XDMFFile
    import xml.etree.ElementTree as tree

    def names(path):
        text = tree.parse(path).getroot().find(".//Information").text
        return {int(node.text): node.get("key") for node in tree.fromstring(text)}

    with XDMFFile(MPI.COMM_WORLD, str(folder / "m.xdmf"), "r") as file:
        mesh = file.read_mesh()
        tags = file.read_meshtags(mesh, "mesh", attribute_name="region")
    mesh.topology.create_connectivity(2, 3)
    with XDMFFile(MPI.COMM_WORLD, str(folder / "m_facets.xdmf"), "r") as file:
        facets = file.read_meshtags(mesh, "facets")
    points, cells = mesh.geometry.x, mesh.geometry.dofmap
    tets = np.asarray(cells)[tags.indices]
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    flip = np.linalg.det(edges) < 0
    tets[flip] = tets[flip][:, [0, 1, 3, 2]]
    from dolfinx.mesh import entities_to_geometry

    triangles = entities_to_geometry(mesh, 2, facets.indices)
    return summary(points, by_number(tets, tags.values, names(folder / "m.xdmf")),
                   by_number(triangles, facets.values, names(folder / "m_facets.xdmf")))


results = {}
for name, function in READERS.items():
    if wanted and not any(part in name for part in wanted):
        continue
    try:
        results[name] = function()
    except Exception as error:  # A program that cannot read a file is a result.
        results[name] = {"error": f"{type(error).__name__}: {error}"}
print(json.dumps(results), file=output)
