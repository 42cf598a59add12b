"""Where measurements are made, as far as their models need to know: the Earth there."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from uwgraph.frames import R_n_local, geodetic_from_ned, gravity_n
from uwgraph.graph.prepare import Prepared
from uwgraph.graph.track import Track
from uwgraph.types import FloatArray, TimeArray


@dataclass(frozen=True, eq=False)
class Place:
    """What the Earth is like at each of K moments along a track."""

    p_n: FloatArray
    """Shape (K, 3)."""
    R_nb: FloatArray
    """Shape (K, 3, 3)."""
    R_local: FloatArray
    """Axes of local north, east, down in n, shape (K, 3, 3)."""
    lat: FloatArray
    lon: FloatArray
    depth: FloatArray
    gravity_n: FloatArray

    def select(self, index: Any) -> Place:
        """The moments that a mask or an index array picks."""
        return Place(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def place_at(prepared: Prepared, t_ns: TimeArray, track: Track) -> Place:
    """The places of a track at some times."""
    p = track.position_at(t_ns)
    lat, lon, height = geodetic_from_ned(prepared.origin, p)
    R_local = R_n_local(prepared.origin, lat, lon)
    return Place(p, track.rotation_at(t_ns), R_local, lat, lon, -height, gravity_n(prepared.origin, p))
