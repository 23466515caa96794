"""Images: samples, and their position in the world."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from . import _native
from ._call import call, error
from ._errors import ArgumentError

if TYPE_CHECKING:
    import numpy.typing as npt

    Volume = Union[str, os.PathLike[str], "Image", npt.NDArray[Any], Any]

#: The name by which verbs refer to the image of a call.
NAME = "<volume>"


class Image:
    """A 2-D or 3-D image, and the position of its samples.

    `samples` has the shape (nz, ny, nx), in 2-D (ny, nx), as in ITK and VTK: x is the last axis of the array.
    `spacing`, `origin` and `units` are in the order x, y, z. `numpy.asarray(image)` is the array of samples. Images are
    made by `Image.of`, `read`, `synth` and `feature`; they can be copied and pickled.

    Attributes
    ----------
    report : dict
        The report of the verb that made the image; empty for others.

    Examples
    --------
    >>> import atomesh, numpy as np
    >>> image = atomesh.Image.of(np.zeros((20, 30, 40)), spacing=(25, 12.5, 4), units=("m", "m", "ms"))
    >>> image
    <atomesh.Image 40 x 30 x 20, spacing 25, 12.5, 4>
    """

    def __init__(self, native: _native.Image) -> None:
        self._native = native
        #: The report of the verb that made the image.
        self.report: dict[str, Any] = {}

    @classmethod
    def of(  # words: allow
        cls,
        volume: Volume,
        spacing: float | Sequence[float] | None = None,
        origin: Sequence[float] | None = None,
        units: str | Sequence[str] | None = None,
    ) -> Image:
        """Creates an image from any object that holds one.

        Parameters
        ----------
        volume
            The path of a file, a NumPy array of shape (nz, ny, nx) or (ny, nx), an xarray.DataArray, a
            pyvista.ImageData or vtkImageData, a SimpleITK image or a nibabel image. Masked samples of a masked
            array are missing (NaN).
        spacing
            The distances between samples along x, y, z, or one distance for all axes. They replace those of the
            volume.
        origin
            The position of the first sample: x, y, z. It replaces that of the volume.
        units
            The units of the axes, or one unit for all. They replace those of the volume.

        Returns
        -------
        Image
            The image.

        Raises
        ------
        ArgumentError
            If the volume is of a type that holds no real numbers. This is also a TypeError.
        InvalidValueError
            If the array has a wrong shape, or if the other arguments do not fit it. This is also a ValueError.

        Examples
        --------
        >>> import atomesh, numpy as np
        >>> image = atomesh.Image.of(np.zeros((20, 30, 40)), spacing=12.5, units="m")
        >>> image.spacing
        array([12.5, 12.5, 12.5])
        """
        if isinstance(volume, (str, os.PathLike)):
            return cls.of(read(volume), spacing, origin, units)
        if isinstance(volume, Image) and (volume.samples.ndim == 2 or len(volume.samples) > 1):
            return volume._at(spacing, origin, units)
        if isinstance(volume, Image):
            source = _Source(volume.samples, volume.origin, volume.axes, volume.units)
        else:
            source = _source(volume)
        array = _filled(source.array)
        if not (np.issubdtype(array.dtype, np.number) or array.dtype == bool) or np.iscomplexobj(array):
            is_other_type = array.dtype == object and array.ndim == 0
            if is_other_type:
                remedy = "give an array of real numbers, the path of an image, or an image of another package"
                raise error(NAME, f"is of type {type(volume).__name__}", remedy, ArgumentError)
            raise error(NAME, f"holds {array.dtype}", "give real numbers", ArgumentError)
        if array.ndim == 3 and array.shape[0] == 1:
            array = array[0]
            source.origin, source.axes = source.origin[:2], source.axes[:2, :2]
        if array.ndim not in (2, 3):
            shape = "x".join(map(str, array.shape))
            raise error(NAME, f"has shape {shape}", "give an array of two axes or three")
        names = ["x", "y", "z"][: array.ndim]
        samples = np.ascontiguousarray(array, dtype=np.float32)
        labels = None
        if array.dtype.kind in "iu" and array.dtype.itemsize > 2 and (np.abs(samples) >= 2**24).any():
            # 32-bit floats cannot represent these integers, so that they are also passed as exact labels.
            values, index = np.unique(array, return_inverse=True)
            labels = [int(value) for value in values], index.ravel().astype(np.uint32)
        geometry = _geometry(source, array.ndim, spacing, origin, units)
        return cls._new(samples, geometry, names, str(array.dtype), labels)

    @classmethod
    def _new(cls, *parts: Any) -> Image:
        """Creates an image from the arguments of the native image."""
        try:
            return cls(_native.Image(*parts))
        except ValueError as problem:
            raise error(NAME, str(problem), "give as many of each as the array has axes") from None

    def _at(
        self, spacing: float | Sequence[float] | None, origin: Sequence[float] | None, units: str | Sequence[str] | None
    ) -> Image:
        """Returns the image with another geometry, or itself; exact labels and missing samples stay known."""
        if spacing is None and origin is None and units is None:
            return self
        samples, _, *others = self._native.parts()
        source = _Source(samples, self.origin, self.axes, self.units)
        return self._new(samples, _geometry(source, samples.ndim, spacing, origin, units), *others)

    @property
    def samples(self) -> npt.NDArray[np.float32]:
        """The samples: a read-only float32 array of shape (nz, ny, nx), in 2-D (ny, nx), without a copy.

        Examples
        --------
        >>> import atomesh
        >>> image = atomesh.synth("sphere", dims=(20, 24, 28))
        >>> image.samples.shape, image.samples.dtype
        ((28, 24, 20), dtype('float32'))
        """
        return self._native.samples

    @property
    def origin(self) -> npt.NDArray[np.float64]:
        """The position of the first sample, float64 of shape (3,), in 2-D (2,): x, y, z in `units`."""
        return np.array(self._native.place[0])

    @property
    def axes(self) -> npt.NDArray[np.float64]:
        """The vector from one sample to the next along each image axis, float64 of shape (3, 3), in 2-D (2, 2).

        Each row is an axis, in `units`; the first row belongs to the last axis of the array.
        """
        return np.array(self._native.place[1])

    @property
    def spacing(self) -> npt.NDArray[np.float64]:
        """The distance between samples along each axis, float64 of shape (3,), in 2-D (2,), in `units`.

        Examples
        --------
        >>> import atomesh, numpy as np
        >>> atomesh.Image.of(np.zeros((4, 5)), spacing=(25, 12.5)).spacing
        array([25. , 12.5])
        """
        lengths: npt.NDArray[np.float64] = np.linalg.norm(self.axes, axis=1)
        return lengths

    @property
    def units(self) -> list[str]:
        """The units of the axes in the order x, y, z, such as "m" or "ms"; an unknown unit is empty."""
        return self._native.place[2]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        return np.array(self.samples, dtype=dtype, copy=copy if copy else None)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the image to a file, in the format of its ending.

        Parameters
        ----------
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
        >>> import atomesh
        >>> atomesh.synth("sphere", dims=(20, 20, 20)).save("sphere.nii.gz")
        """
        call("convert", [NAME, path], {}, {NAME: self._native})

    def to_pyvista(self) -> Any:
        """Converts the image to PyVista.

        Returns
        -------
        pyvista.ImageData
            The image, with its spacing, origin and direction; the samples are the point array `samples`.

        Raises
        ------
        ImportError
            If PyVista is not installed.

        Examples
        --------
        >>> import atomesh
        >>> atomesh.synth("sphere", dims=(20, 24, 28)).to_pyvista().dimensions
        (20, 24, 28)
        """
        import pyvista

        samples, axes = self.samples, np.eye(3)
        count = samples.ndim
        axes[:count, :count] = self.axes
        lengths = np.linalg.norm(axes, axis=1)
        grid = pyvista.ImageData(
            dimensions=(*samples.shape[::-1], 1)[:3],
            spacing=lengths,
            origin=(*self.origin, 0.0)[:3],
            direction_matrix=(axes / lengths[:, None]).T,
        )
        grid.point_data["samples"] = samples.ravel()
        return grid

    def __repr__(self) -> str:
        shape = " x ".join(map(str, self.samples.shape[::-1]))
        spacing = ", ".join(f"{s:g}" for s in self.spacing)
        return f"<atomesh.Image {shape}, spacing {spacing}>"


