"""Errors meant for people: what was found, where, and what to do about it."""

from __future__ import annotations

from typing import Final

EXIT_INTERNAL: Final = 1
EXIT_USAGE: Final = 2
EXIT_DATA: Final = 3
EXIT_SOLVE: Final = 4
EXIT_INTERRUPTED: Final = 130
"""What the commands exit with; ``uwgraph.cli.console`` maps the errors to them."""


class UwgraphError(Exception):
    """Base of every error that uwgraph raises on purpose.

    Parameters
    ----------
    problem : str
        What is wrong, in one sentence.
    where : str, optional
        The file, and the field or column in it.
    remedy : str, optional
        What the reader can do about it.
    """

    def __init__(self, problem: str, *, where: str = "", remedy: str = "") -> None:
        self.problem = problem
        self.where = where
        self.remedy = remedy
        text = f"{where}: {problem}" if where else problem
        super().__init__(f"{text}\n  remedy: {remedy}" if remedy else text)


class DataError(UwgraphError):
    """A file, a stream or a column that cannot be used as it is."""


class ConfigError(UwgraphError):
    """A setting, a rig or a command line that cannot be used as it is."""


class InitialisationError(UwgraphError):
    """The dive does not tell where it starts or which way it points."""


class SolveError(UwgraphError):
    """The graph has no unique solution, or the solver did not reach it."""
