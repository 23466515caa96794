#!/usr/bin/env python
"""Draws a mesh over its image: scripts/picture.py IMAGE.vti MESH.vtu OUT.png (with .venv's VTK).

Left, the image on three sections; right, the mesh cut open, the faces on features in orange.
"""
import sys

import vtkmodules.vtkRenderingOpenGL2  # noqa: F401 (registers the renderer)
from vtkmodules.vtkCommonCore import vtkLookupTable, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPlane, vtkPolyData
from vtkmodules.vtkFiltersExtraction import vtkExtractGeometry
from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter
from vtkmodules.vtkFiltersModeling import vtkOutlineFilter
from vtkmodules.vtkImagingCore import vtkExtractVOI
from vtkmodules.vtkIOImage import vtkPNGWriter
from vtkmodules.vtkIOXML import vtkXMLImageDataReader, vtkXMLUnstructuredGridReader
from vtkmodules.vtkRenderingCore import (
    vtkActor, vtkDataSetMapper, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow,
    vtkWindowToImageFilter)


def read(reader, name):
    reader.SetFileName(name)
    reader.Update()
    return reader.GetOutput()


def actor(mapper, color=None, edges=False, opacity=1.0):
    result = vtkActor()
    result.SetMapper(mapper)
    shown = result.GetProperty()
    if color:
        mapper.ScalarVisibilityOff()
        shown.SetColor(*color)
    if edges:
        shown.EdgeVisibilityOn()
        shown.SetEdgeColor(0.25, 0.3, 0.35)
        shown.SetLineWidth(1.0)
    shown.SetOpacity(opacity)
    shown.SetAmbient(0.25)
    return result


def sections(image):
    """The image on the three sections that the cut-open mesh shows."""
    grey = vtkLookupTable()
    grey.SetHueRange(0, 0)
    grey.SetSaturationRange(0, 0)
    grey.SetValueRange(0.05, 1.0)
    grey.SetRange(image.GetScalarRange())
    grey.Build()
    extent = image.GetExtent()
    for axis, at in ((0, extent[1]), (1, extent[2]), (2, extent[5])):
        part = list(extent)
        part[2 * axis] = part[2 * axis + 1] = at
        cut = vtkExtractVOI()
        cut.SetInputData(image)
        cut.SetVOI(*part)
        mapper = vtkDataSetMapper()
        mapper.SetInputConnection(cut.GetOutputPort())
        mapper.SetLookupTable(grey)
        mapper.UseLookupTableScalarRangeOn()
        shown = actor(mapper)
        shown.GetProperty().LightingOff()
        yield shown


def feature_faces(grid):
    """Faces whose nodes all lie on a feature, and whose tetrahedra do not."""
    depth = grid.GetPointData().GetArray("feature")
    faces = set()
    for cell in range(grid.GetNumberOfCells()):
        ids = grid.GetCell(cell).GetPointIds()
        nodes = [ids.GetId(k) for k in range(4)]
        deep = [n for n in nodes if depth.GetTuple1(n) < -0.9]
        if len(deep) == 3:
            faces.add(tuple(sorted(deep)))
    points, cells = vtkPoints(), vtkCellArray()
    points.DeepCopy(grid.GetPoints())
    for face in sorted(faces):
        cells.InsertNextCell(3, face)
    result = vtkPolyData()
    result.SetPoints(points)
    result.SetPolys(cells)
    return result


def main(image_name, mesh_name, picture_name):
    image = read(vtkXMLImageDataReader(), image_name)
    grid = read(vtkXMLUnstructuredGridReader(), mesh_name)
    low, high = grid.GetBounds()[::2], grid.GetBounds()[1::2]

    left, right = vtkRenderer(), vtkRenderer()
    for shown in sections(image):
        left.AddActor(shown)

    plane = vtkPlane()
    plane.SetOrigin(*((a + b) / 2 for a, b in zip(low, high)))
    plane.SetNormal(1.0, -0.35, 0.25)
    half = vtkExtractGeometry()
    half.SetInputData(grid)
    half.SetImplicitFunction(plane)
    skin = vtkDataSetSurfaceFilter()
    skin.SetInputConnection(half.GetOutputPort())
    mapper = vtkPolyDataMapper()
    mapper.SetInputConnection(skin.GetOutputPort())
    right.AddActor(actor(mapper, (0.80, 0.86, 0.90), edges=True))
    mapper = vtkPolyDataMapper()
    mapper.SetInputData(feature_faces(grid))
    right.AddActor(actor(mapper, (0.95, 0.55, 0.15), edges=True))

    outline = vtkOutlineFilter()
    outline.SetInputData(grid)
    window = vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(8)
    window.SetSize(1400, 620)
    for k, renderer in enumerate((left, right)):
        mapper = vtkPolyDataMapper()
        mapper.SetInputConnection(outline.GetOutputPort())
        renderer.AddActor(actor(mapper, (0.3, 0.3, 0.3)))
        renderer.SetBackground(1, 1, 1)
        renderer.SetViewport(k / 2, 0, (k + 1) / 2, 1)
        window.AddRenderer(renderer)
        camera = renderer.GetActiveCamera()
        camera.SetPosition(2.2, -2.6, 1.6)
        camera.SetFocalPoint(0, 0, 0)
        camera.SetViewUp(0, 0, 1)
        renderer.ResetCamera(grid.GetBounds())
        camera.Zoom(1.12)
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
