"""Images, above all seismic volumes, straight to feature-aligned meshes.

    mesh = atomesh.mesh(volume, spacing=(25, 12.5, 4), distance=8, feature="faults")
    mesh.points, mesh.cells, mesh.feature_faces
    mesh.quality, mesh.fidelity
    mesh.regions, mesh.surfaces["fault1"], mesh[mesh.cell_data["region"] == 1]
    mesh.to_pyvista(), mesh.to_meshio(), mesh.save("mesh.vtu"), mesh.save("mesh.msh")
    cells = atomesh.voronoi(volume); cells.flow(injectors=[...], producers=[...])

The module has a function or a method for every verb of the command line. mesh, voronoi, feature, convert, info and
synth are functions; the other verbs are methods of Mesh. `read` reads the file of an image, `load` that of a mesh.
Options have the names of the command line, with underscores: `options("mesh")` lists them. All errors are instances of
Error, and also of the standard exception that fits them: TypeError, ValueError, FileNotFoundError and so on.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from . import _native
from ._call import call as _call
from ._call import options_of as _options_of
from ._errors import Error
from ._image import NAME as _NAME
from ._image import Image, read
from ._mesh import Mesh, Picture, Region, load, mesh, voronoi
from ._surfaces import Surface, Surfaces, SurfacesOfMesh

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ._call import Progress
    from ._image import Volume
    from ._options import FeatureOptions, SynthOptions

__all__ = [
    "Error",
    "Image",
    "Mesh",
    "Picture",
    "Region",
    "Surface",
    "Surfaces",
    "SurfacesOfMesh",
    "convert",
    "feature",
    "info",
    "load",
    "mesh",
    "options",
    "read",
    "synth",
    "voronoi",
]

__version__ = _native.__version__


def feature(volume: Volume, *, progress: Progress = False, **options: Unpack[FeatureOptions]) -> Image:
    """Computes the potential b(x) of an image's features: `atomesh feature`.

    Parameters
    ----------
    volume
        The image, in any form that `Image.of` accepts.
    progress
        True to show the progress, or a callable that receives the name of the stage and the fraction of it that is
        done.
    **options
        Options of the verb; `atomesh.options("feature")` lists them.

    Returns
    -------
    Image
        The potential: -1 on features and 0 far away from them. Its attribute `report` holds the report of the verb.
    """
    objects = {_NAME: Image.of(volume)._native}
    output = "<potential>.vti"
    answer = _call("feature", [_NAME], {"output": output, **options}, objects, [output], progress)
    image = Image(answer.kept[output])
    image.report = answer.report
    return image


def synth(kind: str, **options: Unpack[SynthOptions]) -> Image:
    """Makes a synthetic image whose features are known exactly: `atomesh synth`.

    Parameters
    ----------
    kind
        The kind of image: "faults", "sphere", "amplitude" ...
    **options
        Options of the verb. With `truth="distance.npy"`, the exact distances to the features are written, too.

    Returns
    -------
    Image
        The image.
    """
    output = "<image>.vti"
    answer = _call("synth", [kind], {"output": output, **options}, keep=[output])
    return Image(answer.kept[output])


def convert(volume: Volume, path: str | os.PathLike[str]) -> None:
    """Writes an image in the format of the file's ending.

    Parameters
    ----------
    volume
        The image, in any form that `Image.of` accepts.
    path
        The file to write: .vti, .npy, .nrrd, .mha, .nii or .nii.gz, in 2-D also .png.
    """
    Image.of(volume).save(path)


def info(path: str | os.PathLike[str], **options: Any) -> dict[str, Any]:
    """Describes a file of an image or a mesh: `atomesh info`.

    Parameters
    ----------
    path
        The file.
    **options
        Options of the verb, which say how to read the file.

    Returns
    -------
    dict
        Dimensions, geometry, units, range, SEG-Y headers and more.
    """
    return _call("info", [path], options).report


def options(verb: str) -> dict[str, str]:
    """Returns the options of a verb.

    Parameters
    ----------
    verb
        The name of the verb: "mesh", "flow", "export" ...

    Returns
    -------
    dict
        The help text of each option, by its name as a keyword argument.
    """

    def help_text(option: dict[str, Any]) -> str:
        text = option["help"] or ""
        if option["choices"] and not option["flag"]:
            text += f" [one of: {', '.join(option['choices'])}]"
        if option["default"] is not None and not option["flag"]:
            text += f" [default: {option['default']}]"
        return text

    return {name: help_text(option) for name, option in _options_of(verb).items()}
