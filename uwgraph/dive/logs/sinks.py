"""Growing columns: the numbers of a topic's messages, 8 bytes each, and their stamps as whole nanoseconds."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from operator import attrgetter
from typing import Any, Final

import numpy as np

from uwgraph.dive.logs.fields import Row, row_getter
from uwgraph.types import FloatArray, TimeArray

UNKNOWN_NS: Final = 0
"""Stands for a stamp that is none: outside of the years that are believed."""
_MAX_NS: Final = 1 << 62
_STAMPS: Final = (("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"))
"""How ROS 2, ROS 1 and others spell seconds and nanoseconds of ``header.stamp``."""


@dataclass(frozen=True, eq=False)
class Poured:
    """All messages of a topic, in file order."""

    log_ns: TimeArray
    """Stamps of the log, shape (N,)."""
    header_ns: TimeArray | None
    """Stamps inside the messages; None where they have none."""
    field_ns: TimeArray | None
    """The field of time that was asked for, ns from its epoch."""
    values: FloatArray
    """Shape (N, number of paths); NaN where a message has no number there."""
    zoneless: bool = False
    """The field of time is a time of day without a zone: its epoch says in which zone."""


class NumberSink:
    """The numbers at some paths of every message.

    Parameters
    ----------
    paths : sequence of str
        The fields.
    time_path : str, optional
        A field of time, kept in whole nanoseconds.
    time_scale : float
        What brings that field to seconds.
    """

    def __init__(self, paths: Sequence[str], time_path: str | None = None, time_scale: float = 1.0) -> None:
        self.paths = tuple(paths)
        self._time_path = time_path
        self._ns_per_unit = round(time_scale * 1e9)
        self._values, self._log, self._header, self._field = array("d"), array("q"), array("q"), array("q")
        self._row: Row | None = None
        self._stamp: Callable[[Any], Sequence[Any]] | None = None
        self._time: Row | None = None
        self._zoneless = False

    def __len__(self) -> int:
        return len(self._log)

    def add(self, t_ns: int, message: Any) -> None:
        if self._row is None:
            self._begin(message)
        row = self._row(message)  # type: ignore[misc]
        try:
            # whole first, since extend() would leave half a row behind
            self._values.extend(array("d", row))
        except (TypeError, ValueError, OverflowError):
            self._values.extend([_number(value) for value in row])
        self._log.append(_whole(t_ns, 1))
        if self._stamp is not None:
            seconds, rest = self._stamp(message)
            self._header.append(_whole(seconds, 1_000_000_000) + _whole(rest, 1))
        if self._time is not None:
            self._field.append(_whole(self._time(message)[0], self._ns_per_unit))

    def extend(self, t_ns: TimeArray, columns: Mapping[str, FloatArray]) -> None:
        rows = np.empty((len(t_ns), len(self.paths)))
        for index, path in enumerate(self.paths):
            rows[:, index] = columns[path]
        self._values.frombytes(rows.tobytes())
        self._log.frombytes(np.ascontiguousarray(t_ns, dtype=np.int64).tobytes())
        if self._time_path is not None:
            times = np.asarray(columns[self._time_path])
            self._zoneless |= times.dtype.kind == "m"
            self._field.frombytes(whole_ns(times, self._ns_per_unit).tobytes())

    def poured(self) -> Poured:
        """What has come in, handed over: the sink is empty after that."""
        values: FloatArray = np.frombuffer(self._values, dtype=np.float64).reshape(len(self), len(self.paths))
        poured = Poured(_stamps(self._log), _optional(self._header), _optional(self._field), values, self._zoneless)
        self._values, self._log, self._header, self._field = array("d"), array("q"), array("q"), array("q")
        return poured

    def _begin(self, message: Any) -> None:
        self._row = row_getter(self.paths, message) if self.paths else lambda message: ()
        self._stamp = _header_getter(message)
        if self._time_path is not None:
            self._time = row_getter([self._time_path], message)


def _header_getter(message: Any) -> Callable[[Any], Sequence[Any]] | None:
    """What reads seconds and nanoseconds of ``header.stamp`` of messages like this one, if they have it."""
    for seconds, rest in _STAMPS:
        paths = [f"header.stamp.{seconds}", f"header.stamp.{rest}"]
        getter = row_getter(paths, message)
        if None not in getter(message):
            return getter if isinstance(getter, attrgetter) else _padded(getter)
    return None


def _padded(getter: Row) -> Callable[[Any], Sequence[Any]]:
    return lambda message: [0 if value is None else value for value in getter(message)]


def _whole(value: Any, ns_per_unit: int) -> int:
    """Nanoseconds of a number of units, exact for whole numbers; UNKNOWN_NS for what is no time."""
    try:
        whole = int(value)
        # a float of seconds has no room for nanoseconds: its fraction is scaled alone
        part = 0 if isinstance(value, int | np.integer) else round((float(value) - whole) * ns_per_unit)
        ns = whole * ns_per_unit + part
    except (TypeError, ValueError, OverflowError):
        return UNKNOWN_NS
    return ns if -_MAX_NS < ns < _MAX_NS else UNKNOWN_NS


def whole_ns(column: Any, ns_per_unit: int) -> TimeArray:
    """Nanoseconds of a column of units, exact for whole numbers, or of times (datetime64, timedelta64)."""
    array = np.asarray(column)
    if array.dtype.kind in "mM":
        return np.ascontiguousarray(array.astype(f"{array.dtype.kind}8[ns]").view(np.int64))
    limit = _MAX_NS // max(abs(ns_per_unit), 1)
    good = np.isfinite(array) & (array > -limit) & (array < limit)
    safe = np.where(good, array, 0)
    ns: TimeArray = safe.astype(np.int64) * ns_per_unit
    if array.dtype.kind == "f":
        ns += np.rint((safe - np.trunc(safe)) * ns_per_unit).astype(np.int64)
    return np.where(good, ns, UNKNOWN_NS)


def _number(value: Any) -> float:
    """A number, also of a value that NumPy made or that is true or false; NaN for anything else."""
    if isinstance(value, str | bytes):
        return nan
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return nan
    return number if isfinite(number) else nan


def _stamps(values: array[int]) -> TimeArray:
    return np.frombuffer(values, dtype=np.int64)


def _optional(values: array[int]) -> TimeArray | None:
    return _stamps(values) if len(values) else None
