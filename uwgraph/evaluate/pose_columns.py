"""The columns of a table, CSV or Parquet, that tell poses over time: found by their names and units, brought to SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from uwgraph.dive.logs.quantity import UNITS
from uwgraph.dive.logs.sinks import whole_ns
from uwgraph.dive.readers.csv_columns import column_like, time_of
from uwgraph.dive.readers.csv_text import Batch, batches, read_head
from uwgraph.dive.tables import Column, read_table
from uwgraph.errors import DataError
from uwgraph.evaluate.tum_file import MAX_BYTES
from uwgraph.time import from_text
from uwgraph.types import FloatArray, TimeArray

MAX_ROWS: Final = 10_000_000
"""Larger tables are refused: they are read into memory whole."""

_POSE: Final = r"(?:field_)?(?:pose_){0,2}"
_AT: Final = _POSE + r"(?:(?:t|p|pos|position|translation|location|p_rs_[rs])_?)?"
_TURNED: Final = _POSE + r"(?:q|quat|quaternion|orientation|rotation|q_rs)_?"
_P: Final = r"(?:(?:p|pos|position)_)?"
_NED: Final = {"n": "north", "e": "east", "d": "down"}
QUANTITIES: Final[Mapping[str, tuple[str, str, str]]] = {
    "lat": (r"lat|latitude", "angle", "deg"),
    "lon": (r"lon|lng|long|longitude", "angle", "deg"),
    "north": (_P + r"(?:n|north|northing)", "length", "m"),
    "east": (_P + r"(?:e|east|easting)", "length", "m"),
    "down": (_P + r"(?:d|down)|depth", "length", "m"),
    "up": (_P + r"up|height|ellipsoidal_height|alt|altitude", "length", "m"),
    "u": (r"u", "length", "m"),
    **{axis: (_AT + axis + r"(?:_position)?", "length", "m") for axis in "xyz"},
    **{f"q{axis}": (_TURNED + axis, "number", "1") for axis in "xyzw"},
    "roll": (r"roll", "angle", "deg"),
    "pitch": (r"pitch", "angle", "deg"),
    "heading": (r"heading|hdg|yaw", "angle", "deg"),
    **{f"v_{axis}": (rf"v_(?:{axis}|{word})", "speed", "m/s") for axis, word in _NED.items()},
    **{f"sigma_{name}": (rf"sigma_{name}", "length", "m") for name in _NED.values()},
    **{f"sigma_{name}": (rf"sigma_{name}", "angle", "deg") for name in ("roll", "pitch", "heading")},
    **{f"cov_{name}": (rf"cov_{name}", "length^2", "m^2") for name in ("north_east", "north_down", "east_down")},
}
"""The name of a column in lower case with underscores, its dimension, and the unit where none is stated."""


@dataclass(frozen=True, eq=False)
class PoseColumns:
    """The columns that are known, in SI."""

    t_ns: TimeArray
    """Shape (K,)."""
    found: Mapping[str, FloatArray]
    """By the names of :data:`QUANTITIES`, each of shape (K,)."""
    names: Mapping[str, str]
    """What they are called in the file."""

    @property
    def in_unstated_degrees(self) -> tuple[str, ...]:
        """The columns of roll, pitch and heading without a unit, which were taken as degrees."""
        angles = {key: name for key, name in self.names.items() if key in ("roll", "pitch", "heading")}
        return tuple(name for key, name in angles.items() if not column_like([name], QUANTITIES[key][0], "angle", ""))

    def stack(self, *names: str) -> FloatArray:
        """Columns beside each other, shape (K, n); NaN for those that are not there."""
        unknown = np.full(len(self.t_ns), np.nan)
        return np.column_stack([self.found.get(name, unknown) for name in names])

    def has(self, *names: str) -> bool:
        """Whether all of them are there."""
        return all(name in self.found for name in names)


def read_pose_columns(path: Path) -> PoseColumns:
    """The columns of a ``.parquet`` file, or of separated text with a header line.

    Raises
    ------
    DataError
        When the file is missing, empty, cut off, too large or malformed, or has no column of time.
    """
    return _parquet(path) if path.suffix == ".parquet" else _csv(path)


def _csv(path: Path) -> PoseColumns:
    head = read_head(path)
    if path.stat().st_size > MAX_BYTES:
        raise _too_large(path, f"{MAX_BYTES / 1e6:.0f} MB")
    if not head.first:
        raise DataError("has a header but no rows", where=str(path), remedy="export it again")
    time, unit_ns = _time(path, head.names, head.first)
    wanted = _wanted(head.names)
    caveats: list[str] = []
    parts: list[tuple[TimeArray, dict[str, FloatArray]]] = []
    for batch in batches(path, head, lambda done: None, caveats.append):
        rows = sum(len(t_ns) for t_ns, _ in parts)
        parts.append((_stamps(path, batch, time, unit_ns, rows), {name: batch[name] for name, _ in wanted.values()}))
    if caveats:
        raise DataError(
            "its last line is cut off",
            where=str(path),
            remedy="copy it again; if the last line is whole, end it with a newline",
        )
    table = {name: np.concatenate([part[name] for _, part in parts]) for name, _ in wanted.values()}
    return _in_si(np.concatenate([t_ns for t_ns, _ in parts]), table, wanted)


def _parquet(path: Path) -> PoseColumns:
    try:
        with pa.parquet.ParquetFile(path) as file:
            schema, rows = file.schema_arrow, file.metadata.num_rows
    except (pa.ArrowException, OSError, ValueError) as error:
        what = str(error).partition("\n")[0][:160]
        raise DataError(
            f"is not a whole Parquet file ({what})", where=str(path), remedy="copy or export it again"
        ) from error
    if rows > MAX_ROWS:
        raise _too_large(path, f"{MAX_ROWS} rows")
    kinds = {field.name: Column("int" if pa.types.is_integer(field.type) else "float") for field in schema}
    numbers = [field.name for field in schema if pa.types.is_integer(field.type) or pa.types.is_floating(field.type)]
    table = read_table(path, {name: kinds[name] for name in numbers}, ignore_others=True)
    time, unit_ns = _time(path, numbers, [str(table[name][0]) for name in numbers])
    return _in_si(whole_ns(table[time], unit_ns), table, _wanted(numbers))


def _too_large(path: Path, limit: str) -> DataError:
    return DataError(f"is larger than the limit of {limit}", where=str(path), remedy="thin it out, or cut it")


def _wanted(names: Sequence[str]) -> dict[str, tuple[str, float]]:
    """The column of each quantity that is there, and what brings it to SI."""
    wanted = {}
    for key, (pattern, dimension, default) in QUANTITIES.items():
        if found := column_like(names, pattern, dimension, default):
            wanted[key] = found[0], UNITS[dimension][found[1]]
    return wanted


def _time(path: Path, names: Sequence[str], first: Sequence[str]) -> tuple[str, int]:
    """The column of time, and its unit in nanoseconds."""
    written, _, _ = time_of(names, first)
    if not written:
        raise DataError(
            f"has no column of time among {', '.join(map(repr, names[:20]))}",
            where=str(path),
            remedy="name it time, t or timestamp, with its unit, as in 'time [s]'",
        )
    # the unit stands behind the name, where the name does not end in it already
    name, _, unit = written.rpartition(" [")
    return written if written in names else name, round(UNITS["time"][unit.rstrip("]")] * 1e9)


def _stamps(path: Path, batch: Batch, name: str, unit_ns: int, before: int) -> TimeArray:
    """Stamps to the last digit that is written, which a float of seconds would lose."""
    if batch[name].dtype.kind == "m" and "utc" not in name.lower():
        raise DataError(
            "the times have no zone",
            where=f"{path}: {name}",
            remedy="write 2022-06-08T09:00:00Z, or call the column utc",
        )
    if batch[name].dtype.kind in "mM":
        return whole_ns(batch[name], unit_ns)
    stamps = []
    for row, cell in enumerate(batch.text(name), start=before + 1):
        try:
            stamps.append(from_text(cell, unit_ns))
        except ValueError as error:
            raise DataError(
                f"row {row}: {error}", where=f"{path}: {name}", remedy="repair or remove the row"
            ) from error
    return np.array(stamps, dtype=np.int64)


def _in_si(t_ns: TimeArray, table: Mapping[str, Any], wanted: Mapping[str, tuple[str, float]]) -> PoseColumns:
    found = {key: np.asarray(table[name], dtype=np.float64) * scale for key, (name, scale) in wanted.items()}
    return PoseColumns(t_ns, found, {key: name for key, (name, _) in wanted.items()})
