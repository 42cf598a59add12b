"""The clock of a vehicle against that of the ground station that received its messages.

Messages carry milliseconds since the vehicle's start, and the log the time of receipt. The link only ever delays: the
vehicle's clock is the line that touches the differences (received - since start) from below, least far away on the
whole (Moon, Skelly & Towsley, INFOCOM 1999). A vehicle that restarts begins another line.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.optimize import linprog

MAX_RATE: Final = 3e-4
"""Of one clock against the other."""
BACK_US: Final = 10_000_000
"""A stamp this far behind an earlier one is of another start; less are messages that were late."""
MAX_STARTS: Final = 50
"""More, and the source's stamps are of several clocks: they are not used."""
MIN_SPAN_US: Final = 5_000_000
"""Shorter stretches have no clock of their own."""
TOO_LATE_US: Final = 60_000_000
TOO_EARLY_US: Final = 500_000
"""A stamp so long before, or after, its receipt is no time of the vehicle's clock."""
_CELL_US: Final = 2_000_000


@dataclass
class Stretch:
    """From one start of a vehicle to the next."""

    at: int
    """Byte of the file where it begins."""
    latest_us: int
    earliest_us: int
    least: dict[int, tuple[int, int]] = field(default_factory=dict)
    """For every cell of time the message with the least delay: since start, and received minus that, in us."""
    line: tuple[float, float, float] | None = None
    """Offset [us] at a time [us], that time, and rate."""


class Clock:
    """The clock of one source of messages."""

    def __init__(self) -> None:
        self._stretches: list[Stretch] = []

    @property
    def starts(self) -> int:
        """How many stretches have a clock."""
        return sum(stretch.line is not None for stretch in self._stretches)

    def see(self, at: int, received_us: int, boot_us: int) -> None:
        """A message's own stamp and its receipt."""
        if boot_us <= 0 or len(self._stretches) > MAX_STARTS:
            return
        if not self._stretches or boot_us < self._stretches[-1].latest_us - BACK_US:
            self._stretches.append(Stretch(at, boot_us, boot_us))
        stretch = self._stretches[-1]
        stretch.latest_us = max(stretch.latest_us, boot_us)
        cell, offset = boot_us // _CELL_US, received_us - boot_us
        held = stretch.least.get(cell)
        if held is None or offset < held[1]:
            stretch.least[cell] = (boot_us, offset)

    def settle(self) -> None:
        """Draw the lines, when all messages have been seen."""
        if len(self._stretches) > MAX_STARTS:
            self._stretches = []
        for stretch in self._stretches:
            if stretch.latest_us - stretch.earliest_us >= MIN_SPAN_US:
                stretch.line = _line_below(np.array(list(stretch.least.values()), dtype=np.float64))
            stretch.least.clear()

    def utc_us(self, at: int, received_us: int, boot_us: int) -> int:
        """UTC of a message: by the vehicle's clock where it has one, else when it was received."""
        index = bisect_right(self._stretches, at, key=lambda stretch: stretch.at) - 1
        line = self._stretches[index].line if index >= 0 else None
        if line is None:
            return received_us
        offset, middle, rate = line
        utc_us = boot_us + round(offset + rate * (boot_us - middle))
        return utc_us if -TOO_LATE_US < utc_us - received_us < TOO_EARLY_US else received_us


def _line_below(points: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> tuple[float, float, float] | None:
    """Offset, its time, and rate of the line under (time, offset) that is least far below them."""
    middle, least = float(points[:, 0].mean()), float(points[:, 1].min())
    x, y = (points[:, 0] - middle) * 1e-6, points[:, 1] - least
    A = np.column_stack([np.ones(len(x)), x])
    bounds = [(None, None), (-MAX_RATE * 1e6, MAX_RATE * 1e6)]
    found = linprog(-A.sum(axis=0), A_ub=A, b_ub=y, bounds=bounds)
    if not found.success:
        return None
    return least + float(found.x[0]), middle, float(found.x[1]) * 1e-6
