"""DVL displacements with the instrument's scale and misalignment as a variable, all intervals at once.

GTSAM has no native factor for it, and a Python factor per interval would be slow; here one object stands for all of
them: arrays in, whitened Jacobian factors out. It serves a solver that linearises by itself.

The calibration multiplies the displacement that the poses say, not the measured one: the noise of the measured one
would otherwise pull the scale down (errors in variables), by 0.4 % on a MEMS dive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import gtsam
import numpy as np

from factors.adapter import Loss, Measurement
from factors.lie import FloatArray, skew


class ScalarLoss(Protocol):
    """A robust loss of GTSAM, as its concrete classes show it."""

    def loss(self, distance: float, /) -> float: ...
    def weight(self, distance: float, /) -> float: ...


CALIBRATION_DIM = 4
"""Scale error, then misalignment about the body's x, y and z axes [rad]."""


@dataclass(frozen=True, eq=False)
class CalibratedDisplacement(Measurement):
    """One interval: (1 + s) q + (R_mid m) x q = d_start, with q the way of the DVL in the axes of pose i.

    q = R_i^T (p_j - p_i) + lever. The calibration c = (s, m) says that the instrument reads (1 + s) (I + [m]x) v where
    the velocity is v. The residual lives in the axes of pose i.
    """

    variables = ("Pose3", "Pose3", "Vector")

    d_start: FloatArray
    """Displacement of the DVL as measured, in the axes of pose i, shape (3,), m."""
    lever: FloatArray
    """Way of the DVL around the body origin, (dR - I) l_b, shape (3,), m."""
    R_mid: FloatArray
    """Rotation of the body half way to the body at the start, shape (3, 3)."""
    cov_start: FloatArray
    """Covariance of ``d_start``, shape (3, 3), m^2."""

    def residual(self, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3, c: FloatArray) -> FloatArray:
        q = pose_i.transformTo(pose_j.translation()) + self.lever
        return np.asarray((1.0 + c[0]) * q + np.cross(self.R_mid @ c[1:], q) - self.d_start)

    def jacobians(
        self, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3, c: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        seen = pose_i.transformTo(pose_j.translation())
        q = seen + self.lever
        R_ij = pose_i.rotation().matrix().T @ pose_j.rotation().matrix()
        A = (1.0 + c[0]) * np.eye(3) + skew(self.R_mid @ c[1:])
        return (
            A @ np.hstack([skew(seen), -np.eye(3)]),
            A @ np.hstack([np.zeros((3, 3)), R_ij]),
            np.column_stack([q, -skew(q) @ self.R_mid]),
        )

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Gaussian.Covariance(self.cov_start)

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        """The reference itself: no native factor equals it. Its fast form is :class:`CalibratedDisplacements`."""
        return self.reference(keys, loss)


@dataclass(frozen=True, eq=False)
class CalibratedDisplacements:
    """All intervals of a dive, under one robust loss."""

    keys_i: Sequence[int]
    keys_j: Sequence[int]
    key_c: int
    d_start: FloatArray
    """Shape (K, 3), m."""
    lever: FloatArray
    """Shape (K, 3), m."""
    R_mid: FloatArray
    """Shape (K, 3, 3)."""
    cov_start: FloatArray
    """Shape (K, 3, 3), m^2."""
    loss: ScalarLoss | None = None

    def __len__(self) -> int:
        return len(self.keys_i)

    def measurement(self, k: int) -> CalibratedDisplacement:
        """Interval ``k`` as a measurement, without the loss."""
        return CalibratedDisplacement(self.d_start[k], self.lever[k], self.R_mid[k], self.cov_start[k])

    def error(self, values: gtsam.Values) -> float:
        """Sum of the losses of the whitened norms, as GTSAM counts it; without a loss half their squares."""
        r, *_ = self._terms(values)
        norm = np.linalg.norm(self._root @ r[:, :, None], axis=(1, 2))
        if self.loss is None:
            return float(0.5 * norm @ norm)
        return float(sum(map(self.loss.loss, norm.tolist())))

    def linearize(self, values: gtsam.Values) -> list[gtsam.JacobianFactor]:
        """Whitened Jacobian factors at ``values``, one an interval."""
        r, seen, R_ij, A = self._terms(values)
        q = seen + self.lever
        S = self._root
        if self.loss is not None:
            norm = np.linalg.norm(S @ r[:, :, None], axis=(1, 2))
            S = S * np.sqrt(list(map(self.loss.weight, norm.tolist())))[:, None, None]
        SA = S @ A
        J_i = np.concatenate([SA @ skew(seen), -SA], axis=2)
        J_j = np.concatenate([np.zeros_like(SA), SA @ R_ij], axis=2)
        J_c = S @ np.concatenate([q[:, :, None], -skew(q) @ self.R_mid], axis=2)
        b = -(S @ r[:, :, None])[..., 0]
        unit = gtsam.noiseModel.Unit.Create(3)
        return [
            gtsam.JacobianFactor(i, a, j, e, self.key_c, c, y, unit)
            for i, a, j, e, c, y in zip(self.keys_i, J_i, self.keys_j, J_j, J_c, b, strict=True)
        ]

    @cached_property
    def _root(self) -> FloatArray:
        """Square roots of the information, shape (K, 3, 3)."""
        root: FloatArray = np.linalg.inv(np.linalg.cholesky(self.cov_start))
        return root

    def _terms(self, values: gtsam.Values) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Residuals (K, 3), p_j seen from pose i (K, 3), R_ij and d residual / d seen, (K, 3, 3) each."""
        c = values.atVector(self.key_c)
        R_i, p_i = _poses(values, self.keys_i)
        R_j, p_j = _poses(values, self.keys_j)
        R_t = np.swapaxes(R_i, 1, 2)
        seen = (R_t @ (p_j - p_i)[:, :, None])[..., 0]
        A = (1.0 + c[0]) * np.eye(3) + skew(self.R_mid @ c[1:])
        return (A @ (seen + self.lever)[:, :, None])[..., 0] - self.d_start, seen, R_t @ R_j, A


def _poses(values: gtsam.Values, keys: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    T = np.array([values.atPose3(k).matrix() for k in keys])
    return T[:, :3, :3], T[:, :3, 3]
