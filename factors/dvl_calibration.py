"""DVL displacements with the instrument's scale and misalignment as a variable, all intervals at once.

GTSAM has no native factor for it, and a Python factor per interval would be slow; here one object stands for all of
them: arrays in, whitened Jacobian factors out. It serves a solver that linearises by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from factors.adapter import Loss, Measurement
from factors.lie import FloatArray, skew

CALIBRATION_DIM = 4
"""Scale error, then misalignment about the body's x, y and z axes [rad]."""


@dataclass(frozen=True, eq=False)
class CalibratedDisplacement(Measurement):
    """One interval: R_i^T (p_j - p_i) = d_start + G c with c = (scale error, misalignment).

    The residual lives in the axes of pose i.
    """

    variables = ("Pose3", "Pose3", "Vector")

    d_start: FloatArray
    """Displacement of the body origin in the axes of pose i, shape (3,), m."""
    G: FloatArray
    """Its derivative by c, shape (3, 4)."""
    cov_start: FloatArray
    """Covariance of ``d_start``, shape (3, 3), m^2."""

    def residual(self, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3, c: FloatArray) -> FloatArray:
        return np.asarray(pose_i.transformTo(pose_j.translation()) - self.d_start - self.G @ c)

    def jacobians(
        self, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3, c: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        seen = pose_i.transformTo(pose_j.translation())
        R_ij = pose_i.rotation().matrix().T @ pose_j.rotation().matrix()
        return np.hstack([skew(seen), -np.eye(3)]), np.hstack([np.zeros((3, 3)), R_ij]), -self.G

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Gaussian.Covariance(self.cov_start)

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        """The reference itself: no native factor equals it. Its fast form is :class:`CalibratedDisplacements`."""
        return self.reference(keys, loss)


@dataclass(frozen=True, eq=False)
class CalibratedDisplacements:
    """All intervals of a dive, with a Huber loss of the given width (infinite: none)."""

    keys_i: Sequence[int]
    keys_j: Sequence[int]
    key_c: int
    d_start: FloatArray
    """Shape (K, 3), m."""
    G: FloatArray
    """Shape (K, 3, 4)."""
    cov_start: FloatArray
    """Shape (K, 3, 3), m^2."""
    width: float = np.inf
    """Whitened norm at which the loss turns linear."""

    def __len__(self) -> int:
        return len(self.keys_i)

    def measurement(self, k: int) -> CalibratedDisplacement:
        """Interval ``k`` as a measurement, without the loss."""
        return CalibratedDisplacement(self.d_start[k], self.G[k], self.cov_start[k])

    def error(self, values: gtsam.Values) -> float:
        """Sum of the losses: half the squared whitened norm, linear beyond the width (as GTSAM counts it)."""
        norm = np.linalg.norm(self._whitened(values)[0], axis=1)
        if np.isinf(self.width):
            return float(0.5 * (norm**2).sum())
        inner = np.minimum(norm, self.width)
        return float((inner * (norm - 0.5 * inner)).sum())

    def linearize(self, values: gtsam.Values) -> list[gtsam.JacobianFactor]:
        """Whitened Jacobian factors at ``values``, one an interval."""
        r, seen, R_ij, S = self._whitened(values)
        norm = np.maximum(np.linalg.norm(r, axis=1), 1e-300)
        root = np.sqrt(np.minimum(1.0, self.width / norm))[:, None, None]
        S = S * root
        K = len(self)
        A_i = np.empty((K, 3, 6))
        A_i[:, :, :3] = S @ skew(seen)
        A_i[:, :, 3:] = -S
        A_j = np.zeros((K, 3, 6))
        A_j[:, :, 3:] = S @ R_ij
        A_c = -S @ self.G
        b = -r * root[:, :, 0]
        unit = gtsam.noiseModel.Unit.Create(3)
        return [
            gtsam.JacobianFactor(i, a, j, e, self.key_c, c, y, unit)
            for i, a, j, e, c, y in zip(self.keys_i, A_i, self.keys_j, A_j, A_c, b, strict=True)
        ]

    def _whitened(self, values: gtsam.Values) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Whitened residuals (K, 3), p_j in the axes of i (K, 3), R_ij and the roots of the information (K, 3, 3)."""
        c = values.atVector(self.key_c)
        R_i, p_i = _poses(values, self.keys_i)
        R_j, p_j = _poses(values, self.keys_j)
        R_t = np.swapaxes(R_i, 1, 2)
        seen = (R_t @ (p_j - p_i)[:, :, None])[..., 0]
        S = np.linalg.inv(np.linalg.cholesky(self.cov_start))
        residual = seen - self.d_start - self.G @ c
        return (S @ residual[:, :, None])[..., 0], seen, R_t @ R_j, S


def _poses(values: gtsam.Values, keys: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    T = np.array([values.atPose3(k).matrix() for k in keys])
    return T[:, :3, :3], T[:, :3, 3]