def read(path: str | os.PathLike[str], **options: Any) -> Image:
    """Reads the file of an image, of any format that atomesh supports. `load` reads the file of a mesh.

    Parameters
    ----------
    path
        The file.
    **options
        Options of `atomesh convert`, which say how to read the file.

    Returns
    -------
    Image
        The image.

    Raises
    ------
    MissingFileError
        If there is no such file. This is also a FileNotFoundError.

    See Also
    --------
    load : Reads the file of a mesh.

    Examples
    --------
    >>> import atomesh
    >>> atomesh.synth("sphere", dims=(20, 20, 20)).save("sphere.vti")
    >>> atomesh.read("sphere.vti").samples.shape
    (20, 20, 20)
    """
    answer = call("convert", [path, "<image>.vti"], options)
    return Image(answer.kept["<image>.vti"])


def _geometry(
    source: _Source,
    count: int,
    spacing: float | Sequence[float] | None,
    origin: Sequence[float] | None,
    units: str | Sequence[str] | None,
) -> tuple[list[float], list[list[float]], list[str]]:
    """Returns the origin, the axes and the units of a source, or those that replace them."""
    axes = np.array(source.axes, dtype=float)
    if spacing is not None:
        lengths = np.linalg.norm(axes, axis=1)[:, None]
        axes = axes / lengths * _numbers("spacing", spacing, count)[:, None]
    place = source.origin if origin is None else _numbers("origin", origin, count)
    if units is None:
        units = source.units or [""] * count
    texts = [units] * count if isinstance(units, str) else list(units) if np.iterable(units) else [units]
    if not all(isinstance(text, str) for text in texts):
        raise error(f"units={units!r}", "is not text", "give one unit, or one for each axis", ArgumentError)
    return [float(c) for c in place], axes.tolist(), [str(text) for text in texts]


