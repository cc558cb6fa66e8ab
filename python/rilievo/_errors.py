"""Exceptions, by the exit codes of the command line."""

from __future__ import annotations

from typing import Sequence


class Error(Exception):
    """A command failed; the base of all exceptions of this package.

    Attributes
    ----------
    exit_code : int
        What the command line ends with in this case: 1 and 101 are unexpected.
    problems : list of (str, str)
        Files that cannot be used, each with the reason; empty where the failure is about something else.
    """

    exit_code: int = 1
    problems: list[tuple[str, str]]

    def __init__(self, *args: object) -> None:
        super().__init__(*args)
        self.problems = []


class UsageError(Error):
    """What is asked for does not exist, or contradicts itself."""

    exit_code = 2


class InputError(Error, ValueError):
    """A file or an array cannot be used."""

    exit_code = 3


class InputTypeError(InputError, TypeError):
    """An array has a dtype, or an argument a type, that cannot be used."""


class DataError(Error):
    """The data do not allow a result: too few photos, no pose, no light."""

    exit_code = 4


class RunDirError(Error):
    """The run directory is in use, damaged, of another version, or lacks the result that is asked for."""

    exit_code = 5


class ReadWriteError(Error, OSError):
    """Reading or writing failed."""

    exit_code = 6


_BY_CODE = {cls.exit_code: cls for cls in (UsageError, InputError, DataError, RunDirError, ReadWriteError)}


def of_code(code: int, message: str, problems: Sequence[tuple[str, str]]) -> Error:
    """The exception of an exit code; called by the native part."""
    error = _BY_CODE.get(code, Error)(message)
    error.exit_code = code
    error.problems = list(problems)
    return error
