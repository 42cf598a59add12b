"""The stamps of a topic: which of its clocks, and the repair of what real logs do to them."""

from __future__ import annotations

from typing import Final

import numpy as np

from uwgraph.dive.logs.mapping import TopicMapping
from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.sinks import Poured
from uwgraph.dive.validate import EARLIEST_NS, LATEST_NS
from uwgraph.errors import DataError
from uwgraph.time import from_datetime, isoformat
from uwgraph.types import TimeArray

MAX_CLOCK_DIFFERENCE_S: Final = 3600.0
"""A header's clock further than this from the log's is not believed."""
TELL_DIFFERENCE_S: Final = 0.5
"""A difference between the two that people should know of."""
MAX_SHUFFLE_S: Final = 1.0
"""Messages this much out of order were overtaken on their way; beyond it, a clock was set."""
MAX_STAMPLESS: Final = 0.05
"""Share of messages without a believable stamp (before a clock was set for the first time) that are dropped."""


def stamps_of(poured: Poured, mapping: TopicMapping, where: str, notes: Notes) -> TimeArray:
    """The stamps that the mapping asks for, ns UTC, in file order.

    Raises
    ------
    DataError
        When it asks for a clock that the messages do not have.
    """
    if poured.field_ns is not None:
        if poured.zoneless and mapping.epoch is None:
            raise DataError(
                "the times have no zone",
                where=f"{where}: time",
                remedy="say in the mapping which it is, for UTC by 'epoch: 1970-01-01T00:00:00Z'",
            )
        epoch_ns = from_datetime(mapping.epoch) if mapping.epoch is not None else 0
        return poured.field_ns + epoch_ns
    if mapping.time == "log":
        return poured.log_ns
    if mapping.time == "header":
        if poured.header_ns is None:
            raise DataError("the messages have no header.stamp", where=f"{where}: time", remedy="set 'time: log'")
        return poured.header_ns
    return _plausible(poured.log_ns, poured.header_ns, where, notes)


def _plausible(log_ns: TimeArray, header_ns: TimeArray | None, where: str, notes: Notes) -> TimeArray:
    """The header's stamps, unless something speaks against them."""
    if header_ns is None or len(log_ns) == 0:
        return log_ns
    believable = _believable(header_ns)
    if believable.mean() < 1.0 - MAX_STAMPLESS:
        notes.caveats.append(f"{where}: the messages' own stamps are not set; stamped when they were logged")
        return log_ns
    if not _believable(log_ns).any():
        return header_ns
    difference_s = float(np.median((header_ns - log_ns)[believable])) * 1e-9
    if abs(difference_s) > MAX_CLOCK_DIFFERENCE_S:
        notes.caveats.append(
            f"{where}: the messages' own stamps are {_span(difference_s)} off the log's clock; "
            "stamped when they were logged ('time: header' in the mapping takes their own)"
        )
        return log_ns
    if _shuffle_s(header_ns[believable]) > MAX_SHUFFLE_S:
        notes.caveats.append(f"{where}: the messages' own stamps jump back; stamped when they were logged")
        return log_ns
    if abs(difference_s) > TELL_DIFFERENCE_S:
        notes.caveats.append(
            f"{where}: the messages' own stamps, which are taken, are {_span(difference_s)} off the log's clock: "
            "streams without stamps of their own are off by as much ('time: log' takes the log's)"
        )
    return header_ns


def in_order(t_ns: TimeArray, where: str, notes: Notes, *, shared: bool) -> TimeArray:
    """Which rows to take, in which order: stamps that cannot be are dropped, small shuffles sorted, doubles dropped.

    Parameters
    ----------
    t_ns : array
        Stamps in file order.
    where : str
        The stream, for notes and errors.
    shared : bool
        Two samples of the stream may share a stamp.

    Raises
    ------
    DataError
        When too many stamps are no time, or the clock was set back in the middle.
    """
    rows = np.flatnonzero(_believable(t_ns))
    if len(rows) < (1.0 - MAX_STAMPLESS) * len(t_ns):
        first = int(np.flatnonzero(~_believable(t_ns))[0])
        raise DataError(
            f"message {first + 1} has the stamp {t_ns[first]} ns, which is no time between 1990 and 2100",
            where=f"{where}: time",
            remedy="a clock that counts from its own start needs 'epoch:' in the mapping, as in 2022-06-08T09:00:00Z; "
            "check the unit of the field of time",
        )
    if len(rows) < len(t_ns):
        notes.conversions.append(f"{where}: {len(t_ns) - len(rows)} messages without a believable stamp dropped")
    rows = _sorted(t_ns, rows, where, notes)
    if not shared:
        double = np.flatnonzero(np.diff(t_ns[rows]) == 0) + 1
        if len(double):
            notes.conversions.append(f"{where}: {len(double)} messages with the stamp of the one before dropped")
            rows = np.delete(rows, double)
    return rows


def _sorted(t_ns: TimeArray, rows: TimeArray, where: str, notes: Notes) -> TimeArray:
    t = t_ns[rows]
    back = np.flatnonzero(np.diff(t) < 0)
    if len(back) == 0:
        return rows
    if _shuffle_s(t) > MAX_SHUFFLE_S:
        at = int(np.argmax(np.maximum.accumulate(t) - t > MAX_SHUFFLE_S * 1e9))
        raise DataError(
            f"the clock was set: {isoformat(int(np.max(t[:at])))} is followed by {isoformat(int(t[at]))} "
            f"in message {int(rows[at]) + 1} ({len(back)} steps back in all)",
            where=f"{where}: time",
            remedy="take another clock ('time: log' or 'time: header' in the mapping), or cut the log there",
        )
    notes.conversions.append(f"{where}: {len(back)} messages that were out of order (by less than a second) sorted")
    return rows[np.argsort(t, kind="stable")]


def _believable(t_ns: TimeArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return (t_ns > EARLIEST_NS) & (t_ns < LATEST_NS)


def _shuffle_s(t_ns: TimeArray) -> float:
    """How far a stamp lies behind an earlier one, at worst."""
    return float(np.max(np.maximum.accumulate(t_ns) - t_ns)) * 1e-9 if len(t_ns) else 0.0


def _span(seconds: float) -> str:
    size = abs(seconds)
    for unit, length in (("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if size >= 2.0 * length:
            return f"{seconds / length:+.1f} {unit}"
    return f"{seconds:+.2f} s"
