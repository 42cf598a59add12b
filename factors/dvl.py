"""Doppler velocities, preintegrated into the displacement between keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.adapter import Loss, Measurement
from factors.lie import FloatArray
from factors.noise import gaussian, robust, sqrt_information_of_covariance
from factors.place import relative_pose_jacobians, relative_pose_residual

TimeArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Displacements:
    """Displacement of the body origin over each interval between keyframes."""

    d_start: FloatArray
    """In the axes of the interval's first keyframe, shape (K - 1, 3), m; NaN where not valid."""
    dR: FloatArray
    """Rotation of the last keyframe's body axes to the first's, shape (K - 1, 3, 3)."""
    cov_start: FloatArray
    """Covariance of ``d_start``, shape (K - 1, 3, 3), m^2; NaN where not valid."""
    valid: NDArray[np.bool_]
    """Whether pings cover the interval without too long a gap, shape (K - 1,)."""

    def measurement(self, k: int) -> DvlDisplacement:
        """Interval ``k`` as a measurement."""
        return DvlDisplacement(self.d_start[k], self.dR[k], self.cov_start[k])

    def lowered(
        self, keys: Sequence[tuple[int, int]], intervals: Sequence[int], loss: Loss | None = None
    ) -> list[gtsam.NonlinearFactor]:
        """:meth:`DvlDisplacement.lowered` of many intervals at once, one a pair of keys."""
        index = np.asarray(intervals, dtype=np.intp)
        S = np.zeros((len(index), 6, 6))
        S[:, 3:, 3:] = np.linalg.inv(np.linalg.cholesky(self.cov_start[index])) @ self.dR[index]
        return [
            gtsam.BetweenFactorPose3(i, j, gtsam.Pose3(gtsam.Rot3(R), d), robust(gaussian(s), loss))
            for (i, j), R, d, s in zip(keys, self.dR[index], self.d_start[index], S, strict=True)
        ]


def displacements(
    t_ns: TimeArray,
    v_b: FloatArray,
    cov_b: FloatArray,
    R_gb: FloatArray,
    keyframe_t_ns: TimeArray,
    keyframe_R_gb: FloatArray,
    l_b: ArrayLike = (0.0, 0.0, 0.0),
    max_gap_s: float = np.inf,
) -> Displacements:
    """Integrate the pings' velocity, linear in time between pings in gyro axes g, over each keyframe interval.

    Neighbouring intervals share the pings at their edges, so their errors are correlated. The covariance of an interval
    includes its covariance with its neighbours (row sum): treated as independent, the intervals then add up to the
    variance that the independent pings give. Without it, one ping per keyframe would count twice.

    Parameters
    ----------
    t_ns, v_b, cov_b
        Stamps of the pings, shape (N,), increasing; velocity over the ground of the DVL in body axes, shape (N, 3),
        m/s, and its covariance, shape (N, 3, 3).
    R_gb, keyframe_R_gb
        Rotation of the body to any one frame that does not turn, at the pings and at the keyframes, shapes (N, 3, 3)
        and (K, 3, 3): see :func:`factors.inertial.rotation_history`.
    keyframe_t_ns
        Shape (K,), increasing.
    l_b
        Lever arm from the body origin to the DVL, shape (3,), m.
    max_gap_s
        An interval that needs two consecutive pings further apart than this is not valid.

    Raises
    ------
    ValueError
        When stamps do not increase.
    """
    if np.any(np.diff(t_ns) <= 0) or np.any(np.diff(keyframe_t_ns) <= 0):
        raise ValueError("DVL stamps and keyframe stamps must increase")
    dR = np.swapaxes(keyframe_R_gb[:-1], 1, 2) @ keyframe_R_gb[1:]
    K = len(keyframe_t_ns)
    d = np.full((K - 1, 3), np.nan)
    cov = np.full((K - 1, 3, 3), np.nan)
    before = np.searchsorted(t_ns, keyframe_t_ns[:-1], side="right") - 1
    after = np.searchsorted(t_ns, keyframe_t_ns[1:], side="left")
    valid = (before >= 0) & (after < len(t_ns))
    gaps = np.concatenate([[0], np.cumsum(np.diff(t_ns) > max_gap_s * 1e9)])
    valid[valid] &= gaps[after[valid]] == gaps[before[valid]]
    if not valid.any():
        return Displacements(d, dR, cov, valid)

    # Every (interval, ping) pair in one flat list: interval k needs the pings before[k] .. after[k].
    count = (after - before + 1)[valid]
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    row = np.repeat(np.flatnonzero(valid), count)
    ping = np.arange(count.sum()) - np.repeat(first - before[valid], count)
    weight = _hat_integral(t_ns, ping, keyframe_t_ns[row + 1]) - _hat_integral(t_ns, ping, keyframe_t_ns[row])
    total = np.bincount(ping, weight, minlength=len(t_ns))

    R = np.swapaxes(keyframe_R_gb[row], 1, 2) @ R_gb[ping]
    velocity = (R @ v_b[ping, :, None])[..., 0]
    covariance = R @ cov_b[ping] @ np.swapaxes(R, 1, 2)
    lever = (dR[valid] - np.eye(3)) @ np.asarray(l_b, dtype=np.float64)
    d[valid] = np.add.reduceat(weight[:, None] * velocity, first) - lever
    cov[valid] = np.add.reduceat((weight * total[ping])[:, None, None] * covariance, first)
    return Displacements(d, dR, cov, valid)


