"""Errors of the package."""

from __future__ import annotations

from typing import Any


class LoopboostError(Exception):
    """Any error of loopboost."""


class ArgumentError(LoopboostError, ValueError):
    """An argument, a command line or a pipeline file is wrong."""


class InputError(LoopboostError):
    """A file or a scan cannot be read or used. The message names it, what was expected, and what to do."""


class CommandError(LoopboostError):
    """A command failed. `exit_code` is its exit code, and `log` the lines that it wrote to stderr."""

    def __init__(self, message: str, exit_code: int, log: list[str]):
        super().__init__(message)
        self.exit_code = exit_code
        self.log = log

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.exit_code, self.log)
