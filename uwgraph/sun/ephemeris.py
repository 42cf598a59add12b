"""Where the sun is: the apparent place (parallax and refraction in a standard atmosphere included) or the geometric.

NREL's Solar Position Algorithm (Reda & Andreas 2004) through pvlib, good to 0.0003 deg. It works without a network.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from uwgraph.frames import R_n_local
from uwgraph.types import FloatArray, Origin

_TT_MINUS_UT1_S: Final = 69.2  # valid for 2016 to 2030 within 0.5 s, that is 6e-6 deg of the sun's path
_PRESSURE_HPA: Final = 1013.25
_TEMPERATURE_C: Final = 12.0
_REFRACTION_AT_HORIZON_DEG: Final = 0.5667


def sun_azimuth_elevation(
    t_ns: ArrayLike, lat: ArrayLike, lon: ArrayLike, *, refraction: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Azimuth clockwise from true north and elevation of the apparent sun [rad], shape (N,).

    Parameters
    ----------
    t_ns : array_like of int64, shape (N,)
        Nanoseconds UTC.
    lat, lon : array_like, shape (N,) or scalar
        Geodetic latitude and longitude, rad.
    refraction : bool
        Whether the air lifts the sun (apparent place); without it the place is the geometric one, parallax included.
    """
    from pvlib import spa  # it loads pandas, which takes longer than many a command

    t, lat, lon = np.broadcast_arrays(np.atleast_1d(np.asarray(t_ns, dtype=np.int64)), lat, lon)
    _, _, apparent, geometric, azimuth, _ = spa.solar_position_numpy(
        t.astype(np.float64) * 1e-9,
        np.degrees(lat),
        np.degrees(lon),
        0.0,
        _PRESSURE_HPA,
        _TEMPERATURE_C,
        _TT_MINUS_UT1_S,
        _REFRACTION_AT_HORIZON_DEG,
        numthreads=1,
    )
    return np.radians(azimuth), np.radians(apparent if refraction else geometric)


def sun_axes(azimuth: ArrayLike, elevation: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Local NED unit vectors (..., 3) to the sun, across it (growing azimuth) and upward (growing elevation)."""
    sa, ca, se, ce = np.sin(azimuth), np.cos(azimuth), np.sin(elevation), np.cos(elevation)
    return (
        np.stack([ce * ca, ce * sa, -se], axis=-1),
        np.stack([-sa, ca, np.zeros_like(sa)], axis=-1),
        np.stack([-se * ca, -se * sa, -ce], axis=-1),
    )


def sun_direction_n(
    origin: Origin, t_ns: ArrayLike, lat: ArrayLike, lon: ArrayLike, *, refraction: bool = True
) -> FloatArray:
    """Unit vectors to the apparent sun in n, shape (N, 3), seen in air from (lat, lon) [rad] at ``t_ns`` UTC.

    The vector points up (negative third component at the place itself) while the sun is above the horizon.
    """
    azimuth, elevation = sun_azimuth_elevation(t_ns, lat, lon, refraction=refraction)
    local = sun_axes(azimuth, elevation)[0]
    R = np.broadcast_to(R_n_local(origin, lat, lon), (len(local), 3, 3))
    s_n: FloatArray = np.einsum("nij,nj->ni", R, local)
    return s_n
