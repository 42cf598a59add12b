"""Our own dive folder."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from uwgraph.dive.folder import HEADER, read_dive
from uwgraph.dive.model import Dive

NAME: Final = "uwgraph"
EXPECTS: Final = f"a folder with {HEADER} and one .parquet or .csv file per stream"
CLOCKS_DIFFER: Final = False


def matches(path: Path) -> str:
    return f"it holds {HEADER}" if (path / HEADER).is_file() else ""


def read(path: Path) -> Dive:
    return read_dive(path)
