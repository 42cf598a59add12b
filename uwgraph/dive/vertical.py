"""Which way is up, from the IMU alone (and the DVL where there is one): what an optical front end needs, no heading.

In the frame i that the gyro carries, gravity hardly moves: the specific force, integrated, grows along the vertical
but for the vehicle's own changes of velocity, which the DVL knows. The slope of that integral at time t, from a
parabola over a minute before and after, is the vertical; the parabola's bend takes up the Earth's rotation and the
gyro's bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwgraph.dive.inertial_track import InertialTrack, inertial_track
from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.types import FloatArray, TimeArray

HALF_WINDOW_S = 60.0
KNOT_S = 5.0
"""The slope is evaluated so often and interpolated between: in frame i it moves by 15 degrees an hour at most."""
CORRELATION_S = 10.0
"""How long velocity errors last, for the weights."""
DVL_SIGMA, STILL_SIGMA = 0.03, 1.0
"""m/s; error of a DVL's velocity, and how fast a vehicle without one may be."""


@dataclass(frozen=True, eq=False)
class Vertical:
    """The zenith in the body at given times."""

    up_b: FloatArray
    """Unit vectors, shape (N, 3)."""
    sigma: FloatArray
    """1-sigma of the tilt about each level axis, shape (N,), rad."""


def vertical(dive: Dive, t_ns: TimeArray) -> Vertical:
    """The zenith in the body at ``t_ns`` (on the IMU's clock, the rig's offset applied).

    Raises
    ------
    DataError
        When the dive has no IMU, or a time lies outside its stamps.
    """
    if dive.imu is None or len(dive.imu) < 2:
        raise DataError("the dive has no IMU samples", where="imu", remedy="the vertical comes from the IMU")
    start = dive.imu.t_ns[0] + dive.rig.imu.time_offset_ns
    t = (np.asarray(t_ns, dtype=np.int64) - start).astype(np.float64) * 1e-9
    track = inertial_track(dive.imu, dive.rig.imu)
    outside = (t < -1.0) | (t > track.t_s[-1] + 1.0)
    if outside.any():
        raise DataError(
            f"{np.count_nonzero(outside)} of {len(t)} images lie outside the time of the IMU",
            where="images",
            remedy="check the stamps and their clock",
        )
    knots = np.linspace(0.0, track.t_s[-1], max(2, 1 + round(track.t_s[-1] / KNOT_S)))
    slope_i, variance = _slopes(_fallen(dive, track, int(start)), knots)
    f_i = np.stack([np.interp(t, knots, column) for column in slope_i.T], axis=1)
    gravity = np.linalg.norm(f_i, axis=1)
    up_b = track.attitude(t).inv().apply(f_i / gravity[:, None])
    sigma = np.sqrt(np.interp(t, knots, variance) + dive.rig.imu.accel_bias_sigma**2) / gravity
    return Vertical(up_b, sigma)


@dataclass(frozen=True, eq=False)
class _Fallen:
    """Integral of the specific force less the vehicle's velocity, in frame i: it grows straight up with gravity."""

    t_s: FloatArray
    value_i: FloatArray
    weight: FloatArray


def _fallen(dive: Dive, track: InertialTrack, start_ns: int) -> _Fallen:
    """The vehicle at rest but for STILL_SIGMA on a grid, and its velocity as the DVL knows it at the pings."""
    t = np.arange(0.0, track.t_s[-1], 1.0)
    parts = [_Fallen(t, track.velocity(t), np.full(len(t), 1.0 / CORRELATION_S / STILL_SIGMA**2))]
    dvl, rig = dive.dvl, dive.rig.dvl
    if dvl is not None:
        at = (dvl.t_ns + rig.time_offset_ns - start_ns).astype(np.float64) * 1e-9
        keep = dvl.valid & np.isfinite(dvl.v_s).all(axis=1) & (at >= 0.0) & (at <= track.t_s[-1])
        at = at[keep]
        v_b = dvl.v_s[keep] @ rig.R_bs.T - np.cross(track.rate(at), rig.l_b)
        apart = np.clip(np.gradient(at) if len(at) > 1 else np.ones(len(at)), 0.0, CORRELATION_S)
        fallen = track.velocity(at) - track.attitude(at).apply(v_b)
        parts.append(_Fallen(at, fallen, apart / CORRELATION_S / DVL_SIGMA**2))
    return _Fallen(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("t_s", "value_i", "weight")))


def _slopes(fallen: _Fallen, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slope (K, 3) at the knots of a local parabola with tricube weights, and its variance (K,)."""
    slope, variance = np.empty((len(knots), 3)), np.empty(len(knots))
    for k, knot in enumerate(knots):
        x = (fallen.t_s - knot) / HALF_WINDOW_S
        near = np.abs(x) < 1.0
        A = np.vander(x[near], 3, increasing=True)
        w = fallen.weight[near] * (1.0 - np.abs(x[near]) ** 3) ** 3
        cov = np.linalg.pinv((A * w[:, None]).T @ A)
        slope[k] = (cov @ (A * w[:, None]).T @ fallen.value_i[near])[1] / HALF_WINDOW_S
        variance[k] = cov[1, 1] / HALF_WINDOW_S**2
    return slope, variance
