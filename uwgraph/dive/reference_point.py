"""Which point of the vehicle the reference is of.

A reference is seldom of the IMU. In a turn its velocity differs from the DVL's by w x l; two metres of forgotten lever
arm look like two metres of navigation error that comes and goes with the heading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from uwgraph.dive.inertial_track import InertialTrack
from uwgraph.dive.model import Dive
from uwgraph.frames import matrix_from_rph
from uwgraph.types import FloatArray

MAX_SIGMA = 0.3
"""m; a lever arm less certain than this on any axis is not believed."""
HUBER = 2.0


@dataclass(frozen=True, eq=False)
class ReferencePoint:
    """Place of the reference point in the body frame."""

    l_b: FloatArray
    """From the IMU to the point, shape (3,), m."""
    sigma: FloatArray
    """Shape (3,), m."""
    rms_before: float
    """RMS of reference velocity minus DVL velocity in the body, m/s, without the lever arm ..."""
    rms_after: float
    """... and with it."""


def reference_point(dive: Dive, track: InertialTrack) -> ReferencePoint | None:
    """Lever arm from the IMU to the reference point, from v_ref - v_dvl = w x (l_ref - l_dvl).

    Scale and mounting of the DVL are fitted along. Clock offsets are taken from the rig. None where the dive has no
    reference velocity, no DVL, or turns too little.
    """
    samples = _velocities(dive, track)
    if samples is None:
        return None
    v_ref, v_dvl, w = samples
    lever = [np.cross(w, axis) for axis in np.eye(3)]
    mounting = [np.cross(axis, v_dvl) for axis in np.eye(3)]
    A = np.stack([*lever, v_dvl, *mounting], axis=-1)
    y = v_ref - v_dvl
    weight = np.ones(len(y))
    for _ in range(10):
        root = np.sqrt(weight)[:, None]
        x = np.linalg.lstsq((A * root[..., None]).reshape(-1, 7), (y * root).ravel(), rcond=None)[0]
        size = np.linalg.norm(y - A @ x, axis=1)
        limit = HUBER * 1.4826 * np.median(size) + np.finfo(float).tiny
        weight = np.minimum(1.0, limit / np.maximum(size, limit))
    normal = np.einsum("n,nij,nik->jk", weight, A, A)
    variance = np.sum(weight * size**2) / (3 * np.sum(weight) - 7)
    sigma = np.sqrt(variance * np.diag(np.linalg.pinv(normal)))[:3]
    if not (sigma < MAX_SIGMA).all():
        return None
    without = y - A[..., 3:] @ np.linalg.lstsq(A[..., 3:].reshape(-1, 4), y.ravel(), rcond=None)[0]
    rms = [float(np.sqrt(np.average(np.sum(r**2, axis=1), weights=weight))) for r in (without, y - A @ x)]
    return ReferencePoint(x[:3] + dive.rig.dvl.l_b, sigma, *rms)


def depth_is_copied(dive: Dive) -> bool:
    """Whether the depth stream is the reference's height with the sign changed: then it is of the reference's point."""
    depth, reference = dive.depth, dive.reference
    if depth is None or reference is None or not np.array_equal(depth.t_ns, reference.t_ns):
        return False
    return bool(np.allclose(depth.depth, -reference.height, atol=1e-6, equal_nan=True))


def _velocities(dive: Dive, track: InertialTrack) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Body velocity of reference and DVL, and the turn rate, at the reference's stamps, each shape (n, 3)."""
    dvl, reference = dive.dvl, dive.reference
    if dvl is None or reference is None or dive.imu is None:
        return None
    start_ns = dive.imu.t_ns[0]
    good = dvl.valid & np.isfinite(dvl.v_s).all(axis=1)
    known = np.isfinite(reference.rph).all(axis=1) & np.isfinite(reference.v_n).all(axis=1)
    if good.sum() < 10 or known.sum() < 10:
        return None
    t_dvl = (dvl.t_ns[good] - start_ns) * 1e-9 + dive.rig.dvl.time_offset_s
    t = (reference.t_ns[known] - start_ns) * 1e-9 + dive.rig.reference.time_offset_s
    after = np.clip(np.searchsorted(t_dvl, t), 1, len(t_dvl) - 1)
    near = t_dvl[after] - t_dvl[after - 1] <= dive.rig.dvl.max_gap_s
    inside = near & (t > max(t_dvl[0], track.t_s[0])) & (t < min(t_dvl[-1], track.t_s[-1]))
    if inside.sum() < 10:
        return None
    R_nb = matrix_from_rph(reference.rph[known][inside])
    v_ref = np.einsum("nji,nj->ni", R_nb, reference.v_n[known][inside])
    v_dvl = CubicSpline(t_dvl, dvl.v_s[good] @ dive.rig.dvl.R_bs.T)(t[inside])
    return v_ref, v_dvl, track.rate(t[inside])
