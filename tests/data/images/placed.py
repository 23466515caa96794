"""Writes images with VTK, nibabel and pynrrd, and prints where these have them: placed.py FOLDER

For each file: name, layer, dims, position of the first sample, step along each axis (x first), samples with x fastest.
Positions of nibabel are converted to left-posterior-superior.
"""
import json
import sys
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

FOLDER = Path(sys.argv[1])
DIMS = (5, 4, 3)
ORIGIN = np.array([450000.25, 6780000.5, -1000.0])
files = []


def add(name, layer, dims, origin, axes, values):
    files.append([name, layer, list(map(int, dims)), list(map(float, origin)),
                  [list(map(float, axis)) for axis in axes], list(map(float, values))])


def scalars(grid, on_cells):
    count = grid.GetNumberOfCells() if on_cells else grid.GetNumberOfPoints()
    array = numpy_to_vtk(np.arange(count, dtype="f4"), deep=True)
    array.SetName("values")
    (grid.GetCellData() if on_cells else grid.GetPointData()).SetScalars(array)


def rectilinear(on_cells):
    grid = vtk.vtkRectilinearGrid()
    grid.SetDimensions(*DIMS)
    steps = (12.5, -25.0, 4.0)
    for k, set_axis in enumerate([grid.SetXCoordinates, grid.SetYCoordinates, grid.SetZCoordinates]):
        set_axis(numpy_to_vtk(ORIGIN[k] + steps[k] * np.arange(DIMS[k]), deep=True))
    scalars(grid, on_cells)
    return grid


def structured():
    grid = vtk.vtkStructuredGrid()
    grid.SetDimensions(*DIMS)
    points = vtk.vtkPoints()
    points.SetDataTypeToDouble()
    axes = np.array([[10.0, 6.0, 0.0], [-3.0, 5.0, 0.5], [0.0, 0.0, 4.0]])
    for k in range(DIMS[2]):
        for j in range(DIMS[1]):
            for i in range(DIMS[0]):
                points.InsertNextPoint(*(ORIGIN + i * axes[0] + j * axes[1] + k * axes[2]))
    grid.SetPoints(points)
    scalars(grid, False)
    return grid


def write_vtk(name, writer, reader, grid, on_cells=False):
    path = str(FOLDER / name)
    writer.SetFileName(path)
    writer.SetInputData(grid)
    assert writer.Write()
    reader.SetFileName(path)
    reader.Update()
    read = reader.GetOutput()
    dims = tuple(n - 1 for n in DIMS) if on_cells else DIMS
    if on_cells:
        # The centre of a cell is the mean of its corners.
        middle = lambda cell: vtk_to_numpy(read.GetCell(cell).GetPoints().GetData()).mean(axis=0)
        points = np.array([middle(cell) for cell in range(read.GetNumberOfCells())])
    else:
        points = np.array([read.GetPoint(p) for p in range(read.GetNumberOfPoints())])
    strides = (1, dims[0], dims[0] * dims[1])
    axes = [points[stride] - points[0] for stride in strides]
    data = read.GetCellData() if on_cells else read.GetPointData()
    add(name, None, dims, points[0], axes, vtk_to_numpy(data.GetScalars()))


xml = vtk.vtkXMLRectilinearGridWriter
write_vtk("points.vtr", xml(), vtk.vtkXMLRectilinearGridReader(), rectilinear(False))
write_vtk("cells.vtr", xml(), vtk.vtkXMLRectilinearGridReader(), rectilinear(True), True)
for name, is_binary in (("text.vtk", False), ("binary.vtk", True)):
    writer = vtk.vtkRectilinearGridWriter()
    if is_binary:
        writer.SetFileTypeToBinary()
    write_vtk(name, writer, vtk.vtkRectilinearGridReader(), rectilinear(False))
write_vtk("oblique.vts", vtk.vtkXMLStructuredGridWriter(), vtk.vtkXMLStructuredGridReader(), structured())
writer = vtk.vtkStructuredGridWriter()
writer.SetFileTypeToBinary()
write_vtk("oblique.vtk", writer, vtk.vtkStructuredGridReader(), structured())

array = np.arange(24, dtype="i2").reshape(4, 3, 2)
sform = np.array([[2.0, 0, 0, -5], [0, 3, 0, 6], [0, 0, 4, 7], [0, 0, 0, 1]])
qform = np.array([[0.0, -3, 0, 9], [2, 0, 0, 6], [0, 0, 4, 7], [0, 0, 0, 1]])
for name, kind, codes in (("pair.img", nibabel.Nifti1Pair, (2, 1)), ("both.nii.gz", nibabel.Nifti1Image, (2, 1)),
                          ("qform.nii", nibabel.Nifti1Image, (0, 1)), ("both.nii", nibabel.Nifti2Image, (1, 2))):
    image = kind(array, sform)
    image.set_qform(qform, code=codes[1])
    image.set_sform(sform, code=codes[0])
    nibabel.save(image, FOLDER / name)
    affine = np.diag([-1, -1, 1, 1]) @ nibabel.load(FOLDER / name).affine
    add(name, None, array.shape, affine[:3, 3], affine[:3, :3].T, array.ravel(order="F"))

layers = np.zeros((2, 6, 5, 4), "u1")
layers[0, 3:], layers[1, 2:4, 1:3] = 2, 1
header = {
    "type": "uint8", "encoding": "gzip", "kinds": ["list", "domain", "domain", "domain"],
    "space": "left-posterior-superior", "space origin": [10.0, 20.0, 30.0],
    "space directions": np.array([[np.nan] * 3, [2.0, 0, 0], [0, 2.5, 0], [0, 0, 3]]),
    "Segment0_Name": "Muscle", "Segment0_LabelValue": "2", "Segment0_Layer": "0",
    "Segment1_Name": "Tumour", "Segment1_LabelValue": "1", "Segment1_Layer": "1",
    "Segmentation_ReferenceImageExtentOffset": "5 6 7",
}
nrrd.write(str(FOLDER / "layers.seg.nrrd"), layers, header)
read, header = nrrd.read(str(FOLDER / "layers.seg.nrrd"))
for layer in range(2):
    add("layers.seg.nrrd", layer, read.shape[1:], header["space origin"], header["space directions"][1:],
        read[layer].ravel(order="F"))
print(json.dumps(files))
