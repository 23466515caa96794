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
        """Calls `atomesh.mesh` for the image.

        Parameters
        ----------
        **options
            The arguments of `atomesh.mesh`, except the image.

        Returns
        -------
        Mesh
            The mesh, with its report.

        Raises
        ------
        Error
            As `atomesh.mesh` does.
        """
        return mesh(self._image, **options)

    def voronoi(self, **options: Any) -> Mesh:
        """Calls `atomesh.voronoi` for the image.

        Parameters
        ----------
        **options
            The arguments of `atomesh.voronoi`, except the image.

        Returns
        -------
        Mesh
            The mesh of Voronoi cells, with its report.

        Raises
        ------
        Error
            As `atomesh.mesh` does.
        """
        return voronoi(self._image, **options)

    def feature(self, **options: Any) -> Any:
        """Calls `atomesh.feature` for the image.

        Parameters
        ----------
        **options
            The arguments of `atomesh.feature`, except the image.

        Returns
        -------
        pyvista.ImageData
            The potential, as the point array `samples`.

        Raises
        ------
        Error
            As `atomesh.feature` does.
        """
        return feature(self._image, **options).to_pyvista()


pyvista.register_dataset_accessor("atomesh", pyvista.ImageData)(Accessor)
