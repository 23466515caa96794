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
from ._call import error as _error
from ._call import options_of as _options_of
from ._call import verbs as _verbs
from ._errors import Error, MeshWarning, MissingItemError
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
    "MeshWarning",
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
        The potential, float32, as many samples as the volume: -1 on features and 0 far away from them. Its attribute
        `report` holds the report of the verb.

    Raises
    ------
    ArgumentError
        If there is no such option, or if the volume or an option has a wrong type. This is also a TypeError.
    InvalidValueError
        If an option or the image has impossible values. This is also a ValueError.
    MissingFileError
        If a file does not exist. This is also a FileNotFoundError.

    Examples
    --------
    >>> import atomesh
    >>> potential = atomesh.feature(atomesh.synth("sphere", dims=(24, 24, 24)))
    >>> potential.samples.shape
    (24, 24, 24)
    >>> bool(-1 <= potential.samples.min() < -0.9 and potential.samples.max() <= 0)
    True
    """
    objects = {_NAME: Image.of(volume)._native}
    output = "<potential>.vti"
    answer = _call("feature", [_NAME], {"output": output, **options}, objects, progress)
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
        Options of the verb; `atomesh.options("synth")` lists them. `dims` are the numbers of samples along x, y and z.
        With `truth="distance.npy"`, the exact distances to the features are written, too.

    Returns
    -------
    Image
        The image, float32, with samples at distances of 1 (in surveys 12.5 m and 4 ms).

    Raises
    ------
    ArgumentError
        If there is no such option, or if an option has a wrong type. This is also a TypeError.
    InvalidValueError
        If there is no such kind, or if an option is impossible. This is also a ValueError.

    Examples
    --------
    >>> import atomesh
    >>> atomesh.synth("faults", dims=(40, 36, 32), count=1).samples.shape
    (32, 36, 40)
    """
    output = "<image>.vti"
    answer = _call("synth", [kind], {"output": output, **options})
    return Image(answer.kept[output])


def convert(volume: Volume, path: str | os.PathLike[str]) -> None:
    """Writes an image in the format of the file's ending: `atomesh convert`.

    Parameters
    ----------
    volume
        The image, in any form that `Image.of` accepts.
    path
        The file to write: .vti, .npy, .nrrd, .mha, .nii or .nii.gz, .zarr, in 2-D also .png.

    Raises
    ------
    InvalidValueError
        If no format has this ending, or if the format cannot hold the image. This is also a ValueError.
    FileError
        If the file cannot be written. This is also an OSError.

    Examples
    --------
    >>> import atomesh, numpy as np
    >>> atomesh.convert(np.eye(8, dtype=np.float32), "eye.nrrd")
    >>> atomesh.read("eye.nrrd").samples.shape
    (8, 8)
    """
    Image.of(volume).save(path)


def info(path: str | os.PathLike[str], **options: Any) -> dict[str, Any]:
    """Describes a file of an image or a mesh: `atomesh info`.

    Parameters
    ----------
    path
        The file.
    **options
        Options of the verb, which say how to read the file; `atomesh.options("info")` lists them.

    Returns
    -------
    dict
        Dimensions, geometry, units, range, SEG-Y headers and more.

    Raises
    ------
    MissingFileError
        If there is no such file. This is also a FileNotFoundError.
    InvalidValueError
        If the file is damaged, or of no known format. This is also a ValueError.

    Examples
    --------
    >>> import atomesh
    >>> atomesh.synth("faults", dims=(40, 36, 32), count=1).save("faults.vti")
    >>> atomesh.info("faults.vti")["image"]["numpy_shape"]
    [32, 36, 40]
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

    Raises
    ------
    MissingItemError
        If there is no such verb. This is also a KeyError.

    Examples
    --------
    >>> import atomesh
    >>> "distance" in atomesh.options("mesh")
    True
    >>> atomesh.options("mesh")["cells"].startswith("Kind of cells")
    True
    """
    if verb not in _verbs():
        remedy = f"give one of {', '.join(_verbs())}"
        raise _error(f"options({verb!r})", "there is no such verb", remedy, MissingItemError)

    def help_text(option: dict[str, Any]) -> str:
        text = option["help"] or ""
        if option["choices"] and not option["flag"]:
            text += f" [one of: {', '.join(option['choices'])}]"
        if option["default"] is not None and not option["flag"]:
            text += f" [default: {option['default']}]"
        return text

    return {name: help_text(option) for name, option in _options_of(verb).items()}
