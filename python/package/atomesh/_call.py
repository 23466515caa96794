"""Translates a Python call to a verb with its options, and its results back."""

from __future__ import annotations

import difflib
import functools
import json
import keyword
import logging
import math
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from . import _native
from ._errors import ArgumentError, Error, InvalidValueError, MeshWarning

if TYPE_CHECKING:
    from types import FrameType

    Progress = Union[bool, Callable[[str, float], object]]

log = logging.getLogger("atomesh")

#: Options whose images verbs read by name, so that they need not be files.
IMAGES_IN_MEMORY = {
    "beta", "distance-from", "horizon", "labels", "permeability", "porosity", "property", "region", "velocity",
}


def error(place: str, problem: str, remedy: str, kind: type[Error] = InvalidValueError) -> Error:
    """Returns the exception of a kind with this place, problem and remedy."""
    exception = kind(f"{place}: {problem}; {remedy}")
    exception.place, exception.problem, exception.remedy, exception.kind = place, problem, remedy, "Usage"
    return exception


@functools.lru_cache(maxsize=1)
def verbs() -> dict[str, Any]:
    """Returns the descriptions of all verbs and their options."""
    described: dict[str, Any] = json.loads(_native.describe())
    return described


@functools.lru_cache(maxsize=None)
def options_of(verb: str) -> dict[str, dict[str, Any]]:
    """Returns the options of a verb by their names as keyword arguments."""
    return {argument(option["name"]): option for option in verbs()[verb]["options"]}


def argument(name: str) -> str:
    """Returns an option's name as a keyword argument. A keyword such as `lambda` gets an underscore at its end."""
    name = name.replace("-", "_")
    return f"{name}_" if keyword.iskeyword(name) else name


class Answer:
    """The messages and results of a verb."""

    def __init__(self, results: dict[str, Any], images: Mapping[str, _native.Image]) -> None:
        #: Images in memory that options named.
        self.images = images
        self.text: str = results["text"]
        self.report: dict[str, Any] = json.loads(results["json"]) or {}
        self.notes: list[str] = results["notes"]
        self.interrupted: bool = results["interrupted"]
        self.kept: dict[str, Any] = results["kept"]


def call(
    verb: str,
    arguments: Iterable[str | os.PathLike[str]],
    options: Mapping[str, Any],
    objects: Mapping[str, Any] | None = None,
    progress: Progress = False,
    threads: int | None = None,
) -> Answer:
    """Runs a verb.

    Parameters
    ----------
    verb
        The name of the verb.
    arguments
        Its positional arguments.
    options
        Its options by their names as keyword arguments. An output with a name such as `<mesh>.vtu` is returned and
        not written to a file.
    objects
        Meshes and images in memory, by the names under which the arguments refer to them.
    progress
        True to show the progress, or a callable that receives the name of the stage and the fraction of it that is
        done.
    threads
        Number of threads; by default all processors.

    Returns
    -------
    Answer
        The messages and results of the verb.

    Raises
    ------
    ArgumentError
        If there is no such option, or if its value has a type that it cannot have.
    """
    known = options_of(verb)
    values: dict[str, Any] = {}
    with _Inputs(verb) as inputs, _ProgressDisplay(progress) as display:
        for name, value in options.items():
            option = known.get(name)
            if option is None:
                close = difflib.get_close_matches(name, known, 1)
                remedy = f"did you mean {close[0]}=?" if close else f"give one of {', '.join(known)}"
                raise error(f"{verb}()", f"has no option {name}", remedy, ArgumentError)
            if value is not None and value is not False:
                values[option["name"]] = inputs.values(option, value)
        paths = [_path(path) for path in arguments]
        images = {**(objects or {}), **inputs.images}
        results = _native.run(verb, paths, values, images, display, threads)
        return Answer(results, inputs.images)


def _path(path: Any) -> str:
    try:
        return os.fsdecode(path)
    except TypeError:
        problem = f"is of type {type(path).__name__}"
        raise error(f"{path!r:.40}", problem, "give the path of a file", ArgumentError) from None