def _numbers(name: str, values: float | Sequence[float], count: int) -> npt.NDArray[np.float64]:
    order = "x, y, z" if count == 3 else "x, y"
    try:
        numbers = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise error(f"{name}={values!r}", "is not numbers", f"give {order}", ArgumentError) from None
    if name == "spacing":
        order += ", or one number for all axes"
        numbers = np.full(count, numbers) if numbers.ndim == 0 else numbers
    if numbers.shape != (count,) or not np.isfinite(numbers).all() or (name == "spacing" and (numbers <= 0).any()):
        problem = f"is not {count} positive numbers" if name == "spacing" else f"is not {count} numbers"
        raise error(f"{name}={values}", problem, f"give {order}")
    return numbers


def _filled(array: Any) -> npt.NDArray[Any]:
    """Returns the array with NaN in place of masked values."""
    if isinstance(array, np.ma.MaskedArray):
        if not np.ma.getmaskarray(array).any():
            return np.asarray(array.data)
        floats: Any = array.astype(np.result_type(array.dtype, np.float32))
        return np.asarray(floats.filled(np.nan))
    return np.asarray(array)


class _Source:
    """An array, whose last axis is x, and its position."""

    def __init__(self, array: Any, origin: Any = None, axes: Any = None, units: Any = None) -> None:
        self.array = array
        count = np.ndim(array)
        self.origin = np.zeros(count) if origin is None else np.asarray(origin, dtype=float)
        self.axes = np.eye(count) if axes is None else np.asarray(axes, dtype=float)
        self.units: list[str] | None = units


def _source(volume: Any) -> _Source:
    """Returns the array and the position of a volume. Its type is recognised by its attributes, without imports."""
    if all(hasattr(volume, name) for name in ("dims", "coords", "values", "transpose")):
        return _from_xarray(volume)
    if all(hasattr(volume, name) for name in ("dimensions", "spacing", "origin", "point_data", "active_scalars")):
        return _from_pyvista(volume)
    if hasattr(volume, "IsA") and volume.IsA("vtkImageData"):
        return _from_vtk(volume)
    if all(hasattr(volume, name) for name in ("GetSpacing", "GetOrigin", "GetDirection")):
        return _from_simpleitk(volume)
    if hasattr(volume, "affine") and hasattr(volume, "dataobj"):
        return _from_nibabel(volume)
    return _Source(volume)


