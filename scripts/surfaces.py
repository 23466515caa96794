#!/usr/bin/env python
"""Draws labelled surfaces side by side, a colour each: scripts/surfaces.py UP OUT.png A.vtp [B.vtp ...]

UP is the direction that points up in the picture: x, -x, y, -y, z or -z. Needs VTK (.venv has it).
"""
import colorsys
import sys

import vtkmodules.vtkRenderingOpenGL2  # noqa: F401 (registers the renderer)
from vtkmodules.vtkCommonCore import vtkLookupTable
from vtkmodules.vtkFiltersModeling import vtkOutlineFilter
from vtkmodules.vtkIOImage import vtkPNGWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader
from vtkmodules.vtkRenderingCore import (
    vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter)


def colours(count):
    """Neighbouring numbers far apart in hue."""
    table = vtkLookupTable()
    table.SetNumberOfTableValues(count + 1)
    table.SetRange(0, count)
    for i in range(count + 1):
        rgb = colorsys.hsv_to_rgb(0.08 + i * 0.618 % 1.0, 0.35 + 0.12 * (i * 7 % 3), 0.92 - 0.1 * (i * 5 % 4))
        table.SetTableValue(i, *rgb, 1.0)
    return table


def main(up, picture_name, *names):
    sign = -1.0 if up.startswith("-") else 1.0
    axis = "xyz".index(up[-1])
    view = [0.0] * 3
    view[axis], view[(axis + 1) % 3], view[(axis + 2) % 3] = 0.55 * sign, 0.95, 1.25
    view_up = [0.0] * 3
    view_up[axis] = sign
    window = vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(8)
    window.SetSize(560 * len(names), 480)
    for k, name in enumerate(names):
        reader = vtkXMLPolyDataReader()
        reader.SetFileName(name)
        reader.Update()
        data = reader.GetOutput()
        data.GetCellData().SetActiveScalars("surface")
        count = int(data.GetCellData().GetScalars().GetRange()[1])
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(data)
        mapper.SetLookupTable(colours(count))
        mapper.UseLookupTableScalarRangeOn()
        shown = vtkActor()
        shown.SetMapper(mapper)
        shown.GetProperty().SetAmbient(0.3)
        if data.GetNumberOfCells() < 12000:
            shown.GetProperty().EdgeVisibilityOn()
        shown.GetProperty().SetEdgeColor(0.2, 0.22, 0.25)
        shown.GetProperty().SetLineWidth(0.5)
        outline = vtkOutlineFilter()
        outline.SetInputData(data)
        mapper = vtkPolyDataMapper()
        mapper.SetInputConnection(outline.GetOutputPort())
        frame = vtkActor()
        frame.SetMapper(mapper)
        frame.GetProperty().SetColor(0.3, 0.3, 0.3)
        renderer = vtkRenderer()
        renderer.AddActor(shown)
        renderer.AddActor(frame)
        renderer.SetBackground(1, 1, 1)
        renderer.SetViewport(k / len(names), 0, (k + 1) / len(names), 1)
        window.AddRenderer(renderer)
        camera = renderer.GetActiveCamera()
        camera.SetPosition(*view)
        camera.SetFocalPoint(0, 0, 0)
        camera.SetViewUp(*view_up)
        renderer.ResetCamera()
        camera.Zoom(1.1)
    window.Render()
    grab = vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.Update()
    writer = vtkPNGWriter()
    writer.SetFileName(picture_name)
    writer.SetInputConnection(grab.GetOutputPort())
    writer.Write()


if __name__ == "__main__":
    main(*sys.argv[1:])
