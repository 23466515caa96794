#!/usr/bin/env python
"""Puts what OPM Flow found onto the cells: scripts/simulated.py TWIN.vtu FOLDER CASE OUT.vtu [OUT.png]
(with .venv's VTK and resfo). The last pressure (bar) and saturation of water; and a picture of the
pressure (red high, blue low) in the cells behind the middle of y."""
import sys

import numpy as np
import resfo
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray, vtkLookupTable
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader, vtkXMLUnstructuredGridWriter


def cells(path):
    """The mesh in a file."""
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def cell_array(path, name):
    """A value of each cell of the mesh in a file."""
    return np.array(vtk_to_numpy(cells(path).GetCellData().GetArray(name)), dtype=float)


def write(mesh, path):
    """Writes the mesh."""
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(mesh)
    writer.Write()


def simulated(twin, folder, case):
    """The cells with the last pressure and saturation."""
    mesh = cells(twin)
    # Of several reports the last.
    found = {name.strip(): values for name, values in resfo.read(f"{folder}/{case}.UNRST")}
    for name in ("PRESSURE", "SWAT"):
        if name not in found:
            continue
        array = vtkDoubleArray()
        array.SetName(f"simulated_{name.lower()}")
        for value in found[name]:
            array.InsertNextValue(float(value))
        mesh.GetCellData().AddArray(array)
    return mesh


def draw(mesh, out, name="simulated_pressure"):
    """The cells whose centres are behind the middle of y, coloured by one of their values."""
    import vtkmodules.vtkRenderingOpenGL2  # noqa: F401 (registers the renderer)
    from vtkmodules.vtkCommonDataModel import vtkPlane
    from vtkmodules.vtkFiltersExtraction import vtkExtractGeometry
    from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter
    from vtkmodules.vtkIOImage import vtkPNGWriter
    from vtkmodules.vtkRenderingCore import (
        vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter)

    plane = vtkPlane()
    plane.SetOrigin(mesh.GetCenter())
    plane.SetNormal(0, -1, 0)
    behind = vtkExtractGeometry()
    behind.SetInputData(mesh)
    behind.SetImplicitFunction(plane)
    surface = vtkDataSetSurfaceFilter()
    surface.SetInputConnection(behind.GetOutputPort())
    mapper = vtkPolyDataMapper()
    mapper.SetInputConnection(surface.GetOutputPort())
    mapper.SetScalarModeToUseCellFieldData()
    mapper.SelectColorArray(name)
    colors = vtkLookupTable()
    colors.SetHueRange(0.67, 0.0)
    mapper.SetLookupTable(colors)
    mapper.SetScalarRange(mesh.GetCellData().GetArray(name).GetRange())
    actor = vtkActor()
    actor.SetMapper(mapper)
    actor.GetProperty().EdgeVisibilityOn()
    actor.GetProperty().SetAmbient(0.4)
    renderer = vtkRenderer()
    renderer.SetBackground(1, 1, 1)
    renderer.AddActor(actor)
    camera = renderer.GetActiveCamera()
    camera.SetPosition(0.3, -1, 0.4)
    camera.SetViewUp(0, 0, 1)
    renderer.ResetCamera()
    camera.Zoom(1.2)
    renderer.ResetCameraClippingRange()
    window = vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetSize(900, 640)
    window.AddRenderer(renderer)
    window.Render()
    image = vtkWindowToImageFilter()
    image.SetInput(window)
    writer = vtkPNGWriter()
    writer.SetInputConnection(image.GetOutputPort())
    writer.SetFileName(str(out))
    writer.Write()


def main(twin, folder, case, out, picture=None):
    mesh = simulated(twin, folder, case)
    write(mesh, out)
    if picture:
        draw(mesh, picture)


if __name__ == "__main__":
    if len(sys.argv) not in (5, 6):
        sys.exit(__doc__)
    main(*sys.argv[1:])
