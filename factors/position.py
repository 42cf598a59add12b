"""A position fix: GNSS, acoustic, gravity matching."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np

from factors.adapter import ArrayMeasurement, Loss, Poses
from factors.lie import FloatArray, skew
from factors.noise import gaussian, robust, sqrt_information_of_covariance


@dataclass(frozen=True, eq=False)
class PositionFix(ArrayMeasurement):
    """Position of an antenna or transponder: p_n + R_nb l_b = p_fix_n."""

    variables = ("Pose3",)

    p_fix_n: FloatArray
    """Measured position in n, shape (3,), m; any finite number along a direction that is not measured."""
    cov: FloatArray
    """Covariance in the axes of ``R_n``, shape (3, 3), m^2; infinite variance where nothing is measured."""
    l_b: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Lever arm from the body origin, shape (3,), m."""
    R_n: FloatArray = field(default_factory=lambda: np.eye(3))
    """Axes of the covariance in n, shape (3, 3): local north, east and down for a fix on the ellipsoid."""

    def residuals(self, poses: Poses) -> FloatArray:
        return np.asarray(poses.p_n + poses.R_nb @ self.l_b - self.p_fix_n)

    def jacobians(self, pose: gtsam.Pose3) -> tuple[FloatArray]:
        R_nb = pose.rotation().matrix()
        return (np.hstack([-R_nb @ skew(self.l_b), R_nb]),)

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gaussian(sqrt_information_of_covariance(self.cov) @ self.R_n.T)

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        return gtsam.GPSFactorArm(keys[0], self.p_fix_n, self.l_b, robust(self.noise(), loss))
