#!/usr/bin/env python
"""Draws a painted unit: scripts/unit_picture.py IMAGE.vti SURFACES.vtp PAINTED.vtu UNIT.vtp OUT.png
(with .venv's VTK).

Three panels, x downwards: the middle section of the image along x and y with the faults (red) and
horizons (yellow) that the mesh follows; the same with the painted cells; the surface around the unit.
"""
import sys

import vtkmodules.vtkRenderingOpenGL2  # noqa: F401 (registers the renderer)
from vtkmodules.vtkCommonCore import vtkLookupTable
from vtkmodules.vtkCommonDataModel import vtkPlane
from vtkmodules.vtkFiltersCore import vtkCutter, vtkThreshold, vtkTubeFilter
from vtkmodules.vtkFiltersModeling import vtkOutlineFilter
from vtkmodules.vtkIOImage import vtkPNGWriter
from vtkmodules.vtkIOXML import (
    vtkXMLImageDataReader, vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader)
from vtkmodules.vtkRenderingCore import (
    vtkActor, vtkDataSetMapper, vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter)


def read(reader, name):
    reader.SetFileName(name)
    reader.Update()
    return reader.GetOutput()


def actor(data, colours=None, by_cell=None):
    mapper = vtkDataSetMapper()
    mapper.SetInputData(data)
    if by_cell:
        mapper.SetColorModeToMapScalars()
        mapper.SetScalarModeToUseCellFieldData()
        mapper.SelectColorArray(by_cell)
    if colours:
        mapper.SetLookupTable(colours)
        mapper.UseLookupTableScalarRangeOn()
    result = vtkActor()
    result.SetMapper(mapper)
    return result


def table(low, high, first, last):
    """Colours from first to last."""
    result = vtkLookupTable()
    result.SetRange(low, high)
    result.SetNumberOfTableValues(256)
    for i in range(256):
        t = i / 255
        result.SetTableValue(i, *[(1 - t) * a + t * b for a, b in zip(first, last)], 1)
    return result


def section(data, plane):
    """Computed at once: nothing holds the filter later."""
    cut = vtkCutter()
    cut.SetInputData(data)
    cut.SetCutFunction(plane)
    cut.Update()
    return cut.GetOutput()


def main(image_file, surfaces_file, painted_file, unit_file, out):
    image = read(vtkXMLImageDataReader(), image_file)
    surfaces = read(vtkXMLPolyDataReader(), surfaces_file)
    painted = read(vtkXMLUnstructuredGridReader(), painted_file)
    unit = read(vtkXMLPolyDataReader(), unit_file)
    plane = vtkPlane()
    plane.SetOrigin(*image.GetCenter())
    plane.SetNormal(0, 0, 1)
    low, high = image.GetScalarRange()
    grey = table(low, high, (0.05, 0.05, 0.05), (0.95, 0.95, 0.95))
    kinds = table(0, 1, (0.85, 0.1, 0.1), (0.95, 0.8, 0.1))
    lines = vtkTubeFilter()
    lines.SetInputData(section(surfaces, plane))
    lines.SetRadius(0.004 * image.GetLength())
    lines.Update()
    chosen = vtkThreshold()
    chosen.SetInputData(section(painted, plane))
    chosen.SetInputArrayToProcess(0, 0, 0, 1, "region")
    chosen.SetUpperThreshold(0.5)
    chosen.SetThresholdFunction(vtkThreshold.THRESHOLD_UPPER)
    chosen.Update()
    cells = actor(chosen.GetOutput())
    cells.GetMapper().ScalarVisibilityOff()
    cells.GetProperty().SetColor(0.35, 0.6, 0.85)
    cells.GetProperty().EdgeVisibilityOn()
    cells.AddPosition(0, 0, -0.5)


    skin = vtkDataSetMapper()
    skin.SetInputData(unit)
    skin.ScalarVisibilityOff()
    around = vtkActor()
    around.SetMapper(skin)
    around.GetProperty().SetColor(0.35, 0.6, 0.85)
    around.GetProperty().EdgeVisibilityOn()
    around.GetProperty().SetLineWidth(0.5)
    outline = vtkOutlineFilter()
    outline.SetInputData(painted)
    outline.Update()
    frame = actor(outline.GetOutput())
    frame.GetProperty().SetColor(0.4, 0.4, 0.4)

    window = vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(8)
    window.SetSize(1320, 400)
    panels = (((0, 0, -1), lambda: (actor(section(image, plane), grey), actor(lines.GetOutput(), kinds, "horizon"))),
              ((0, 0, -1), lambda: (actor(section(image, plane), grey), cells, actor(lines.GetOutput(), kinds, "horizon"))),
              ((-0.35, -0.8, -0.9), lambda: (around, frame)))
    for k, (view, actors) in enumerate(panels):
        renderer = vtkRenderer()
        renderer.SetBackground(1, 1, 1)
        renderer.SetViewport(k / 3, 0, (k + 1) / 3, 1)
        for shown in actors():
            shown.GetProperty().SetAmbient(0.35)
            renderer.AddActor(shown)
        window.AddRenderer(renderer)
        camera = renderer.GetActiveCamera()
        camera.SetPosition(*view)
        camera.SetFocalPoint(0, 0, 0)
        camera.SetViewUp(-1, 0, 0)
        renderer.ResetCamera()
        camera.Zoom(1.35 if k < 2 else 1.1)
    window.Render()
    grab = vtkWindowToImageFilter()
    grab.SetInput(window)
    writer = vtkPNGWriter()
    writer.SetFileName(out)
    writer.SetInputConnection(grab.GetOutputPort())
    writer.Write()


if __name__ == "__main__":
    main(*sys.argv[1:])
