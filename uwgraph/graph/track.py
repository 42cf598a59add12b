"""A track that can be asked at any time, and the dead-reckoned one: the first guess of the graph.

Measurements between keyframes are moved to their keyframe along a track: over a fraction of a second it is good to
millimetres whatever its drift.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from factors.lie import exp_so3
from uwgraph.graph.prepare import Prepared
from uwgraph.types import FloatArray, TimeArray

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
        """R_nb: the grid's attitude before, turned by the gyro less its bias and the Earth, shape (N, 3, 3)."""
        t_ns = np.asarray(t_ns)
        k = np.clip(np.searchsorted(self.t_ns, t_ns, side="right") - 1, 0, len(self.t_ns) - 1)
        dt = ((t_ns - self.t_ns[k]) * 1e-9)[:, None]
        imu = self.prepared.imu
        turned = np.swapaxes(imu.rotation_at(self.t_ns), 1, 2)[k] @ imu.rotation_at(t_ns)
        bias = np.broadcast_to(self.bias_gyro, (len(self.t_ns), 3))[k]
        R: FloatArray = exp_so3(-self.prepared.earth_rate_n * dt) @ self.R_nb[k] @ turned @ exp_so3(-bias * dt)
        return R

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

    def velocity_at(self, t_ns: TimeArray) -> FloatArray:
        """Linear between the grid's, shape (N, 3), m/s."""
        t0 = self.t_ns[0]
        t, grid = (np.asarray(t_ns) - t0) * 1e-9, (self.t_ns - t0) * 1e-9
        return np.column_stack([np.interp(t, grid, self.v_n[:, i]) for i in range(3)])


def dead_reckon(prepared: Prepared, start_ns: int, R_start: FloatArray, p_start: FloatArray) -> Track:
    """Gyro attitude on the turning Earth and DVL velocity, from a known attitude and position.

    Where there is no DVL the nearest velocity is held. R_nb(t) = Exp(-w_ie (t - t_0)) R_nb(t_0) dR(t_0, t) is exact for
    a frame that turns with the Earth.
    """
    imu = prepared.imu
    step = max(round(RECKONING_PERIOD_S * 1e9), int(np.median(np.diff(imu.t_ns))))
    t = np.append(np.arange(imu.t_ns[0], imu.t_ns[-1], step), imu.t_ns[-1])
    dR = imu.rotation_at(np.array([start_ns]))[0].T @ imu.rotation_at(t)
    R = exp_so3(-prepared.earth_rate_n * ((t - start_ns) * 1e-9)[:, None]) @ (R_start @ dR)
    v_n = np.einsum("kij,kj->ki", R, body_velocity(prepared, t))
    dt = np.diff(t) * 1e-9
    p = np.concatenate([np.zeros((1, 3)), np.cumsum((v_n[1:] + v_n[:-1]) / 2.0 * dt[:, None], axis=0)])
    track = Track(prepared, t, R, p, v_n)
    return Track(prepared, t, R, p - track.position_at(np.array([start_ns])) + p_start, v_n)


def body_velocity(prepared: Prepared, t_ns: TimeArray) -> FloatArray:
    """Velocity of the body origin in body axes, v - w x l, zero where nobody measured any, shape (N, 3)."""
    dvl = prepared.dvl
    if dvl is None:
        return np.zeros((len(t_ns), 3))
    at, pings = ((t - dvl.t_ns[0]) * 1e-9 for t in (np.asarray(t_ns), dvl.t_ns))
    v = np.column_stack([np.interp(at, pings, dvl.v_b[:, i]) for i in range(3)])
    k = np.clip(np.searchsorted(prepared.imu.t_ns, t_ns, side="left") - 1, 0, len(prepared.imu.w_b) - 1)
    return v - np.cross(prepared.imu.w_b[k], prepared.dive.rig.dvl.l_b)
