"""Suns with headings, as geolocation takes them: from a table, or from a dive."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from uwgraph.dive.folder import HEADER, read_dive
from uwgraph.dive.model import Dive
from uwgraph.dive.vertical import vertical
from uwgraph.errors import DataError
from uwgraph.sun.ephemeris import sun_axes
from uwgraph.sun.information import rank2
from uwgraph.sun.observation import SunFlag, SunObservation
from uwgraph.time import from_datetime
from uwgraph.types import FloatArray

MAX_BYTES: Final = 50_000_000
SIGMA_DEG: Final = 1.0
"""1-sigma of a sun of a table that does not say."""


def read_sights(source: Path) -> tuple[list[SunObservation], FloatArray]:
    """Observations and the heading of the bow at each [rad], of a dive folder or a CSV.

    The CSV has ``utc`` (ISO 8601 with a zone), ``azimuth_deg`` (clockwise from north, by whatever heading there was),
    ``elevation_deg``, and ``sigma_deg`` if known.

    Raises
    ------
    DataError
        Naming the file, the column and the row.
    """
    if (source / HEADER).exists():
        return sights_of_dive(read_dive(source))
    return _sights_of_table(source)


def sights_of_dive(dive: Dive) -> tuple[list[SunObservation], FloatArray]:
    """The dive's sun stream, with the heading of its compass."""
    if dive.sun is None:
        raise DataError("the dive has no sun stream", where="sun", remedy="make one with 'uwgraph sun process'")
    sun = dive.sun
    up_b = vertical(dive, sun.t_ns + dive.rig.sun.time_offset_ns).up_b
    observations = [
        SunObservation(int(t), s, L, cov, str(method), float(quality), SunFlag(int(flags)), up)
        for t, s, L, cov, method, quality, flags, up in zip(
            sun.t_ns, sun.s_b, sun.information_b, sun.cov_b, sun.method, sun.quality, sun.flags, up_b, strict=True
        )
    ]
    if dive.heading is None:
        raise DataError(
            "the dive has no heading stream",
            where="heading",
            remedy="a compass is needed to tell where the sun's azimuth counts from; magnetic with --declination-deg",
        )
    turns = np.unwrap(dive.heading.heading)
    return observations, np.interp(sun.t_ns, dive.heading.t_ns + dive.rig.heading.time_offset_ns, turns)


def _sights_of_table(path: Path) -> tuple[list[SunObservation], FloatArray]:
    where = str(path)
    if not path.is_file():
        raise DataError("there is no such dive or table", where=where, remedy="name a dive folder or a CSV")
    if path.stat().st_size > MAX_BYTES:
        raise DataError(f"is larger than {MAX_BYTES} bytes", where=where, remedy="is this the right file?")
    try:
        table = pd.read_csv(path)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        raise DataError(f"is no table ({str(error)[:100]})", where=where, remedy="write a CSV with a header") from error
    t_ns = [
        _stamp(value, f"{where}: utc, row {row}") for row, value in enumerate(_column(table, "utc", where), start=1)
    ]
    azimuth, elevation = (np.radians(_numbers(table, name, where)) for name in ("azimuth_deg", "elevation_deg"))
    known = "sigma_deg" in table
    sigma = np.radians(_numbers(table, "sigma_deg", where) if known else np.full(len(table), SIGMA_DEG))
    if (sigma <= 0.0).any() or (np.abs(elevation) > np.pi / 2.0).any():
        raise DataError(
            "sigmas must be above 0 and elevations within 90 degrees",
            where=f"{where}: sigma_deg, elevation_deg",
            remedy="correct the table",
        )
    suns = [_level_sun(t, A, h, s) for t, A, h, s in zip(t_ns, azimuth, elevation, sigma, strict=True)]
    return suns, np.zeros(len(suns))


def _level_sun(t_ns: int, azimuth: float, elevation: float, sigma: float) -> SunObservation:
    """A sun seen from a level body whose bow points north."""
    s, across, upward = sun_axes(azimuth, elevation)
    information, cov = rank2(np.stack([across, upward], axis=1), sigma**2 * np.eye(2))
    return SunObservation(t_ns, s, information, cov, "table", 1.0)


def _column(table: pd.DataFrame, name: str, where: str) -> Any:
    if name not in table:
        raise DataError(f"has no column {name!r}", where=where, remedy="utc, azimuth_deg and elevation_deg are needed")
    return table[name]


def _numbers(table: pd.DataFrame, name: str, where: str) -> FloatArray:
    values: FloatArray = pd.to_numeric(_column(table, name, where), errors="coerce").to_numpy(np.float64)
    if not np.isfinite(values).all():
        row = int(np.argmin(np.isfinite(values))) + 1
        raise DataError(f"row {row} is no number", where=f"{where}: {name}", remedy="correct it, or take the row out")
    return values


def _stamp(value: object, where: str) -> int:
    try:
        return from_datetime(datetime.fromisoformat(str(value)))
    except ValueError as error:
        raise DataError(f"{value!r} is no time", where=where, remedy="write 2022-06-08T09:00:00Z") from error
    except DataError as error:
        raise DataError(error.problem, where=where, remedy=error.remedy) from error
