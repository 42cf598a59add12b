"""A track that can be asked at any time, and the dead-reckoned one: the first guess of the graph.

Measurements between keyframes are moved to their keyframe along a track: over a fraction of a second it is good to
millimetres whatever its drift.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from factors.lie import exp_so3
from uwgraph.graph.attitude import STEP_S, aided_attitude
from uwgraph.graph.prepare import Prepared, seen_velocity
from uwgraph.types import FloatArray, TimeArray

IndexArray = NDArray[np.intp]

RECKONING_PERIOD_S = 0.1


@dataclass(frozen=True, eq=False)
class Track:
    """States on a grid of times; between them the gyro turns the attitude and a Hermite cubic bends the way."""

    prepared: Prepared
    t_ns: TimeArray
    """Stamps of the grid, shape (M,)."""
    R_nb: FloatArray
    """Shape (M, 3, 3)."""
    p_n: FloatArray
    """Shape (M, 3), m."""
    v_n: FloatArray
    """Shape (M, 3), m/s."""
    bias_gyro: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Shape (3,) or (M, 3), rad/s."""

    def rotation_at(self, t_ns: TimeArray) -> FloatArray:
        """R_nb: the grid's attitude before, turned by the gyro less its bias and the Earth, shape (N, 3, 3).

        What the gyro lacks to reach the next grid point is spread evenly over the step, so that nothing jumps.
        """
        t_ns = np.asarray(t_ns)
        k = np.clip(np.searchsorted(self.t_ns, t_ns, side="right") - 1, 0, len(self.t_ns) - 1)
        share = (t_ns - self.t_ns[k]) / np.append(np.diff(self.t_ns), 1)[k]
        R: FloatArray = self._turned(k, t_ns) @ exp_so3(share[:, None] * self._lack[k])
        return R

    def _turned(self, k: IndexArray, t_ns: TimeArray) -> FloatArray:
        """Attitude of grid point k turned by the gyro to another time."""
        dt = ((t_ns - self.t_ns[k]) * 1e-9)[:, None]
        turned = np.swapaxes(self._gyro, 1, 2)[k] @ self.prepared.imu.rotation_at(t_ns)
        bias = np.broadcast_to(self.bias_gyro, (len(self.t_ns), 3))[k]
        R: FloatArray = exp_so3(-self.prepared.earth_rate_n * dt) @ self.R_nb[k] @ turned @ exp_so3(-bias * dt)
        return R

    @cached_property
    def _gyro(self) -> FloatArray:
        return self.prepared.imu.rotation_at(self.t_ns)

    @cached_property
    def _lack(self) -> FloatArray:
        """Rotation vector from the turned grid point to the next one, zero after the last, shape (M, 3), rad."""
        k = np.arange(len(self.t_ns) - 1)
        miss = np.swapaxes(self._turned(k, self.t_ns[1:]), 1, 2) @ self.R_nb[1:]
        return np.concatenate([Rotation.from_matrix(miss).as_rotvec(), np.zeros((1, 3))])

    def heading_at(self, t_ns: TimeArray) -> FloatArray:
        """Heading against n's north, shape (N,), rad."""
        R = self.rotation_at(t_ns)
        return np.arctan2(R[:, 1, 0], R[:, 0, 0])

    def position_at(self, t_ns: TimeArray) -> FloatArray:
        """Shape (N, 3), m."""
        t0 = self.t_ns[0]
        way = CubicHermiteSpline((self.t_ns - t0) * 1e-9, self.p_n, self.v_n)
        p: FloatArray = way((np.asarray(t_ns) - t0) * 1e-9)
        return p

    def point_at(self, t_ns: TimeArray, lever_b: FloatArray) -> FloatArray:
        """Position of a point of the body, shape (N, 3), m; its ``lever_b`` is from the body origin."""
        p = self.position_at(t_ns)
        return p + self.rotation_at(t_ns) @ lever_b if lever_b.any() else p

    def velocity_at(self, t_ns: TimeArray) -> FloatArray:
        """Linear between the grid's, shape (N, 3), m/s."""
        t0 = self.t_ns[0]
        t, grid = (np.asarray(t_ns) - t0) * 1e-9, (self.t_ns - t0) * 1e-9
        return np.column_stack([np.interp(t, grid, self.v_n[:, i]) for i in range(3)])


def dead_reckon(
    prepared: Prepared,
    start_ns: int,
    R_start: FloatArray,
    p_start: FloatArray,
    cov_b: FloatArray,
    *,
    heading_aids: bool = True,
) -> Track:
    """Aided attitude and DVL velocity from a known attitude (covariance ``cov_b`` in the body) and position.

    Where there is no DVL the nearest velocity is held. Without ``heading_aids`` sun and compass are left out: the
    heading is then the gyro's from ``R_start`` on.
    """
    end = int(prepared.imu.t_ns[-1])
    steps = _grid(start_ns, end, STEP_S)
    attitude = aided_attitude(prepared, steps, R_start, cov_b, body_velocity(prepared, steps), heading_aids)
    zeros = np.zeros((len(steps), 3))
    turning = Track(prepared, steps, attitude.R_nb, zeros, zeros, attitude.bias_gyro)
    t = _grid(start_ns, end, RECKONING_PERIOD_S)
    R = turning.rotation_at(t)
    v_n = np.einsum("kij,kj->ki", R, body_velocity(prepared, t))
    dt = np.diff(t) * 1e-9
    way = np.concatenate([np.zeros((1, 3)), np.cumsum((v_n[1:] + v_n[:-1]) / 2.0 * dt[:, None], axis=0)])
    return Track(prepared, t, R, p_start + way, v_n, attitude.bias_gyro[np.searchsorted(steps, t, side="right") - 1])


def _grid(start_ns: int, end_ns: int, period_s: float) -> TimeArray:
    """Stamps from start to end, both included."""
    return np.append(np.arange(start_ns, end_ns, round(period_s * 1e9)), end_ns)


def body_velocity(prepared: Prepared, t_ns: TimeArray) -> FloatArray:
    """Velocity of the body origin in body axes, v - w x l, shape (N, 3).

    Without a DVL it is that of visual odometry, and zero where nobody measured any.
    """
    dvl = prepared.dvl
    if dvl is None:
        seen_ns, seen = seen_velocity(prepared.odometry)
        return _interpolated(t_ns, seen_ns, seen) if len(seen) else np.zeros((len(t_ns), 3))
    v = _interpolated(t_ns, dvl.t_ns, dvl.v_b)
    k = np.clip(np.searchsorted(prepared.imu.t_ns, t_ns, side="left") - 1, 0, len(prepared.imu.w_b) - 1)
    return v - np.cross(prepared.imu.w_b[k], prepared.dive.rig.dvl.l_b)


def _interpolated(t_ns: TimeArray, known_ns: TimeArray, v: FloatArray) -> FloatArray:
    """Linear between the known ones, the nearest beyond, shape (N, 3)."""
    at, known = ((t - known_ns[0]) * 1e-9 for t in (np.asarray(t_ns), known_ns))
    return np.column_stack([np.interp(at, known, v[:, i]) for i in range(3)])
