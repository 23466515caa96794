"""The exceptions of atomesh: each is an `Error`, and also the standard exception that fits it.

`except atomesh.Error` catches all of them; `except ValueError`, `except FileNotFoundError` and so on catch those of
one kind. An error has the attributes `place`, `problem`, `remedy` and `kind`; its text is the first three in one line.
"""

from __future__ import annotations

import errno

from ._native import Error as Error


class ArgumentError(Error, TypeError):
    """An argument is unknown or missing, or has a wrong type."""


class InvalidValueError(Error, ValueError):
    """A value is impossible, or a file or an image holds impossible values."""


class MissingItemError(Error, KeyError, IndexError):
    """A surface or a cell does not exist."""

    def __str__(self) -> str:
        # KeyError shows the quoted message.
        return str(self.args[0])


class FileError(Error, OSError):
    """A file cannot be read or written."""

    def __str__(self) -> str:
        return str(self.args[0])

    @property
    def filename(self) -> str:
        """The name of the file, as an OSError has it."""
        return self.place


class MissingFileError(FileError, FileNotFoundError):
    """A file or a folder does not exist."""

    errno = errno.ENOENT


class FailureError(Error, RuntimeError):
    """The work failed although the arguments are possible."""


class MeshWarning(UserWarning):
    """The verdict on a mesh is not good: what is wrong, and what helps."""
