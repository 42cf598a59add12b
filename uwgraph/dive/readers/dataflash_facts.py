"""What a DataFlash log says about itself: units, instances, parameters, the date, the medium of each barometer."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.dive.folder import OriginSettings
from uwgraph.dive.readers.dataflash_blocks import Block, Format, Rows
from uwgraph.dive.readers.mavlink_messages import AIR, WATER
from uwgraph.types import FloatArray

KEPT: Final = ("FMTU", "UNIT", "MULT", "PARM", "ORGN", "GPS", "BARO", "XKF4", "NKF4")
"""Messages that describe others."""
KEPT_ROWS: Final = 20_000
"""About so many of each are looked at."""
WHOLE, NUMBER, TEXT = "iu", "iuf", "S"
"""Kinds of columns."""
_GPS_EPOCH_S: Final = 315_964_800
_GPS_LEAPS: Final = ((1_483_228_800, 18), (1_435_708_800, 17), (1_341_100_800, 16), (1_230_768_000, 15))
"""Seconds UTC from which on GPS time is ahead by so many seconds."""
_FIRST_WEEK, _LAST_WEEK, _WEEK_MS = 1000, 5000, 604_800_000
"""GPS weeks of the years 1999 to 2075."""
_PREFIXES: Final[Mapping[float, str]] = {1e-1: "d", 1e-2: "c", 1e-3: "m", 1e-6: "u", 1e-9: "n"}
_WATER_AIR: Final = 3e-3
"""m/Pa; a pascal is 1/9800 m of water and 1/12 m of air."""
_HAS_POSITION, _IS_HELD = 0x18, 0x80
"""Bits of a filter's status: a relative or absolute position; one that is only held."""


