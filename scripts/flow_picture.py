#!/usr/bin/env python
"""Draws flow: scripts/flow_picture.py FLOW.vtu LINES.vtp OUT.png (with .venv's VTK).

The lower half of the mesh, coloured by pressure and cut at the middle of z (of a 2-D mesh all of it);
faces on faults in black, streamlines in green.
"""
import sys

import vtkmodules.vtkRenderingOpenGL2  # noqa: F401 (registers the renderer)
from vtkmodules.vtkCommonCore import vtkLookupTable
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPlane, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkCutter, vtkTubeFilter
from vtkmodules.vtkFiltersGeneral import vtkClipDataSet
from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter
from vtkmodules.vtkFiltersModeling import vtkOutlineFilter
from vtkmodules.vtkIOImage import vtkPNGWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader
from vtkmodules.vtkRenderingCore import (
    vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter)

# Of tetrahedra and triangles, by the number of corners.
FACES = {4: ((1, 3, 2), (0, 2, 3), (0, 3, 1), (0, 1, 2)), 3: ((1, 2), (2, 0), (0, 1))}


def read(reader, name):
    reader.SetFileName(name)
    reader.Update()
    return reader.GetOutput()


def actor(source, color=None):
    mapper = vtkPolyDataMapper()
    mapper.SetInputConnection(source.GetOutputPort())
    result = vtkActor()
    result.SetMapper(mapper)
    if color:
        mapper.ScalarVisibilityOff()
        result.GetProperty().SetColor(*color)
    result.GetProperty().SetAmbient(0.3)
    return result


def faults(mesh):
    """The faces on faults."""
    arrays = mesh.GetCellData()
    bits = arrays.GetArray("feature_faces") or arrays.GetArray("feature_edges")
    found = vtkCellArray()
    corners = mesh.GetCell(0).GetNumberOfPoints()
    for cell in range(mesh.GetNumberOfCells()):
        nodes = mesh.GetCell(cell).GetPointIds()
        for k, face in enumerate(FACES[corners]):
            if int(bits.GetValue(cell)) >> k & 1:
                found.InsertNextCell(len(face))
                for i in face:
                    found.InsertCellPoint(nodes.GetId(i))
    result = vtkPolyData()
    result.SetPoints(mesh.GetPoints())
    (result.SetPolys if corners == 4 else result.SetLines)(found)
    return result


def main(mesh_file, lines_file, out):
    mesh = read(vtkXMLUnstructuredGridReader(), mesh_file)
    mesh.GetPointData().SetActiveScalars("pressure")
    lines = read(vtkXMLPolyDataReader(), lines_file)
    low, high = mesh.GetBounds()[4:]
    flat = low == high
    plane = vtkPlane()
    plane.SetOrigin(0, 0, 0.5 * (low + high))
    plane.SetNormal(0, 0, 1)
    clip = vtkClipDataSet()
    clip.SetInputData(mesh)
    clip.SetClipFunction(plane)
    clip.InsideOutOn()
    surface = vtkDataSetSurfaceFilter()
    if flat:
        surface.SetInputData(mesh)
    else:
        surface.SetInputConnection(clip.GetOutputPort())
    # The extremes at the wells would leave no colours for the rest.
    values = mesh.GetPointData().GetArray("pressure")
    ranked = sorted(values.GetValue(i) for i in range(values.GetNumberOfTuples()))
    colours = vtkLookupTable()
    colours.SetHueRange(0.667, 0)
    colours.SetSaturationRange(0.6, 0.6)
    colours.SetRange(ranked[len(ranked) // 50], ranked[-1 - len(ranked) // 50])
    colours.Build()
    section = actor(surface)
    section.GetMapper().SetLookupTable(colours)
    section.GetMapper().UseLookupTableScalarRangeOn()
    trace = vtkCutter()
    trace.SetInputData(faults(mesh))
    trace.SetCutFunction(plane)
    thick = vtkTubeFilter()
    if flat:
        thick.SetInputData(faults(mesh))
    else:
        thick.SetInputConnection(trace.GetOutputPort())
    thick.SetRadius(0.005 * mesh.GetLength())
    thin = vtkTubeFilter()
    thin.SetInputData(lines)
    thin.SetRadius(0.0015 * mesh.GetLength())
    outline = vtkOutlineFilter()
    outline.SetInputData(mesh)

    renderer = vtkRenderer()
    renderer.SetBackground(1, 1, 1)
    for shown in (section, actor(thick, (0.05, 0.05, 0.05)), actor(thin, (0.1, 0.4, 0.1)),
                  actor(outline, (0.5, 0.5, 0.5))):
        renderer.AddActor(shown)
    camera = renderer.GetActiveCamera()
    camera.SetPosition(*((0, 0, 1) if flat else (-0.25, -0.6, 1)))
    camera.SetFocalPoint(0, 0, 0)
    camera.SetViewUp(0, 1, 0)
    renderer.ResetCamera()
    camera.Zoom(1.15)
    window = vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(8)
    window.SetSize(1000, 700)
    window.AddRenderer(renderer)
    window.Render()
    grab = vtkWindowToImageFilter()
    grab.SetInput(window)
    writer = vtkPNGWriter()
    writer.SetFileName(out)
    writer.SetInputConnection(grab.GetOutputPort())
    writer.Write()


if __name__ == "__main__":
    main(*sys.argv[1:])
