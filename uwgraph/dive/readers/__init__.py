"""Log formats, one file each, of two kinds.

A :class:`Reader` knows what its files mean, and turns a recording into a :class:`~uwgraph.dive.Dive` in our
conventions. A :class:`~uwgraph.dive.logs.log.LogReader` opens a log of topics, which a mapping makes a dive of. Either
way the dive's provenance tells where it came from (``source``, ``format``), what was converted (``conversions``) and
what the user must know (``caveats``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, Protocol, TypeAlias

from uwgraph.dive.logs.log import LogReader
from uwgraph.dive.model import Dive
from uwgraph.dive.readers import csvfile, dataflash, euroc, mcapfile, native, rosbag, snapir, tlog
from uwgraph.errors import ConfigError, DataError


class Reader(Protocol):
    """What the module of a format offers."""

    NAME: str
    """Short name, for the command line."""
    EXPECTS: str
    """The files that the format consists of, in one line."""
    CLOCKS_DIFFER: bool
    """Whether the sensors of such recordings kept clocks of their own, to be aligned on import."""

    def matches(self, path: Path) -> str:
        """Why the recording looks like this format; empty if it does not."""

    def read(self, path: Path) -> Dive:
        """The dive; raises DataError or ConfigError when the recording cannot be used."""


AnyReader: TypeAlias = Reader | LogReader

READERS: Final[Sequence[AnyReader]] = (native, snapir, euroc, rosbag, mcapfile, dataflash, tlog, csvfile)
"""In the order in which they are asked: the last takes any table, so it is taken when no other fits."""


def reader_named(name: str) -> AnyReader:
    """The reader of a format; raises :class:`ConfigError` when there is none of that name."""
    for reader in READERS:
        if name == reader.NAME:
            return reader
    known = ", ".join(reader.NAME for reader in READERS)
    raise ConfigError(f"unknown format {name!r}", where="format", remedy=f"known formats: {known}")


def guess_reader(path: Path) -> tuple[AnyReader, str]:
    """The reader that a recording looks made for, and why.

    Raises
    ------
    DataError
        When no format fits, listing what each expects, or when several do.
    """
    if not path.exists():
        raise DataError("there is no such file or folder", where=str(path), remedy="check the name")
    found = [(reader, reason) for reader in READERS if (reason := reader.matches(path))]
    if len(found) > 1 and found[-1][0] is READERS[-1]:
        found.pop()
    if len(found) == 1:
        return found[0]
    if found:
        names = " and ".join(reader.NAME for reader, _ in found)
        raise DataError(f"looks like {names}", where=str(path), remedy="name the format")
    expected = "".join(f"\n    {reader.NAME}: {reader.EXPECTS}" for reader in READERS)
    raise DataError("looks like none of the known formats", where=str(path), remedy=f"name a recording:{expected}")
