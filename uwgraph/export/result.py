"""The output folder of ``uwgraph smooth``, read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from uwgraph.dive.tables import Column, read_table
from uwgraph.dive.validate import validate_stream
from uwgraph.errors import DataError
from uwgraph.export.track import COLUMNS, Track, track_of_table
from uwgraph.frames import ned_from_geodetic, origin_from
from uwgraph.types import Origin, Reference, stream_fields

STATES: Final = "solution.parquet"
"""What makes a folder a result."""

_AGREE_M: Final = 1e-3
"""m, how well n and the ellipsoid agree in a file that nobody has changed."""
_LIMIT: Final = 1e9
"""In SI units; nothing that moves is so far, so fast or so uncertain."""


def is_result(folder: Path) -> bool:
    """Whether ``folder`` is an output folder of ``uwgraph smooth``."""
    return (folder / STATES).is_file()


def read_result(path: str | Path) -> Track:
    """The trajectory of an output folder, with biases, 1-sigma and origin.

    The folder does not state the origin: it follows from a place that is known in n and on the ellipsoid.

    Raises
    ------
    DataError
        When the folder is no result, or its table is cut off, or holds what cannot be.
    """
    folder = Path(path)
    if not is_result(folder):
        raise DataError(
            f"is no result: there is no {STATES}", where=str(folder), remedy="name a folder that 'uwgraph smooth' wrote"
        )
    file = folder / STATES
    columns = {name: Column(field.kind) for field in COLUMNS.values() for name in field.columns}
    table = read_table(file, columns, ignore_others=True)
    track = track_of_table(table, Origin(0.0, 0.0), "solution")
    _check(file, track)
    origin = origin_from(float(track.lat[0]), float(track.lon[0]), float(track.height[0]), track.p_n[0])
    apart = np.linalg.norm(ned_from_geodetic(origin, track.lat, track.lon, track.height) - track.p_n, axis=1)
    if apart.max() > _AGREE_M:
        raise DataError(
            f"row {int(apart.argmax()) + 1}: north, east, down and lat_deg, lon_deg, height are two places "
            f"{apart.max():.3g} m apart",
            where=str(file),
            remedy="smooth the dive again",
        )
    return replace(track, origin=origin)


def _check(file: Path, track: Track) -> None:
    """Stamps, angles and places as of a reference; states known and, like their 1-sigma, of sane size."""
    states = Reference(track.t_ns, track.lat, track.lon, track.height, track.rph, track.v_n)
    validate_stream("reference", states, str(file))
    for name, array in stream_fields(track):
        may_be_unknown = name.startswith(("sigma", "cov"))
        good = (np.abs(array) < _LIMIT) | (np.isnan(array) & may_be_unknown)
        bad = ~good.reshape(len(track), -1).all(axis=1)
        if name != "t_ns" and bad.any():
            raise DataError(
                f"row {int(bad.argmax()) + 1} holds what is no state of a vehicle",
                where=f"{file}: {', '.join(COLUMNS[name].columns)}",
                remedy="smooth the dive again",
            )
