"""A part of a log: from and to, as instants or as seconds from its start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.samples import Samples
from uwgraph.dive.validate import MAX_IMU_GAP_S
from uwgraph.errors import DataError
from uwgraph.time import NS, isoformat
from uwgraph.types import TimeArray

MS: Final = 1_000_000


@dataclass(frozen=True)
class Window:
    """What to take; None: from the start, to the end.

    Whole numbers are nanoseconds UTC, floats seconds from the first IMU sample (from the first of all without an IMU).
    """

    first: int | float | None = None
    last: int | float | None = None

    def cut(self, streams: Mapping[str, Samples], notes: Notes) -> dict[str, Samples]:
        """The streams within; those that have no sample there are left out."""
        if self.first is None and self.last is None:
            return dict(streams)
        starts = {name: int(samples.t_ns[0]) for name, samples in streams.items()}
        start = starts.get("imu", min(starts.values()))
        first = _instant(self.first, start, min(starts.values()))
        last = _instant(self.last, start, max(int(samples.t_ns[-1]) for samples in streams.values()))
        inside = {name: s.take((s.t_ns >= first) & (s.t_ns <= last)) for name, s in streams.items()}
        kept = {name: samples for name, samples in inside.items() if len(samples)}
        if not kept:
            raise DataError(
                f"holds nothing from {isoformat(first)} to {isoformat(last)}",
                where="log",
                remedy=f"it starts at {isoformat(start)}",
            )
        notes.conversions.append(f"taken from {isoformat(first)} to {isoformat(last)}")
        notes.caveats.extend(f"{name}: nothing in that part" for name in streams if name not in kept)
        return kept


def refuse_gaps(t_ns: TimeArray) -> None:
    """Raise DataError where the IMU fell silent for too long, naming the longest part without such a gap."""
    gaps = np.flatnonzero(np.diff(t_ns) > MAX_IMU_GAP_S * NS)
    if len(gaps) == 0:
        return
    firsts, lasts = np.append(0, gaps + 1), np.append(gaps, len(t_ns) - 1)
    longest = int(np.argmax(t_ns[lasts] - t_ns[firsts]))
    # rounded outwards to what a command line keeps of a time
    first = int(t_ns[firsts[longest]]) // MS * MS
    last = -(-int(t_ns[lasts[longest]]) // MS) * MS
    worst = int(gaps[np.argmax(np.diff(t_ns)[gaps])])
    raise DataError(
        f"no IMU sample for {(t_ns[worst + 1] - t_ns[worst]) / NS:.1f} s after {isoformat(int(t_ns[worst]))} "
        f"({len(gaps)} such gaps)",
        where="imu",
        remedy="nothing carries the attitude across: import a part. The longest without a gap has "
        f"{(last - first) / NS:.0f} s: --from {isoformat(first)} --to {isoformat(last)}",
    )


def _instant(wanted: int | float | None, start_ns: int, otherwise_ns: int) -> int:
    if wanted is None:
        return otherwise_ns
    return wanted if isinstance(wanted, int) else start_ns + round(wanted * NS)
