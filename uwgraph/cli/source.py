"""The dive that a command line names: one of our folders, or any recording that a reader knows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from uwgraph.cli.console import note

if TYPE_CHECKING:
    from uwgraph.dive import Dive


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
