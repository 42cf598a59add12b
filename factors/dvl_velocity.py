"""A single Doppler velocity, for filters: what a smoother takes as a displacement between keyframes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np

from factors.adapter import ArrayMeasurement, Poses
from factors.lie import FloatArray, skew
from factors.noise import gaussian, sqrt_information_of_covariance


@dataclass(frozen=True, eq=False)
class DvlVelocity(ArrayMeasurement):
    """Velocity of the instrument over the ground, in body axes.

    (1 + s) (I + [m]x) u = v_b, with u = R_nb^T v_n + (w_b - b_gyro - R_nb^T omega_n) x l_b and the calibration
    c = (s, m) of :class:`factors.CalibratedDisplacement`.
    """

    variables = ("Pose3", "Vector", "ConstantBias", "Vector")

    v_b: FloatArray
    """Measured, shape (3,), m/s."""
    cov_b: FloatArray
    """Shape (3, 3), (m/s)^2."""
    w_b: FloatArray
    """Angular rate of the gyro at that moment, shape (3,), rad/s."""
    l_b: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Lever arm from the body origin to the instrument, shape (3,), m."""
    earth_rate_n: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Rotation of n, shape (3,), rad/s."""

    def residuals(self, poses: Poses, v_n: FloatArray, bias: FloatArray, c: FloatArray) -> FloatArray:
        u = self._velocity(poses, v_n, bias)
        return np.asarray((1.0 + c[:, :1]) * u + np.cross(c[:, 1:], u) - self.v_b)

    def jacobians(
        self, pose: gtsam.Pose3, v_n: FloatArray, bias: gtsam.imuBias.ConstantBias, c: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        R_bn = pose.rotation().matrix().T
        u = self._velocity(Poses(R_bn.T[None], np.zeros((1, 3))), v_n[None], bias.vector()[None])[0]
        A = (1.0 + c[0]) * np.eye(3) + skew(c[1:])
        L = skew(self.l_b)
        zero = np.zeros((3, 3))
        return (
            A @ np.hstack([skew(R_bn @ v_n) + L @ skew(R_bn @ self.earth_rate_n), zero]),
            A @ R_bn,
            A @ np.hstack([zero, L]),
            np.column_stack([u, -skew(u)]),
        )

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gaussian(sqrt_information_of_covariance(self.cov_b))

    def _velocity(self, poses: Poses, v_n: FloatArray, bias: FloatArray) -> FloatArray:
        """u, shape (M, 3)."""
        R_bn = np.swapaxes(poses.R_nb, 1, 2)
        u: Any = (R_bn @ v_n[:, :, None])[..., 0]
        if self.l_b.any():
            u = u + np.cross(self.w_b - bias[:, 3:] - R_bn @ self.earth_rate_n, self.l_b)
        return np.asarray(u)
