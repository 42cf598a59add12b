"""ArduPilot's onboard logs, ``.BIN`` (DataFlash): a file of messages that describes itself.

Stamps are microseconds since the autopilot's start. UTC comes from the GPS; where there was none, stamps count from
:data:`NOMINAL_START`, and the log's caveats say so.

Source: ArduPilot's AP_Logger and its list of onboard log messages. The decoding is our own: pymavlink's reader keeps
an object for every message of the file, and goes through all of them one by one to find the time. The tests hold the
two equal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from uwgraph.dive.logs.log import NOWHEN, Known, Progress, Proposal, Sink, Topic
from uwgraph.dive.readers.dataflash_blocks import HEADER, Block, Blocks, Format, Rows
from uwgraph.dive.readers.dataflash_facts import Facts
from uwgraph.dive.readers.mavlink_messages import DATAFLASH, PLACED, autopilot_rig, north_of, proposals_from
from uwgraph.errors import DataError
from uwgraph.time import from_datetime, isoformat
from uwgraph.types import FloatArray, TimeArray

NAME: Final = "dataflash"
EXPECTS: Final = "a .BIN file, the onboard log of an ArduSub vehicle"
CLOCKS_DIFFER: Final = False

NOMINAL_START: Final = from_datetime(NOWHEN)
"""The autopilot's start where the log does not know the date."""
MAX_KINDS: Final = 1000
"""Kinds of messages times instances; more are no log."""
_LATEST_NS: Final = 10**16
"""A stamp of four months since the start is damaged."""
_STAMPS: Final[Mapping[str, int]] = {"TimeUS": 1000, "TimeMS": 1_000_000}
"""First columns that are stamps, and their nanoseconds."""
_RATIOS: Final[Mapping[str, Mapping[str, tuple[str, str]]]] = {
    "VISO": {f"Vel{axis}": (f"PosD{axis}", "dt") for axis in "XYZ"}
}
"""Columns that are ratios of two others, by message."""
DEFINITIONS: Final = ("FMTU", "UNIT", "MULT", "PARM", "FILE")
"""Messages that are no measurements."""
Kind = tuple[int, int | None]
"""Type of a message and its instance."""


def matches(path: Path) -> str:
    if path.suffix.lower() != ".bin" or not path.is_file():
        return ""
    with path.open("rb") as file:
        return "it begins with a DataFlash message" if file.read(2) == HEADER else ""


@contextmanager
def open_log(path: Path) -> Iterator[DataFlashLog]:
    """The log, after one pass over the file; raises DataError where it holds no message."""
    if not path.is_file() or not path.stat().st_size:
        raise DataError("is no file, or empty", where=str(path), remedy=f"give {EXPECTS}")
    with path.open("rb") as file:
        yield DataFlashLog(path, Blocks(file, path.stat().st_size))


def proposals(topic: Topic) -> tuple[Proposal, ...]:
    return proposals_from(DATAFLASH, topic)


