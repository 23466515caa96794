"""`image.atomesh` of PyVista's images, from PyVista 0.48 on, which finds this module by its entry point."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pyvista

from . import feature
from ._mesh import mesh, voronoi

if TYPE_CHECKING:
    from ._mesh import Mesh


class Accessor:
    """What atomesh makes of a pyvista.ImageData: `image.atomesh.mesh(distance=8)`."""

    def __init__(self, image: Any) -> None:
        self._image = image

    def mesh(self, **options: Any) -> Mesh:
        """As atomesh.mesh."""
        return mesh(self._image, **options)

    def voronoi(self, **options: Any) -> Mesh:
        """As atomesh.voronoi."""
        return voronoi(self._image, **options)

    def feature(self, **options: Any) -> Any:
        """As atomesh.feature, as a pyvista.ImageData."""
        return feature(self._image, **options).to_pyvista()


pyvista.register_dataset_accessor("atomesh", pyvista.ImageData)(Accessor)