class _Inputs:
    """The options of a call as plain values, with their images and temporary files."""

    def __init__(self, verb: str) -> None:
        self._verb = verb
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._file_count = 0
        #: Images in memory by the names that stand for them.
        self.images: dict[str, _native.Image] = {}

    def __enter__(self) -> _Inputs:
        return self

    def __exit__(self, *_: object) -> None:
        if self._folder is not None:
            self._folder.cleanup()

    def values(self, option: Mapping[str, Any], value: Any) -> Any:
        """Returns the value of an option, or a list of its values if it may be repeated."""
        if option["flag"]:
            return True
        if not option["repeated"]:
            return self._value(option, value)
        if isinstance(value, Mapping):
            return [[self._value(option, name), self._value(option, item)] for name, item in value.items()]
        if isinstance(value, (list, tuple)) and not _is_point(value) and not _is_rows(option, value):
            return [self._value(option, item) for item in value]
        if isinstance(value, np.ndarray) and value.ndim == 2 and not _is_table(option):
            return [self._value(option, item) for item in value]
        return [self._value(option, value)]

    def _value(self, option: Mapping[str, Any], value: Any) -> Any:
        """Returns a value made of texts, numbers, lists and dicts.

        An array or an image becomes the name that stands for it.
        """
        if isinstance(value, np.generic) or isinstance(value, np.ndarray) and value.ndim == 0:
            value = value.item()
        if isinstance(value, float):
            if not math.isfinite(value):
                return repr(value)
            return int(value) if value.is_integer() and abs(value) < 1e15 else value
        if isinstance(value, str):
            return _number(value) if option["type"] in ("number", "whole") else value
        if isinstance(value, int):
            return value
        if isinstance(value, os.PathLike):
            return os.fsdecode(value)
        if isinstance(value, np.ndarray) and _is_table(option) or _is_rows(option, value):
            return self._input(option, np.atleast_2d(np.asarray(value, dtype=float)))
        if isinstance(value, Mapping) and option["repeated"]:
            return {str(name): self._value(option, item) for name, item in value.items()}
        if isinstance(value, (list, tuple)) or isinstance(value, np.ndarray) and value.ndim == 1:
            return [self._value(option, item) for item in value]
        return self._input(option, value)

    def _input(self, option: Mapping[str, Any], value: Any) -> str:
        """Returns the name that stands for an array or an image, or the path of a file that holds it."""
        keyword = argument(option["name"])
        if option["type"] not in ("text", "path") or not _is_image(value):
            problem = f"is of type {type(value).__name__}"
            remedy = f"atomesh.options({self._verb!r})[{keyword!r}] tells what it can be"
            raise error(f"{keyword}=", problem, remedy, ArgumentError)
        if _is_table(option):
            path = self._new_path("csv")
            np.savetxt(path, np.asarray(value, dtype=float), delimiter=",", fmt="%.17g")
            return str(path)
        if isinstance(value, np.ndarray) and value.ndim == 4:
            path = self._new_path("npy")
            np.save(path, value.astype(np.float32))
            return str(path)
        from ._image import Image

        try:
            image = Image.of(value)
        except Error as problem_of_image:
            problem, remedy = problem_of_image.problem, problem_of_image.remedy
            raise error(f"{keyword}=", problem, remedy, type(problem_of_image)) from None
        if option["name"] in IMAGES_IN_MEMORY:
            count = len(self.images)
            name = f"<{keyword} {count + 1}>" if f"<{keyword}>" in self.images else f"<{keyword}>"
            self.images[name] = image._native
            return name
        path = self._new_path("vti")
        image.save(path)
        return str(path)

    def _new_path(self, ending: str) -> Path:
        """Returns the path of a new temporary file."""
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="atomesh-")
        self._file_count += 1
        return Path(self._folder.name) / f"{self._file_count}.{ending}"


