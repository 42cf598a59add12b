"""The dive that a command line names: one of our folders, or any recording that a reader knows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from uwgraph.cli.console import Progress, note
from uwgraph.errors import ConfigError

if TYPE_CHECKING:
    from uwgraph.dive import Dive
    from uwgraph.export import Track

Along = Literal["solution", "reference"]


def load_dive(path: Path, *, validate: bool = True) -> Dive:
    """Read the dive, and say what was guessed where it is not one of our folders.

    ``validate=False`` reads a bad dive folder as well, so that it can be looked at.
    """
    from uwgraph.dive.folder import HEADER, read_dive
    from uwgraph.dive.importing import read_recording

    if (path / HEADER).exists():
        return read_dive(path, validate=validate)
    found = read_recording(path)
    note(f"{path}: read as {found.reader.NAME}: {found.reason}")
    return found.dive


def load_track(dive: Dive, solution: Path | None, along: Along, progress: Progress) -> Track:
    """The way of a dive: of the solution in a folder, of one made now, or of the dive's reference."""
    from uwgraph.export import read_result, track_of_reference, track_of_solution
    from uwgraph.graph import smooth

    if along == "reference":
        if solution is not None:
            raise ConfigError("a solution is of no use along the reference", where="--along", remedy="leave one out")
        return track_of_reference(dive)
    if solution is not None:
        return read_result(solution)
    return track_of_solution(smooth(dive, progress=progress))
