"""The accessor `image.atomesh` of PyVista's images.

PyVista finds this module by its entry point, from version 0.48 on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pyvista

from . import feature
from ._mesh import mesh, voronoi

if TYPE_CHECKING:
    from ._mesh import Mesh


class Accessor:
    """Functions of atomesh for a pyvista.ImageData, such as `image.atomesh.mesh(distance=8)`."""

    def __init__(self, image: Any) -> None:
        self._image = image

    def mesh(self, **options: Any) -> Mesh:
        """Calls atomesh.mesh for the image."""
        return mesh(self._image, **options)

    def voronoi(self, **options: Any) -> Mesh:
        """Calls atomesh.voronoi for the image."""
        return voronoi(self._image, **options)

    def feature(self, **options: Any) -> Any:
        """Calls atomesh.feature for the image; returns a pyvista.ImageData."""
        return feature(self._image, **options).to_pyvista()


pyvista.register_dataset_accessor("atomesh", pyvista.ImageData)(Accessor)
