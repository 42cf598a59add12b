"""What the columns of a table are, by their names and units: conservative, since a name is all there is."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from uwgraph.dive.logs.log import NOWHEN, Proposal, Topic
from uwgraph.dive.logs.mapping import (
    AltitudeMapping,
    DepthMapping,
    DvlMapping,
    FixesMapping,
    HeadingMapping,
    ImuMapping,
    ReferenceMapping,
    StreamMapping,
)
from uwgraph.dive.logs.quantity import UNITS
from uwgraph.dive.validate import EARLIEST_NS, LATEST_NS

_SPELLINGS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("m/s2", "m/s**2", "m/s/s", "m s^-2", "m s-2", "ms^-2", "mps2", "m_s2"), "m/s^2"),
    **dict.fromkeys(("rad s^-1", "rad s-1", "rad/sec", "rps", "rad_s", "rads"), "rad/s"),
    **dict.fromkeys(("deg s^-1", "deg/sec", "dps", "°/s", "degree/s", "degrees/s", "deg_s"), "deg/s"),
    **dict.fromkeys(("m s^-1", "m s-1", "mps", "ms^-1", "m_s"), "m/s"),
    **dict.fromkeys(("degree", "degrees", "°", "deg."), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("sec", "seconds", "second"), "s"),
    **dict.fromkeys(("millibar", "mb"), "mbar"),
    **dict.fromkeys(("μs", "µs", "usec"), "us"),
    **dict.fromkeys(("msec",), "ms"),
    **dict.fromkeys(("nsec",), "ns"),
    **{unit.lower(): unit for units in UNITS.values() for unit in units if unit.lower() not in ("mg", "g", "mgal")},
    "g": "g",
    "mg": "mg",
}
"""How people write units, in lower case, and how we do."""

_BRACKETS: Final = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]\s*")
_PREFIX: Final = re.compile(r"^(imu|raw|sensor|gps|gnss|nav|vehicle|auv|rov)_(?=.)")
_TIME: Final = re.compile(r"#?(t|time|timestamp|time_stamp|stamp|utc|datetime|date_time|unix|unix_time|epoch|time_utc)")
_AXES: Final = (("f", r"(f|a|acc|accel|acceleration|linear_acceleration|specific_force)_?", "acceleration"),
                ("w", r"(w|g|gyr|gyro|omega|angular_velocity|angular_rate)_?", "rate"),
                ("v", r"(v|vel|velocity|dvl|dvl_v|dvl_vel|dvl_velocity)_?", "speed"))  # fmt: skip
_SINGLE: Final = {
    "lat": (r"lat|latitude", "angle", "deg"),
    "lon": (r"lon|lng|long|longitude", "angle", "deg"),
    "roll": (r"roll", "angle", "deg"),
    "pitch": (r"pitch", "angle", "deg"),
    "yaw": (r"yaw|heading|hdg", "angle", "deg"),
    "heading": (r"heading|hdg|compass|compass_heading|mag_heading|magnetic_heading", "angle", "deg"),
    "depth": (r"depth|water_depth_of_vehicle", "length", "m"),
    "altitude": (r"dvl_altitude|altimeter|height_above_(?:bottom|sea_?floor|ground)|range_to_bottom", "length", "m"),
    "pressure": (r"pressure|press|abs_pressure|absolute_pressure", "pressure", ""),
}
"""Name, dimension, and the unit where none is stated (none: then it is not taken)."""


@dataclass(frozen=True)
class Table(Topic):
    """A table, with the column that tells the time."""

    time: str = ""
    """As the mapping writes it; empty where no column looks like time."""
    epoch: datetime | None = None
    relative: bool = False
    """The stamps count from the start of the log."""


def stated_unit(column: str) -> str:
    """The unit in brackets in a column's name, as it is written; empty if there is none."""
    found = _BRACKETS.fullmatch(column)
    return found["unit"].strip() if found else ""


def time_of(names: Sequence[str], first: Sequence[str]) -> tuple[str, datetime | None, bool]:
    """Which column is the time, from when it counts, and whether that is only the log's own start."""
    for name, cell in zip(names, first, strict=False):
        for stem, unit in _readings(name):
            if not _TIME.fullmatch(stem):
                continue
            if re.match(r"\d{4}[-/]\d\d[-/]\d\d", cell):
                zone = datetime(1970, 1, 1, tzinfo=UTC) if "utc" in name.lower() else None
                return _written(name, "s"), None if re.search(r"(Z|[+-]\d\d:?\d\d)$", cell) else zone, False
            if (ours := _unit(unit, "time") if unit else _unit_by_size(cell)) is not None:
                absolute = _absolute(cell, ours)
                return _written(name, ours), None if absolute else NOWHEN, not absolute
    return "", None, False


