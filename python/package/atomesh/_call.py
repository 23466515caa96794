"""Translates a Python call to a verb of the command line, and its results back."""

from __future__ import annotations

import difflib
import functools
import json
import keyword
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from . import _native
from ._native import Error

if TYPE_CHECKING:
    Progress = Union[bool, Callable[[str, float], object]]

log = logging.getLogger("atomesh")


def error(place: str, problem: str, remedy: str) -> Error:
    """Returns the exception with this place, problem and remedy."""
    exception = Error(f"{place}: {problem}; {remedy}")
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

    def __init__(self, results: dict[str, Any]) -> None:
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
    keep: Iterable[str] = (),
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
        Its options by their names as keyword arguments.
    objects
        Meshes and images in memory, by the names under which the arguments refer to them.
    keep
        Names of outputs that are returned and not written to files.
    progress
        True to show the progress, or a callable that receives the name of the stage and the fraction of it that is
        done.
    threads
        Number of threads; by default all processors.

    Returns
    -------
    Answer
        The messages and results of the verb.
    """
    known = options_of(verb)
    words = [verb]
    with tempfile.TemporaryDirectory(prefix="atomesh-") as folder, _ProgressDisplay(progress) as display:
        for name, value in options.items():
            option = known.get(name)
            if option is None:
                close = difflib.get_close_matches(name, known, 1)
                remedy = f"did you mean {close[0]}=?" if close else f"give one of {', '.join(known)}"
                raise error(f"{verb}()", f"has no option {name}", remedy)
            words += _words(option, value, Path(folder))
        words.append("--")
        words += [os.fspath(path) for path in arguments]
        return Answer(_native.run(words, dict(objects or {}), list(keep), display, threads))


def _words(option: Mapping[str, Any], value: Any, folder: Path) -> list[str]:
    """Returns an option in the syntax of the command line."""
    name = f"--{option['name']}"
    if value is None or value is False:
        return []
    if option["flag"]:
        return [name]
    values = [value]
    if option["repeated"]:
        if isinstance(value, Mapping):
            # The separator is a colon in X,Y,Z[:RATE], N:X,Y,Z and [NAME=]X,Y,Z:VALUE, but = in SIDE=P.
            separator = ":" if ":" in (option["value"] or ":") else "="
            values = [f"{_text(a)}{separator}{_text(b)}" for a, b in value.items()]
        elif isinstance(value, (list, tuple)) and not _is_point(value):
            values = list(value)
        elif isinstance(value, np.ndarray) and value.ndim == 2 and "csv" not in (option["value"] or ""):
            values = list(value)
    number = len(list(folder.iterdir()))
    return [
        f"{name}={_text(_in_file(option, item, folder, number + i))}" for i, item in enumerate(values)
    ]


def _is_point(value: Any) -> bool:
    """Returns True if these are the coordinates of one point."""
    return all(isinstance(c, (int, float, np.number)) for c in value)


def _in_file(option: Mapping[str, Any], value: Any, folder: Path, number: int) -> Any:
    """Writes an array or an image to a file and returns its path; returns any other value as it is."""
    if isinstance(value, (str, os.PathLike, bool, int, float, np.number, tuple, list)):
        return value
    if "csv" in (option["value"] or ""):
        path = folder / f"{number}.csv"
        np.savetxt(path, np.atleast_2d(np.asarray(value, dtype=float)), delimiter=",", fmt="%.17g")
        return path
    if isinstance(value, np.ndarray) and value.ndim == 4:
        path = folder / f"{number}.npy"
        np.save(path, value.astype(np.float32))
        return path
    if isinstance(value, np.ndarray) and value.ndim <= 1:
        return value
    from ._image import Image

    path = folder / f"{number}.vti"
    Image.of(value).save(path)
    return path


def _text(value: Any) -> str:
    """Returns a value in the syntax of the command line: a point is X,Y,Z, a box X,Y,Z:X,Y,Z."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, (list, tuple, np.ndarray)):
        parts = list(value)
        separator = "," if _is_point(parts) or any(isinstance(p, str) for p in parts) else ":"
        return separator.join(_text(part) for part in parts)
    if isinstance(value, float):
        return repr(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)


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
                warnings.warn(text.removeprefix("WARNING: "), UserWarning, stacklevel=5)
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
