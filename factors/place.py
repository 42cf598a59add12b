"""A relative pose: a place seen again, or any other constraint between two keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from factors.adapter import Loss, Measurement
from factors.lie import FloatArray
from factors.noise import gaussian, robust, sqrt_information_of_covariance


@dataclass(frozen=True, eq=False)
class RelativePose(Measurement):
    """Pose of body j seen from body i: residual Log(T_ij^-1 T_i^-1 T_j)."""

    variables = ("Pose3", "Pose3")

    T_ij: gtsam.Pose3
    """Measured relative pose."""
    cov: FloatArray
    """Covariance in the tangent at ``T_ij`` (rotation, then translation), shape (6, 6); infinite where not measured."""

    def residual(self, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3) -> FloatArray:
        return relative_pose_residual(self.T_ij, pose_i, pose_j)

    def jacobians(self, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3) -> tuple[FloatArray, FloatArray]:
        return relative_pose_jacobians(self.T_ij, pose_i, pose_j)

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gaussian(sqrt_information_of_covariance(self.cov))

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        return gtsam.BetweenFactorPose3(keys[0], keys[1], self.T_ij, robust(self.noise(), loss))


def relative_pose_residual(T_ij: gtsam.Pose3, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3) -> FloatArray:
    """Log(T_ij^-1 T_i^-1 T_j), shape (6,): rotation, then translation in the axes of the end pose."""
    return np.asarray(gtsam.Pose3.Logmap(T_ij.between(pose_i.between(pose_j))))


def relative_pose_jacobians(
    T_ij: gtsam.Pose3, pose_i: gtsam.Pose3, pose_j: gtsam.Pose3
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of :func:`relative_pose_residual` by both poses, shape (6, 6) each."""
    J = np.asarray(gtsam.Pose3.LogmapDerivative(T_ij.between(pose_i.between(pose_j))))
    return -J @ pose_j.between(pose_i).AdjointMap(), J
