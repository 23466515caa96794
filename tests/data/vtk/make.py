"""Writes the files of this folder with VTK (pip install vtk): a small image and small meshes, in the variants of VTK's
formats that atomesh must read. Run it in this folder."""

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk


def image():
    data = vtk.vtkImageData()
    data.SetDimensions(3, 2, 2)
    data.SetOrigin(612345.678, -1e-7, 3.25)
    data.SetSpacing(12.5, 25, 4)
    data.SetDirectionMatrix([0, -1, 0, 1, 0, 0, 0, 0, 1])
    samples = numpy_to_vtk(np.arange(12, dtype=np.int16) - 5, deep=1)
    samples.SetName("amplitude")
    data.GetPointData().SetScalars(samples)
    return data


def mesh():
    data = vtk.vtkUnstructuredGrid()
    points = vtk.vtkPoints()
    for x in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]:
        points.InsertNextPoint(x)
    data.SetPoints(points)
    data.InsertNextCell(vtk.VTK_TETRA, 4, [0, 1, 2, 3])
    data.InsertNextCell(vtk.VTK_TETRA, 4, [1, 2, 3, 4])
    quality = numpy_to_vtk(np.array([0.5, -2], dtype=np.float32), deep=1)
    quality.SetName("quality")
    data.GetCellData().AddArray(quality)
    note = vtk.vtkStringArray()
    note.SetName("note")
    note.InsertNextValue("made by <VTK>")
    data.GetFieldData().AddArray(note)
    return data


VARIANTS = [
    ("ascii", "none", 32, "le"),
    ("inline", "none", 32, "be"),
    ("inline", "none", 64, "le"),
    ("inline", "zlib", 32, "le"),
    ("base64", "none", 32, "le"),
    ("base64", "zlib", 64, "be"),
    ("raw", "none", 32, "be"),
    ("raw", "none", 64, "le"),
    ("raw", "zlib", 32, "le"),
    ("raw", "zlib", 64, "le"),
    ("raw", "lz4", 64, "le"),
    ("inline", "lz4", 32, "be"),
    ("base64", "lzma", 64, "le"),
]

for mode, compressor, header, order in VARIANTS:
    for data, writer, ending in [
        (image(), vtk.vtkXMLImageDataWriter(), "vti"),
        (mesh(), vtk.vtkXMLUnstructuredGridWriter(), "vtu"),
    ]:
        writer.SetInputData(data)
        writer.SetFileName(f"{mode}_{compressor}_{header}_{order}.{ending}")
        if mode == "ascii":
            writer.SetDataModeToAscii()
        elif mode == "inline":
            writer.SetDataModeToBinary()
        else:
            writer.SetDataModeToAppended()
            writer.SetEncodeAppendedData(mode == "base64")
        if compressor == "none":
            writer.SetCompressorTypeToNone()
        elif compressor == "zlib":
            writer.SetCompressorTypeToZLib()
        elif compressor == "lz4":
            writer.SetCompressorTypeToLZ4()
        else:
            writer.SetCompressorTypeToLZMA()
        if header == 64:
            writer.SetHeaderTypeToUInt64()
        else:
            writer.SetHeaderTypeToUInt32()
        if order == "be":
            writer.SetByteOrderToBigEndian()
        writer.Write()


def cells(kind):
    """Returns a mesh of two cells: tetrahedra, polyhedra, or a quadrilateral and a triangle in the plane."""
    data = vtk.vtkUnstructuredGrid()
    points = vtk.vtkPoints()
    points.SetDataTypeToDouble()
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]
    if kind == "polygons":
        corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0.5, 0)]
    for x, y, z in corners:
        points.InsertNextPoint(612345.678 + x, y, z)
    data.SetPoints(points)
    if kind == "polygons":
        data.InsertNextCell(vtk.VTK_QUAD, 4, [0, 1, 2, 3])
        data.InsertNextCell(vtk.VTK_TRIANGLE, 3, [1, 4, 2])
    for a, b, c, d in [] if kind == "polygons" else [(0, 1, 2, 3), (1, 2, 3, 4)]:
        if kind == "tets":
            data.InsertNextCell(vtk.VTK_TETRA, 4, [a, b, c, d])
            continue
        # Faces are oriented outwards for either orientation of the nodes.
        faces = [(a, c, b), (a, b, d), (b, c, d), (a, d, c)]
        faces = [face if (a, b, c, d) == (0, 1, 2, 3) else face[::-1] for face in faces]
        ids = vtk.vtkIdList()
        for n in [len(faces)] + [n for face in faces for n in (3,) + face]:
            ids.InsertNextId(n)
        data.InsertNextCell(vtk.VTK_POLYHEDRON, ids)
    rock = vtk.vtkLongLongArray()
    rock.SetName("rock type")
    for value in [5, -7]:
        rock.InsertNextValue(value)
    data.GetCellData().AddArray(rock)
    for values, name, target in [
        (np.arange(5, dtype=np.float32) / 4, "height", data.GetPointData()),
        (np.array([2.5, 3.5]), "TimeValue", data.GetFieldData()),
    ]:
        array = numpy_to_vtk(values, deep=1)
        array.SetName(name)
        target.AddArray(array)
    return data


for binary in [False, True]:
    name = "binary" if binary else "ascii"
    pairs = [(f"legacy_{name}.vtk", image(), vtk.vtkStructuredPointsWriter())]
    for kind in ["tets", "polyhedra", "polygons"]:
        pairs.append((f"legacy_{kind}_{name}.vtk", cells(kind), vtk.vtkUnstructuredGridWriter()))
    for path, data, writer in pairs:
        writer.SetInputData(data)
        writer.SetFileName(path)
        if binary:
            writer.SetFileTypeToBinary()
        else:
            # This is the version of programs before VTK 9.
            writer.SetFileVersion(42)
        writer.Write()
        if path == f"legacy_{name}.vtk":
            # VTK rounds the origin to six digits, while other programs do not.
            with open(path, "rb") as file:
                content = file.read()
            with open(path, "wb") as file:
                file.write(content.replace(b"ORIGIN 612346 ", b"ORIGIN 612345.678 "))

for kind in ["polyhedra", "polygons"]:
    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetInputData(cells(kind))
    writer.SetFileName(f"{kind}.vtu")
    writer.Write()