class DataFlashLog:
    """An open log."""

    def __init__(self, path: Path, blocks: Blocks) -> None:
        self._path = path
        self._blocks = blocks
        self._facts = Facts()
        self._counts: Counter[Kind] = Counter()
        for block in blocks:
            self._count(block)
        if not self._counts:
            lost = f"; {blocks.lost} bytes from byte {blocks.first_lost} on are none" if blocks.lost else ""
            raise DataError(f"holds no messages with stamps{lost}", where=str(path), remedy="copy the log again")
        start = self._facts.start_ns()
        self._start_ns = NOMINAL_START if start is None else start
        self._has_date = start is not None
        self._lost = blocks.lost, blocks.first_lost

    @property
    def topics(self) -> tuple[Topic, ...]:
        return tuple(sorted((self._topic(*counted) for counted in self._counts.items()), key=lambda topic: topic.name))

    @property
    def known(self) -> Known:
        return Known(autopilot_rig(self._facts.parameters()), self._facts.origin())

    @property
    def caveats(self) -> tuple[str, ...]:
        lost, at = self._lost
        size = self._blocks.size
        told = []
        if lost:
            told.append(
                f"{lost} of {size} bytes, from byte {at} on, are no messages and were skipped: cut off, or damaged"
            )
        if not self._has_date:
            told.append(
                "the log does not know the date: its stamps count from "
                f"{isoformat(NOMINAL_START)[:10]}, the autopilot's start; for the true one map time: 'TimeUS [us]' and "
                "epoch in every stream"
            )
        return tuple(told)

    def pour(self, sinks: Mapping[str, tuple[Sink, ...]], progress: Progress) -> None:
        """Give the messages of each topic to its sinks, a block at a time."""
        wanted = {kind for kind, instance in self._counts if self._name(kind, instance) in sinks}
        for block in self._blocks:
            for kind in wanted & block.offsets.keys():
                this = self._blocks.formats[kind]
                rows = block.rows(kind, this)
                rows = rows[_boot_ns(rows) < _LATEST_NS]
                for instance, some in self._split(kind, rows):
                    columns, t_ns = _Columns(this, some), self._start_ns + _boot_ns(some)
                    for sink in sinks.get(self._name(kind, instance), ()):
                        sink.extend(t_ns, columns)
            progress(block.share)

    def _count(self, block: Block) -> None:
        """Count the messages with a stamp, by type and instance."""
        formats = self._blocks.formats
        self._facts.look_at(formats, block)
        for kind, offsets in block.offsets.items():
            if formats[kind].name in DEFINITIONS or not _is_stamped(formats[kind]):
                continue
            column = self._instance_column(kind)
            if column is None:
                self._counts[kind, None] += len(offsets)
            else:
                instances, counts = np.unique(block.column(kind, formats[kind], column), return_counts=True)
                self._counts.update(dict(zip([(kind, i) for i in instances.tolist()], counts.tolist(), strict=True)))
        if len(self._counts) > MAX_KINDS:
            raise DataError(
                f"has more than {MAX_KINDS} kinds of messages", where=str(self._path), remedy="the file is damaged"
            )

    def _split(self, kind: int, rows: Rows) -> Iterator[tuple[int | None, Rows]]:
        """The messages of each instance of a type."""
        column = self._instance_column(kind)
        if column is None:
            yield None, rows
            return
        for instance in np.unique(rows[column]).tolist():
            yield instance, rows[rows[column] == instance]

    def _instance_column(self, kind: int) -> str | None:
        """The column of whole numbers that tells instances apart, if there is one."""
        column = self._facts.instance_column(kind)
        return column if column in self._blocks.formats[kind].whole else None

    def _name(self, kind: int, instance: int | None) -> str:
        name = self._blocks.formats[kind].name
        return name if instance is None else f"{name}[{instance}]"

    def _topic(self, which: Kind, count: int) -> Topic:
        kind, instance = which
        this = self._blocks.formats[kind]
        fields = (*this.scales, *_ratios(this))
        units = self._facts.units(kind, this)
        return Topic(self._name(*which), this.name, count, fields, units=units, says=self._says(this.name, instance))

    def _says(self, name: str, instance: int | None) -> str:
        match name:
            case "BARO":
                return self._facts.medium(instance)
            case "ATT":
                return north_of(self._facts.parameters())
            case "XKF1" | "NKF1":
                return PLACED if self._facts.origin() and self._facts.knows_its_place() else ""
        return ""


class _Columns(Mapping[str, FloatArray]):
    """Columns of messages in the units of their format, made when they are asked for."""

    def __init__(self, this: Format, rows: Rows) -> None:
        self._format = this
        self._rows = rows
        self._ratios = _ratios(this)

    def __getitem__(self, name: str) -> FloatArray:
        with np.errstate(invalid="ignore", over="ignore"):  # of damaged numbers
            if name in self._ratios:
                above, below = (self[part] for part in self._ratios[name])
                ratio: FloatArray = np.divide(above, below, out=np.full(len(above), np.nan), where=below > 0)
                return ratio
            values: FloatArray = self._rows[name].astype(np.float64) * self._format.scales[name]
            return values

    def __iter__(self) -> Iterator[str]:
        return iter((*self._format.scales, *self._ratios))

    def __len__(self) -> int:
        return len(self._format.scales) + len(self._ratios)


def _is_stamped(this: Format) -> bool:
    first = (this.dtype.names or ("",))[0]
    return first in _STAMPS and first in this.whole


def _ratios(this: Format) -> Mapping[str, tuple[str, str]]:
    """The ratios whose parts the message has in this version."""
    known = _RATIOS.get(this.name, {}).items()
    return {name: parts for name, parts in known if set(parts) <= this.scales.keys() and name not in this.scales}


def _boot_ns(rows: Rows) -> TimeArray:
    """Nanoseconds since the autopilot's start; a stamp that is out of range comes out as the latest possible."""
    name = (rows.dtype.names or ("",))[0]
    unit = _STAMPS[name]
    ns: TimeArray = np.minimum(rows[name], _LATEST_NS // unit).astype(np.int64) * unit
    return ns
