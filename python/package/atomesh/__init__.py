"""Images, above all seismic volumes, straight to feature-aligned meshes.

    mesh = atomesh.mesh(volume, spacing=(25, 12.5, 4), distance=8, feature="faults")
    mesh.points, mesh.cells, mesh.feature_faces
    mesh.quality, mesh.fidelity
    mesh.to_pyvista(), mesh.to_meshio(), mesh.save("mesh.vtu")
    cells = atomesh.voronoi(volume); cells.flow(injectors=[...], producers=[...])

Every verb of the command line is here: mesh and voronoi, feature, read (an image), convert, info, synth, load
(a mesh); the others are methods of Mesh. Their options are those of the command line, with underscores:
`options("mesh")` tells them. What is wrong is said by one exception, Error.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import _native
from ._call import call as _call
from ._call import options_of as _options_of
from ._image import NAME as _NAME
from ._image import Image, read
from ._mesh import Mesh, Picture, load, mesh, voronoi
from ._native import Error
from ._surfaces import Surface, Surfaces

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
    "Surface",
    "Surfaces",
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

_native.run_tetgen_in(Path(__file__).parent / "atomesh-tetgen")


def feature(volume: Volume, *, progress: Progress = False, **options: Unpack[FeatureOptions]) -> Image:
    """The potential b(x) of an image's features, -1 on them and 0 far away: `atomesh feature`.

    The image's attribute `report` tells what was found.
    """
    held = {_NAME: Image.of(volume)._native}
    made = "<potential>.vti"
    answer = _call("feature", [_NAME], {"output": made, **options}, held, [made], progress)
    image = Image(answer.kept[made])
    image.report = answer.report
    return image


def synth(kind: str, **options: Unpack[SynthOptions]) -> Image:
    """A synthetic image whose features are known exactly: `atomesh synth`.

    `kind`: "faults", "sphere", "amplitude" ...; `truth="distance.npy"` writes the exact distances.
    """
    made = "<image>.vti"
    answer = _call("synth", [kind], {"output": made, **options}, keep=[made])
    return Image(answer.kept[made])


def convert(volume: Volume, path: str | os.PathLike[str]) -> None:
    """Writes an image in another format, by the ending: .vti, .npy, .nrrd, .mha, .nii, .nii.gz, in 2-D .png."""
    Image.of(volume).save(path)


def info(path: str | os.PathLike[str], **options: Any) -> dict[str, Any]:
    """What a file holds, an image or a mesh: dimensions, geometry, units, range, SEG-Y headers: `atomesh info`."""
    return _call("info", [path], options).report


def options(verb: str) -> dict[str, str]:
    """The options of a verb ("mesh", "flow", "export" ...), as keyword arguments, and what they mean."""
    def told(option: dict[str, Any]) -> str:
        text = option["help"] or ""
        if option["choices"] and not option["flag"]:
            text += f" [one of: {', '.join(option['choices'])}]"
        if option["default"] is not None and not option["flag"]:
            text += f" [default: {option['default']}]"
        return text

    return {name: told(option) for name, option in _options_of(verb).items()}
