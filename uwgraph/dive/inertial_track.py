"""Attitude, velocity and displacement increments of the IMU alone, in a frame fixed where the recording starts.

Frame **i** is the body frame at the first sample, carried along by nothing but the gyro. Gravity, the biases and the
Earth's rotation are left in: whoever compares another sensor with the track removes them as a slow trend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from factors.lie import cumulative_rotation, exp_so3
from uwgraph.dive.rig import ImuRig
from uwgraph.types import FloatArray, Imu


@dataclass(frozen=True, eq=False)
class InertialTrack:
    """What the IMU alone knows; query times are seconds on the IMU's clock since its first stamp."""

    t_s: FloatArray
    """Shape (N,)."""
    turn_b: FloatArray
    """Integral of the angular rate in body axes, shape (N, 3), rad."""
    q_ib: FloatArray
    """Attitude at the stamps, quaternions xyzw without jumps of sign, shape (N, 4)."""
    dv_i: FloatArray
    """Integral of the specific force in frame i, shape (N, 3), m/s."""
    dp_i: FloatArray
    """Integral of ``dv_i``, shape (N, 3), m."""

    def attitude(self, t_s: FloatArray) -> Rotation:
        """R_ib at the given times; within an IMU interval the quaternion is interpolated and normalised."""
        return Rotation.from_quat(_interpolate(t_s, self.t_s, self.q_ib))

    def velocity(self, t_s: FloatArray) -> FloatArray:
        """Integral of the specific force, shape (n, 3), m/s."""
        return _interpolate(t_s, self.t_s, self.dv_i)

    def displacement(self, t_s: FloatArray) -> FloatArray:
        """Double integral of the specific force, shape (n, 3), m."""
        return _interpolate(t_s, self.t_s, self.dp_i)

    def rate(self, t_s: FloatArray, half_s: float = 0.1) -> FloatArray:
        """Angular rate averaged over ``2 half_s``, shape (n, 3), rad/s: short motions are not vibration."""
        before, after = (_interpolate(t_s + h, self.t_s, self.turn_b) for h in (-half_s, half_s))
        return (after - before) / (2 * half_s)


def inertial_track(imu: Imu, rig: ImuRig | None = None) -> InertialTrack:
    """Integrate an IMU stream once, sample t_i being the mean over (t_{i-1}, t_i]."""
    R_bs = (rig or ImuRig()).R_bs
    f_b, w_b, t = imu.f_s @ R_bs.T, imu.w_s @ R_bs.T, imu.t_s
    dt = np.diff(t, prepend=t[0])[:, None]
    q_ib = Rotation.from_matrix(cumulative_rotation(exp_so3(w_b * dt))[1:]).as_quat()
    q_ib[1:] *= np.cumprod(np.where((q_ib[1:] * q_ib[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))[:, None]
    middle = Rotation.from_quat(q_ib) * Rotation.from_rotvec(-0.5 * w_b * dt)
    step = middle.apply(f_b) * dt
    dv = np.cumsum(step, axis=0)
    dp = np.cumsum((dv - 0.5 * step) * dt, axis=0)
    return InertialTrack(t, np.cumsum(w_b * dt, axis=0), q_ib, dv, dp)


def _interpolate(t: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    """Linear interpolation of rows; the ends are kept outside."""
    after = np.clip(np.searchsorted(knots, t), 1, len(knots) - 1)
    share = np.clip((t - knots[after - 1]) / (knots[after] - knots[after - 1]), 0.0, 1.0)[:, None]
    between: FloatArray = values[after - 1] * (1.0 - share) + values[after] * share
    return between
