"""Writes package/atomesh/_options.pyi, the types of the verbs' options, from the declarations of the command line.

With --check, it only checks that the file is up to date.
"""

import sys
import textwrap
from pathlib import Path

from atomesh._call import argument, verbs

FILE = Path(__file__).parent / "package" / "atomesh" / "_options.pyi"

#: Options that are named parameters of the functions.
NAMED = {
    "mesh": {"spacing", "origin"},
    "export": {"to", "output"},
    "flow": {"source", "sink"},
    "paint": {"seed", "image"},
    "segment": {"object", "background"},
    "edit": {"add", "move", "remove"},
    "columns": {"horizon"},
}

HEAD = '''"""The options of every verb, as `stubs.py` writes them: what the command line declares."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias, TypedDict

import numpy as np
import numpy.typing as npt

from ._image import Image

_Path: TypeAlias = str | os.PathLike[str]
_Number: TypeAlias = float | np.floating[Any] | np.integer[Any]
#: Words, numbers, points (x, y, z), pairs of numbers (a range), boxes of two points, files, and arrays or images in
#: place of files.
_Value: TypeAlias = (
    str | os.PathLike[str] | _Number | Sequence[_Number] | Sequence[Sequence[_Number]] | npt.NDArray[Any] | Image
)
#: One value or several. A dict holds pairs; what is requested of a label is a dict of its own.
_Values: TypeAlias = _Value | Sequence[_Value] | Mapping[Any, _Value | Mapping[str, _Value]]
'''


def kind(option: dict[str, object]) -> str:
    """Returns the type of an option."""
    if option["flag"]:
        return "bool"
    if option["repeated"]:
        return "_Values"
    if option["choices"]:
        return "Literal[" + ", ".join(f'"{choice}"' for choice in option["choices"]) + "]"
    return {"number": "_Number", "whole": "int", "path": "_Path", "text": "_Value"}[option["type"]]


def stub_text() -> str:
    """Returns the content of the file."""
    parts = [HEAD]
    for verb, described in verbs().items():
        lines = [f"class {verb.capitalize()}Options(TypedDict, total=False):"]
        omitted = NAMED.get(verb, set()) | {"output", "quiet", "json", "threads", "print-config"}
        for option in described["options"]:
            if option["name"] in omitted:
                continue
            help = " ".join((option["help"] or "").split())
            lines += [f"    #: {line}" for line in textwrap.wrap(help, 92)]
            lines.append(f"    {argument(option['name'])}: {kind(option)} | None")
        if len(lines) == 1:
            continue
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def main() -> None:
    if "--check" in sys.argv:
        if FILE.read_text() != stub_text():
            sys.exit(f"{FILE} is not up to date; run {Path(__file__).name}")
    else:
        FILE.write_text(stub_text())


if __name__ == "__main__":
    main()