def _from_xarray(volume: Any) -> _Source:
    dims = [str(dim) for dim in volume.dims]
    letters = {dim.lower(): dim for dim in dims}
    if set(letters) in ({"x", "y", "z"}, {"x", "y"}):
        volume = volume.transpose(*(letters[letter] for letter in "zyx" if letter in letters))
        dims = [str(dim) for dim in volume.dims]
    origin, spacing, units = [], [], []
    for dim in reversed(dims):
        unit, start, step = "", 0.0, 1.0
        if dim in volume.coords:
            coordinate = volume.coords[dim]
            unit = str(coordinate.attrs.get("units", ""))
            values = np.asarray(coordinate.values)
            if np.issubdtype(values.dtype, np.timedelta64):
                values, unit = values / np.timedelta64(1, "ms"), "ms"
            values = values.astype(float)
            start = float(values[0])
            if len(values) > 1:
                steps = np.diff(values)
                step = float(values[-1] - values[0]) / (len(values) - 1)
                if step == 0 or np.abs(steps - step).max() > 1e-3 * abs(step):
                    raise error(f"coordinate {dim}", "is not evenly spaced", "interpolate it, e.g. DataArray.interp")
        origin.append(start)
        spacing.append(step)
        units.append(unit)
    return _Source(volume.values, origin, np.diag(spacing), units)


def _from_pyvista(volume: Any) -> _Source:
    dimensions, spacing = np.array(volume.dimensions), np.array(volume.spacing, dtype=float)
    origin = np.array(volume.origin, dtype=float)
    direction = np.array(getattr(volume, "direction_matrix", np.eye(3)), dtype=float)
    values = volume.active_scalars
    if values is None:
        arrays = list(volume.point_data.values()) or list(volume.cell_data.values())
        if not arrays:
            raise error(NAME, "is ImageData without an array", "give it point data")
        values = arrays[0]
    values = np.asarray(values)
    axes = (direction * spacing).T
    if len(values) != dimensions.prod():
        # Cell data: samples are at the centres of cells.
        dimensions = np.maximum(dimensions - 1, 1)
        origin = origin + 0.5 * axes.sum(axis=0)
    return _Source(values.reshape(dimensions[::-1]), origin, axes)


def _from_vtk(volume: Any) -> _Source:
    from vtkmodules.util.numpy_support import vtk_to_numpy

    dimensions, extent = np.array(volume.GetDimensions()), np.array(volume.GetExtent())
    direction = volume.GetDirectionMatrix()
    direction = np.array([[direction.GetElement(row, column) for column in range(3)] for row in range(3)])
    axes = (direction * np.array(volume.GetSpacing())).T
    origin = np.array(volume.GetOrigin()) + extent[::2] @ axes
    for data, on_cells in ((volume.GetPointData(), False), (volume.GetCellData(), True)):
        if data.GetNumberOfArrays() == 0:
            continue
        values = data.GetScalars()
        if values is None:
            values = data.GetArray(0)
        if values.GetNumberOfComponents() != 1:
            raise error(NAME, f"has {values.GetNumberOfComponents()} components", "give one scalar per sample")
        if on_cells:
            # Samples are at the centres of cells.
            origin = origin + 0.5 * (dimensions > 1) @ axes
            dimensions = np.maximum(dimensions - 1, 1)
        return _Source(vtk_to_numpy(values).reshape(dimensions[::-1]), origin, axes)
    raise error(NAME, "is vtkImageData without an array", "give it point data")


def _from_simpleitk(volume: Any) -> _Source:
    array = sys.modules[type(volume).__module__.split(".")[0]].GetArrayFromImage(volume)
    count = volume.GetDimension()
    direction = np.array(volume.GetDirection()).reshape(count, count)
    axes = (direction * np.array(volume.GetSpacing())).T
    return _Source(array, volume.GetOrigin(), axes, ["mm"] * count)


def _from_nibabel(volume: Any) -> _Source:
    # In nibabel, x points to the right and y to the front; in atomesh and ITK, they point the other way.
    affine = np.diag([-1.0, -1.0, 1.0, 1.0]) @ np.asarray(volume.affine)
    array = np.asarray(volume.dataobj)
    while array.ndim > 3 and array.shape[-1] == 1:
        array = array[..., 0]
    unit = volume.header.get_xyzt_units()[0]
    units = [{"unknown": "", "meter": "m", "micron": "um"}.get(unit, unit)] * 3
    return _Source(array.T, affine[:3, 3], affine[:3, :3].T, units)