class Facts:
    """The messages that describe others, as far as they have been read."""

    def __init__(self) -> None:
        self._rows: dict[str, list[Rows]] = defaultdict(list)
        self._instances: dict[int, str] = {}
        """Column that tells the instance, by type of message."""

    def look_at(self, formats: Mapping[int, Format], block: Block) -> None:
        """Keep what describes others of a block of messages."""
        named = {formats[kind].name: kind for kind in block.offsets if formats[kind].name in KEPT}
        for name, kind in named.items():
            if sum(map(len, self._rows[name])) < KEPT_ROWS:
                self._rows[name].append(block.rows(kind, formats[kind]))
        if "FMTU" in named:
            for kind, units, _ in self._unit_ids():
                column = units.find("#")
                if kind in formats and 0 <= column < len(names := formats[kind].dtype.names or ()):
                    self._instances[kind] = names[column]

    def columns(self, message: str, **kinds: str) -> tuple[NDArray[Any], ...]:
        """Columns of a message that was kept, as they are in the file; empty ones where the log lacks one.

        ``kinds`` are their names, with the letters of NumPy's kinds that will do.
        """
        tables = [rows for rows in self._rows[message] if _has(rows.dtype, kinds)]
        if not tables:
            return tuple(np.zeros(0, dtype=np.int64) for _ in kinds)
        return tuple(np.concatenate([rows[name] for rows in tables]) for name in kinds)

    def instance_column(self, kind: int) -> str | None:
        """The column that tells instances of a type apart."""
        return self._instances.get(kind)

    def units(self, kind: int, this: Format) -> Mapping[str, str]:
        """Unit of each number of a type that the log states one for."""
        labels = _texts(*self.columns("UNIT", Id=WHOLE, Label=TEXT))
        scales = dict(zip(*(column.tolist() for column in self.columns("MULT", Id=WHOLE, Mult=NUMBER)), strict=True))
        stated: dict[str, str] = {}
        for of, units, scaled_by in self._unit_ids():
            if of != kind:
                continue
            for name, unit, scale in zip(this.dtype.names or (), units, scaled_by, strict=False):
                label = labels.get(ord(unit), "")
                prefix = "" if name in this.scaled else _PREFIXES.get(float(f"{scales.get(ord(scale), 1.0):.7g}"), "")
                if name in this.scales and label not in ("", "instance", "UNKNOWN"):
                    stated[name] = prefix + label
        return stated

    def parameters(self) -> Mapping[str, float]:
        """The vehicle's parameters, as they were last."""
        names, values = self.columns("PARM", Name=TEXT, Value=NUMBER)
        return {n.decode("latin-1"): v for n, v in zip(names.tolist(), values.tolist(), strict=True)}

    def start_ns(self) -> int | None:
        """UTC of the autopilot's start, from the GPS; None where it had no time."""
        week, ms, us = (c.astype(np.int64) for c in self.columns("GPS", GWk=WHOLE, GMS=WHOLE, TimeUS=WHOLE))
        good = (week > _FIRST_WEEK) & (week < _LAST_WEEK) & (ms >= 0) & (ms < _WEEK_MS) & (us >= 0) & (us < 1 << 53)
        if not good.any():
            return None
        gps_s = _GPS_EPOCH_S + week[good] * (_WEEK_MS // 1000)
        leap = next((leap for since, leap in _GPS_LEAPS if gps_s[0] >= since), 14)
        return int(np.median((gps_s - leap) * 1_000_000_000 + ms[good] * 1_000_000 - us[good] * 1000))

    def origin(self) -> OriginSettings | None:
        """Origin of the filter's local positions."""
        kind, lat, lon = self.columns("ORGN", Type=WHOLE, Lat=WHOLE, Lng=WHOLE)
        for k, a, b in zip(kind.tolist(), lat.tolist(), lon.tolist(), strict=True):
            if k == 0 and (a or b) and abs(a) <= 90e7 and abs(b) <= 180e7:
                return OriginSettings(lat_deg=a * 1e-7, lon_deg=b * 1e-7)
        return None

    def medium(self, instance: int | None) -> str:
        """What a barometer is in, from how its altitude follows its pressure; nothing where that cannot be told."""
        which, height, pressure = self.columns("BARO", I=WHOLE, Alt=NUMBER, Press=NUMBER)
        if instance is None:
            height, pressure = self.columns("BARO", Alt=NUMBER, Press=NUMBER)
        else:
            height, pressure = height[which == instance], pressure[which == instance]
        good = np.isfinite(height) & np.isfinite(pressure)
        spread = [_spread(column[good].astype(np.float64)) for column in (height, pressure)]
        if not all(spread):
            return ""
        return WATER if spread[0] / spread[1] < _WATER_AIR else AIR

    def knows_its_place(self) -> bool:
        """Whether the filter estimated a position most of the time."""
        status = np.concatenate([self.columns(name, SS=WHOLE)[0] for name in ("XKF4", "NKF4")]).astype(np.int64)
        known = ((status & _HAS_POSITION) > 0) & ((status & _IS_HELD) == 0)
        return bool(len(status)) and float(known.mean()) > 0.5

    def _unit_ids(self) -> list[tuple[int, str, str]]:
        """Type, letters of its units, letters of their multipliers."""
        kinds, units, scales = (c.tolist() for c in self.columns("FMTU", FmtType=WHOLE, UnitIds=TEXT, MultIds=TEXT))
        return [(int(k), _text(u), _text(s)) for k, u, s in zip(kinds, units, scales, strict=True)]


def _has(dtype: np.dtype[Any], kinds: Mapping[str, str]) -> bool:
    """Whether a table has columns of such kinds."""
    names = dtype.names or ()
    return all(name in names and dtype[name].kind in kinds[name] for name in kinds)


def _texts(keys: NDArray[Any], texts: NDArray[Any]) -> dict[int, str]:
    return {int(key): _text(text) for key, text in zip(keys.tolist(), texts.tolist(), strict=True)}


def _text(value: Any) -> str:
    return value.decode("latin-1") if isinstance(value, bytes) else ""


def _spread(x: FloatArray) -> float:
    return float(np.percentile(x, 95) - np.percentile(x, 5)) if len(x) > 20 else 0.0
