"""What each sensor shares with the IMU, put so that it is slow when both are of the same instant.

Every builder takes the dive and the IMU's track and gives a :class:`~uwgraph.dive.clock_fit.Comparison`; times are
seconds since the IMU's first stamp. The columns are the constants that may differ between two sensors of one vehicle:
scale, mounting, lever arm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.integrate import cumulative_trapezoid

from uwgraph.dive.clock_fit import Comparison, IndexArray
from uwgraph.dive.inertial_track import InertialTrack
from uwgraph.dive.model import Dive
from uwgraph.frames import matrix_from_rph, ned_from_geodetic
from uwgraph.types import BoolArray, FloatArray, Stream

Path = Callable[[FloatArray], FloatArray]

MIN_PERIOD_S = 0.2
"""Faster streams are thinned to this: a vehicle's motion has little to say above 2.5 Hz."""
LEVEL_S = 30.0
"""Half the time over which the specific force is averaged to find the vertical."""


def dvl_comparison(dive: Dive, track: InertialTrack) -> Comparison:
    """R_ib (v_b - w x l) - int(f) dt: initial velocity, gravity and biases are slow."""
    assert dive.dvl is not None
    keep = _thinned(dive.dvl, dive.dvl.valid & np.isfinite(dive.dvl.v_s).all(axis=1))
    v_b = dive.dvl.v_s[keep] @ dive.rig.dvl.R_bs.T

    def model(index: IndexArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        R, v, w = track.attitude(t), v_b[index], track.rate(t)
        y = R.apply(v) - track.velocity(t)
        mounting = [R.apply(np.cross(axis, v)) for axis in np.eye(3)]
        lever = [R.apply(np.cross(w, axis)) for axis in np.eye(3)]
        return y, np.stack([R.apply(v), *mounting, *lever], axis=-1)

    how = "DVL velocity turned by the gyro against the integrated specific force; scale, mounting and lever arm free"
    return Comparison(how, _seconds(dive, dive.dvl)[keep], model, _span(track))


def direction_comparison(how: str, t_s: FloatArray, directions_b: FloatArray, track: InertialTrack) -> Comparison:
    """R_ib d_b stays where it is for directions d_b, shape (n, m, 3), that are fixed in space."""
    many = directions_b.shape[1]

    def model(index: IndexArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        R, d = track.attitude(t).as_matrix()[:, None], directions_b[index]
        turned = (R @ d[..., None])[..., 0]
        mounting = np.stack([(R @ np.cross(axis, d)[..., None])[..., 0] for axis in np.eye(3)], axis=-1)
        return turned.reshape(-1, 3 * many), mounting.reshape(-1, 3 * many, 3)

    return Comparison(how, t_s, model, _span(track))


def reference_comparison(dive: Dive, track: InertialTrack) -> Comparison:
    """The axes of n as the reference sees them from the body."""
    assert dive.reference is not None
    keep = _thinned(dive.reference, np.isfinite(dive.reference.rph).all(axis=1))
    axes_b = matrix_from_rph(dive.reference.rph[keep])
    return direction_comparison(
        "attitude of the reference against the gyro", _seconds(dive, dive.reference)[keep], axes_b, track
    )


def sun_comparison(dive: Dive, track: InertialTrack) -> Comparison:
    """The sun direction."""
    assert dive.sun is not None
    keep = _thinned(dive.sun, np.isfinite(dive.sun.s_b).all(axis=1) & (dive.sun.flags == 0))
    s_b = dive.sun.s_b[keep, None]
    return direction_comparison("sun direction against the gyro", _seconds(dive, dive.sun)[keep], s_b, track)


def heading_comparison(dive: Dive, track: InertialTrack) -> Comparison:
    """Heading minus that of the gyro, levelled by the accelerometer."""
    assert dive.heading is not None
    keep = _thinned(dive.heading, np.isfinite(dive.heading.heading))
    heading = dive.heading.heading[keep]

    def model(index: IndexArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        difference = np.unwrap(heading[index] - gyro_heading(track, t))
        return difference[:, None], np.empty((len(t), 1, 0))

    return Comparison("heading against the levelled gyro", _seconds(dive, dive.heading)[keep], model, _span(track))


def gyro_heading(track: InertialTrack, t_s: FloatArray) -> FloatArray:
    """Heading [rad] of the body's x axis against a direction that drifts with the gyro, shape (n,)."""
    down = down_direction(track, t_s)
    level = np.eye(3)[np.argmin(np.abs(down.mean(axis=0)))]
    east = np.cross(down, level)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    north = np.cross(east, down)
    x = track.attitude(t_s).apply([1.0, 0.0, 0.0])
    heading: FloatArray = np.arctan2(np.sum(east * x, axis=1), np.sum(north * x, axis=1))
    return heading


def down_direction(track: InertialTrack, t_s: FloatArray) -> FloatArray:
    """The vertical in frame i, shape (n, 3): against the mean specific force of a minute (motion averages out)."""
    first, last = track.t_s[0], track.t_s[-1]
    mean_force = track.velocity(np.minimum(t_s + LEVEL_S, last)) - track.velocity(np.maximum(t_s - LEVEL_S, first))
    down: FloatArray = -mean_force / np.linalg.norm(mean_force, axis=1, keepdims=True)
    return down


def depth_comparison(dive: Dive, track: InertialTrack) -> Comparison:
    """Depth minus the vertical specific force integrated twice, and a lever arm's share.

    What is left of the horizontal motion, because the vertical is known to a fraction of a degree, is fitted block by
    block. The vertical part itself is not scaled: a noisy accelerometer would be scaled to nothing, and any shift fit.
    """
    assert dive.depth is not None
    keep = _thinned(dive.depth, np.isfinite(dive.depth.depth))
    depth = dive.depth.depth[keep, None]
    down = down_direction(track, track.t_s)
    sinking = np.cumsum(np.sum(down * np.diff(track.dv_i, axis=0, prepend=track.dv_i[:1]), axis=1))
    sunk = cumulative_trapezoid(sinking, track.t_s, initial=0.0)
    level = np.linalg.svd(down.mean(axis=0, keepdims=True))[2][1:].T

    def model(index: IndexArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        lever = track.attitude(t).inv().apply(down_direction(track, t))
        columns = np.concatenate([track.displacement(t) @ level, lever], axis=1)
        return depth[index] - np.interp(t, track.t_s, sunk)[:, None], columns[:, None, :]

    how = "depth against the vertical specific force integrated twice; lever arm free"
    return Comparison(how, _seconds(dive, dive.depth)[keep], model, _span(track), local=2)


def fixes_comparison(dive: Dive, track: InertialTrack) -> Comparison:
    """North and east minus constant directions times the displacement."""
    assert dive.fixes is not None
    fixes = dive.fixes
    keep = _thinned(fixes, np.isfinite(fixes.lat) & np.isfinite(fixes.lon))
    p_n = ned_from_geodetic(dive.origin, fixes.lat[keep], fixes.lon[keep], 0.0)[:, :2]
    displacement, span, source = _displacement(dive, track)

    def model(index: IndexArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        return p_n[index], np.einsum("ij,nk->nijk", np.eye(2), displacement(t)).reshape(len(t), 2, 6)

    return Comparison(f"fixes against the displacement of {source}", _seconds(dive, fixes)[keep], model, span, local=6)


def _displacement(dive: Dive, track: InertialTrack) -> tuple[Path, tuple[float, float], str]:
    """Displacement in frame i as a function of time, where it is known, and whose it is."""
    if dive.dvl is None:
        return track.displacement, _span(track), "the IMU"
    t = _seconds(dive, dive.dvl) + dive.rig.dvl.time_offset_s
    good = dive.dvl.valid & np.isfinite(dive.dvl.v_s).all(axis=1) & (t > track.t_s[0]) & (t < track.t_s[-1])
    if np.count_nonzero(good) < 2:
        return track.displacement, _span(track), "the IMU"
    t = t[good]
    v_i = track.attitude(t).apply(dive.dvl.v_s[good] @ dive.rig.dvl.R_bs.T)
    p_i = cumulative_trapezoid(v_i, t, axis=0, initial=0.0)

    def path(at: FloatArray) -> FloatArray:
        return np.stack([np.interp(at, t, column) for column in p_i.T], axis=-1)

    return path, (float(t[0]), float(t[-1])), "the DVL"


def _seconds(dive: Dive, stream: Stream) -> FloatArray:
    """Stamps as seconds since the IMU's first."""
    assert dive.imu is not None
    seconds: FloatArray = (stream.t_ns - dive.imu.t_ns[0]) * 1e-9
    return seconds


def _span(track: InertialTrack) -> tuple[float, float]:
    return float(track.t_s[0]), float(track.t_s[-1])


def _thinned(stream: Stream, good: BoolArray | np.bool_) -> IndexArray:
    """Indices of the good samples, at most one per MIN_PERIOD_S."""
    index = np.flatnonzero(good)
    slot = np.floor(stream.t_s[index] / MIN_PERIOD_S + 1e-6).astype(np.int64)
    thinned: IndexArray = index[np.unique(slot, return_index=True)[1]]
    return thinned


COMPARISONS: Mapping[str, Callable[[Dive, InertialTrack], Comparison]] = {
    "dvl": dvl_comparison,
    "depth": depth_comparison,
    "fixes": fixes_comparison,
    "heading": heading_comparison,
    "sun": sun_comparison,
    "reference": reference_comparison,
}