def proposals_of(table: Table) -> tuple[Proposal, ...]:
    """What the table could become; nothing without a column of time."""
    if not table.time:
        return ()
    found = _found(table.fields)
    common: dict[str, Any] = {"topic": table.name, "time": table.time, "epoch": table.epoch}
    note = "time of day not known: stamps count from the log's start, put at 2000-01-01" if table.relative else ""
    return tuple(
        Proposal(stream, mapping, note="; ".join(filter(None, (extra, note))))
        for stream, mapping, extra in _streams(found, common)
    )


def _streams(found: Mapping[str, Any], common: Mapping[str, Any]) -> Iterator[tuple[str, StreamMapping, str]]:
    if "f" in found and "w" in found:
        yield "imu", ImuMapping(**common, f=found["f"], w=found["w"]), "axes taken as frd"
    if "v" in found:
        yield "dvl", DvlMapping(**common, v=found["v"]), "velocity taken as over the bottom, in the DVL's axes, frd"
    for name in ("depth", "pressure"):
        if name in found:
            yield "depth", DepthMapping(**common, **{name: found[name]}), ""
            break
    if "altitude" in found:
        yield "altitude", AltitudeMapping(**common, altitude=found["altitude"]), ""
    place = {name: found[name] for name in ("lat", "lon") if name in found}
    attitude = [found[name] for name in ("roll", "pitch", "yaw") if name in found]
    if len(place) == 2 and len(attitude) == 3:
        yield "reference", ReferenceMapping(**common, **place, rph=tuple(attitude)), "position and attitude together"
        return
    if len(place) == 2:
        yield "fixes", FixesMapping(**common, **place), ""
    if "heading" in found:
        yield "heading", HeadingMapping(**common, heading=found["heading"]), "taken as magnetic"


def _found(columns: Sequence[str]) -> dict[str, Any]:
    """Quantities, as a mapping writes them, of the columns that are known by name."""
    found: dict[str, Any] = {}
    for key, stem, dimension in _AXES:
        three = [_first(columns, f"{stem}{axis}", dimension, next(iter(UNITS[dimension]))) for axis in "xyz"]
        if all(three):
            found[key] = tuple(three)
    for key, (stem, dimension, default) in _SINGLE.items():
        if column := _first(columns, stem, dimension, default):
            found[key] = column
    return found


def _first(columns: Sequence[str], pattern: str, dimension: str, default: str) -> str | None:
    found = column_like(columns, pattern, dimension, default)
    return _written(*found) if found else None


def column_like(columns: Sequence[str], pattern: str, dimension: str, default: str) -> tuple[str, str] | None:
    """The first column whose name, in lower case with underscores, matches, and its unit (or the default one)."""
    for column in columns:
        for stem, unit in _readings(column):
            if re.fullmatch(pattern, stem) and (ours := _unit(unit or default, dimension)):
                return column, ours
    return None


def _readings(column: str) -> Iterator[tuple[str, str]]:
    """Name and unit of a column: the unit in brackets, or else at the end of the name, or not stated."""
    found = _BRACKETS.fullmatch(column)
    name, unit = (found["name"], found["unit"].strip()) if found else (column, "")
    snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name.strip().lstrip("#"))
    stem = _PREFIX.sub("", re.sub(r"[^a-z0-9]+", "_", snake.lower()).strip("_"))
    yield stem, unit
    if not unit:
        for length in (1, 2):
            head, tail = "_".join(stem.split("_")[:-length]), "_".join(stem.split("_")[-length:])
            if head and tail in _SPELLINGS:
                yield head, tail


def _unit(unit: str, dimension: str) -> str | None:
    ours = _SPELLINGS.get(unit.lower().replace("²", "^2"), unit)
    return ours if ours in UNITS[dimension] else None


def _unit_by_size(cell: str) -> str | None:
    """The unit in which a number is a time between 1990 and 2100; seconds where there is none."""
    return next((unit for unit in ("s", "ms", "us", "ns") if _absolute(cell, unit)), "s" if _is_number(cell) else None)


def _absolute(cell: str, unit: str) -> bool:
    return _is_number(cell) and EARLIEST_NS <= float(cell) * UNITS["time"][unit] * 1e9 <= LATEST_NS


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _written(column: str, unit: str) -> str:
    """The column as a mapping names it: a unit of ours in its name stands for itself."""
    return column if re.search(rf"\s\[{re.escape(unit)}\]$", column) else f"{column} [{unit}]"