def _number(text: str) -> int | float | str:
    """Returns the number that a text is, or the text if it is none."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def _is_point(value: Any) -> bool:
    """Returns True if these are the coordinates of one point."""
    return all(isinstance(c, (int, float, np.number)) for c in value)


def _is_table(option: Mapping[str, Any]) -> bool:
    """Returns True if the option takes a file of comma-separated values."""
    return "csv" in (option["value"] or "")


def _is_rows(option: Mapping[str, Any], value: Any) -> bool:
    """Returns True if these are the rows of a table of numbers, and the option takes one."""
    if not _is_table(option) or not isinstance(value, (list, tuple)):
        return False
    return len(value) > 0 and all(isinstance(row, (list, tuple)) and _is_point(row) for row in value)


def _is_image(value: Any) -> bool:
    """Returns True for arrays, and for objects that hold an image or behave as arrays."""
    if isinstance(value, (str, bytes, int, float, np.number, list, tuple, Mapping, os.PathLike)):
        return False
    if isinstance(value, np.ndarray):
        return value.ndim > 1
    if any(hasattr(value, name) for name in ("samples", "GetSpacing", "dataobj", "point_data")):
        return True
    array = np.asarray(value)
    return array.ndim > 1 and array.dtype != object


def _caller_level() -> int:
    """Returns the `stacklevel` at which a warning of the calling function names the user's own line."""
    package = str(Path(__file__).parent)
    frame: FrameType | None = sys._getframe(1)
    level = 1
    while frame is not None and frame.f_code.co_filename.startswith(package):
        frame, level = frame.f_back, level + 1
    return level


def warn_of_issue(verdict: Mapping[str, Any] | None) -> None:
    """Warns of the issue of a mesh if the verdict of its report is not good."""
    if verdict is None or verdict["grade"] == "good":
        return
    issue = f": {verdict['issue']}" if verdict["issue"] else ""
    text = f"the mesh is {verdict['grade']}{issue}; fit for {verdict['fit_for']}"
    # An option has the form "--metric shape --distance 4", or "--distance, smaller".
    pairs = [part.partition(" ") for part in (verdict["option"] or "").removeprefix("--").split(" --")]
    keywords = [f"{name.replace('-', '_')}={value!r}" for name, _, value in pairs if value and not name.endswith(",")]
    if keywords:
        text += f". Try {', '.join(keywords)}: {verdict['suggestion']}"
    elif verdict["suggestion"]:
        text += f". What helps: {verdict['suggestion']}"
    warnings.warn(text, MeshWarning, stacklevel=_caller_level())


class _ProgressDisplay:
    """Shows the progress of a verb: as a bar of tqdm, as lines, or through a callable."""

    def __init__(self, progress: Progress) -> None:
        self._callable = progress if callable(progress) else None
        self._bar: Any = None
        self._stage = ""
        self._lines = progress is True
        if progress is True:
            try:
                # Without ipywidgets, tqdm warns in notebooks and shows a bar of text.
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    from tqdm.auto import tqdm
            except ImportError:
                return
            self._bar = tqdm(total=100, bar_format="{desc} {percentage:3.0f}%|{bar}| {elapsed}{postfix}")

    def __enter__(self) -> _ProgressDisplay:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, kind: str, fraction: float, text: str) -> None:
        if kind == "note":
            log.info(text)
            if text.startswith("WARNING: "):
                warnings.warn(text.removeprefix("WARNING: "), UserWarning, stacklevel=_caller_level())
            return
        if kind == "stage":
            self._stage = text
        if self._callable is not None:
            self._callable(self._stage, fraction)
        elif self._bar is not None:
            self._bar.set_description_str(self._stage, refresh=False)
            self._bar.n = round(100 * fraction)
            self._bar.set_postfix_str(text if kind == "progress" else "", refresh=True)
        elif self._lines and kind == "stage":
            print(f"{text} ...", file=sys.stderr)