def inertial_bend(
    t_ns: TimeArray, velocity_g: FloatArray, ping_t_ns: TimeArray, keyframe_t_ns: TimeArray
) -> FloatArray:
    """What the straight line between pings leaves out of each keyframe interval's way, shape (K - 1, 3), m, in g.

    Between two pings the velocity does not go straight: the accelerometer knows how it bends. At 1 Hz in a turn the
    straight line is 3 % short of the change of velocity. Only the bend is taken: a constant acceleration, and with it
    gravity and the accelerometer's bias, drops out.

    Parameters
    ----------
    t_ns, velocity_g
        Stamps, shape (N,), and the specific force integrated to them in the axes g that do not turn, shape (N, 3), m/s.
    ping_t_ns, keyframe_t_ns
        Shapes (P,) and (K,), increasing.
    """

    def seconds(t: TimeArray) -> FloatArray:
        return np.asarray((t - t_ns[0]) * 1e-9)

    t, pings, keyframes = seconds(t_ns), seconds(ping_t_ns), seconds(keyframe_t_ns)
    way = np.empty((len(keyframes), 3))
    for axis, velocity in enumerate(velocity_g.T):
        bend = velocity - np.interp(t, pings, np.interp(pings, t, velocity))
        bend[(t < pings[0]) | (t > pings[-1])] = 0.0
        so_far = np.concatenate([[0.0], np.cumsum(0.5 * (bend[1:] + bend[:-1]) * np.diff(t))])
        way[:, axis] = np.interp(keyframes, t, so_far)
    return np.diff(way, axis=0)


def _hat_integral(t_ns: TimeArray, ping: NDArray[np.intp], until_ns: TimeArray) -> FloatArray:
    """Integral [s] until a time of the piecewise-linear function that is 1 at the ping and 0 at all others."""
    left = (t_ns[ping] - t_ns[np.maximum(ping - 1, 0)]) * 1e-9
    right = (t_ns[np.minimum(ping + 1, len(t_ns) - 1)] - t_ns[ping]) * 1e-9
    since = (until_ns - t_ns[ping]) * 1e-9
    rise = np.clip(since + left, 0.0, left)
    fall = np.clip(since, 0.0, right)
    ramp_up = np.divide(rise**2, 2.0 * left, out=np.zeros_like(left), where=left > 0)
    ramp_down = fall - np.divide(fall**2, 2.0 * right, out=np.zeros_like(right), where=right > 0)
    return np.asarray(ramp_up + ramp_down)


@dataclass(frozen=True, eq=False)
class DvlDisplacement(Measurement):
    """Displacement of the body origin between two keyframes; says nothing about the rotation.

    The residual is the translation part of Log(T^-1 T_i^-1 T_j) with T = (dR, d_start). It lives in the axes of the end
    pose, and so does its covariance: dR^T cov_start dR.
    """

    variables = ("Pose3", "Pose3")

    d_start: FloatArray
    """In the axes of pose i, shape (3,), m."""
    dR: FloatArray
    """The gyro's rotation, body j to body i, shape (3, 3)."""
    cov_start: FloatArray
    """Covariance of ``d_start``, shape (3, 3), m^2."""

    def residual(self, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3) -> FloatArray:
        return relative_pose_residual(self.relative_pose, pose_i, pose_j)[3:]

    def jacobians(self, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3) -> tuple[FloatArray, FloatArray]:
        J_i, J_j = relative_pose_jacobians(self.relative_pose, pose_i, pose_j)
        return J_i[3:], J_j[3:]

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gaussian(self._sqrt_information)

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        S = np.zeros((6, 6))
        S[3:, 3:] = self._sqrt_information
        return gtsam.BetweenFactorPose3(keys[0], keys[1], self.relative_pose, robust(gaussian(S), loss))

    @property
    def relative_pose(self) -> gtsam.Pose3:
        """The measured motion as a pose."""
        return gtsam.Pose3(gtsam.Rot3(self.dR), self.d_start)

    @property
    def _sqrt_information(self) -> FloatArray:
        return sqrt_information_of_covariance(self.cov_start) @ self.dR
