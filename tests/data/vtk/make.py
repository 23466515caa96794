"""Writes this folder's files with VTK (pip install vtk): one small image and one small mesh, in
the variants of VTK's XML container that our readers must understand. Run in this folder."""

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
        else:
            writer.SetCompressorTypeToLZ4()
        if header == 64:
            writer.SetHeaderTypeToUInt64()
        else:
            writer.SetHeaderTypeToUInt32()
        if order == "be":
            writer.SetByteOrderToBigEndian()
        writer.Write()
