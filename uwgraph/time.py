"""Time is int64 nanoseconds UTC; naive datetimes are refused."""

from __future__ import annotations

from datetime import UTC, datetime
from decimal import Decimal

import numpy as np
from numpy.typing import ArrayLike

from uwgraph.errors import DataError
from uwgraph.types import TimeArray

NS = 1_000_000_000


def from_datetime(when: datetime) -> int:
    """Nanoseconds UTC of an aware datetime.

    Raises
    ------
    DataError
        When ``when`` has no time zone: a guess would move the sun by 15 degrees an hour.
    """
    if when.tzinfo is None:
        raise DataError(
            f"the time {when.isoformat()} has no time zone",
            remedy="write it in UTC, as in 2022-06-08T09:00:00Z",
        )
    delta = when.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    return (delta.days * 86_400 + delta.seconds) * NS + delta.microseconds * 1000


def from_seconds(seconds: ArrayLike, start_ns: int = 0) -> TimeArray:
    """Nanoseconds of seconds counted from ``start_ns``, rounded to the nearest nanosecond."""
    whole, part = np.divmod(np.asarray(seconds, dtype=np.float64), 1.0)
    ns: TimeArray = start_ns + whole.astype(np.int64) * NS + np.rint(part * NS).astype(np.int64)
    return ns


def from_text(text: str, unit_ns: int = NS) -> int:
    """Nanoseconds of a decimal number of units (of ``unit_ns`` nanoseconds) as it is written, to the last digit.

    Raises
    ------
    ValueError
        When it is no number, or too large for int64 nanoseconds.
    """
    try:
        # Decimal takes underscores between digits, as Python's source does
        ns = (Decimal(text.replace("_", "?")) * unit_ns).to_integral_value()
        # before int(), which takes for ever on 1e999999999
        if abs(ns) < 1 << 62:
            return int(ns)
    except ArithmeticError:
        pass
    raise ValueError(f"{text[:40]!r} is no time")


def isoformat(t_ns: int) -> str:
    """The instant as ISO 8601 in UTC, to the nanosecond."""
    seconds, rest = divmod(int(t_ns), NS)
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S") + f".{rest:09d}Z"
