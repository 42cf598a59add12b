"""The direction of the sun (or of anything known in n) seen from the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np

from factors.adapter import ArrayMeasurement, Loss, Poses
from factors.lie import FloatArray, skew
from factors.noise import gaussian, robust, sqrt_information, sqrt_information_of_covariance

ZERO = np.zeros(3)


@dataclass(frozen=True, eq=False)
class SunScatter(ArrayMeasurement):
    """A rank-2 information on the sun's direction in the body, as the optical front ends give it.

    The squared whitened residual s_b^T Lambda s_b, with s_b = R_nb^T s_n, is chi-square with 2 degrees of freedom. It
    is even in s: the sign of the sun must be settled by the front end.
    """

    variables = ("Pose3",)

    information_b: FloatArray
    """Lambda, shape (3, 3), rad^-2; its smallest eigenvalue (along the measured sun) counts as zero."""
    s_n: FloatArray
    """Unit vector to the sun in n, shape (3,)."""

    def residuals(self, poses: Poses) -> FloatArray:
        return np.asarray(self.s_n @ poses.R_nb)

    def jacobians(self, pose: gtsam.Pose3) -> tuple[FloatArray]:
        return (np.hstack([skew(self.residual(pose)), np.zeros((3, 3))]),)

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gaussian(sqrt_information(self.information_b, rank=2))

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        return gtsam.MagPoseFactorPose3(keys[0], ZERO, 1.0, self.s_n, ZERO, robust(self.noise(), loss))


def sun_scatter_factors(
    keys: Sequence[int], information_b: FloatArray, s_n: FloatArray, loss: Loss | None = None
) -> list[gtsam.NonlinearFactor]:
    """:meth:`SunScatter.lowered` for many at once: one observation a key, shapes (N, 3, 3) and (N, 3)."""
    roots = sqrt_information(information_b, rank=2)
    return [
        gtsam.MagPoseFactorPose3(key, ZERO, 1.0, s, ZERO, robust(gaussian(S), loss))
        for key, S, s in zip(keys, roots, s_n, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class Direction(ArrayMeasurement):
    """A measured direction, with elevation and azimuth weighted apart.

    The residual is R_nb d_b along the directions of growing elevation and azimuth at s_n (chordal: a false zero sits at
    180 degrees). The azimuth is the angle about the vertical, so near the zenith it says little.
    """

    variables = ("Pose3",)

    d_b: FloatArray
    """Measured unit vector in the body, shape (3,)."""
    s_n: FloatArray
    """The same direction in n, unit vector, shape (3,)."""
    cov: FloatArray
    """Covariance of elevation and azimuth, shape (2, 2), rad^2; an infinite variance is not measured."""
    down_n: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """Local vertical, unit vector in n, shape (3,)."""

    def residuals(self, poses: Poses) -> FloatArray:
        return np.asarray(poses.R_nb @ self.d_b @ self.tangents_n.T)

    def jacobians(self, pose: gtsam.Pose3) -> tuple[FloatArray]:
        rotation = -self.tangents_n @ pose.rotation().matrix() @ skew(self.d_b)
        return (np.hstack([rotation, np.zeros((2, 3))]),)

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gaussian(self._sqrt_information)

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        reference = gtsam.Unit3(self.s_n)
        S = self._sqrt_information @ self.tangents_n @ reference.basis()
        return gtsam.AttitudeFactorPose3(keys[0], reference, robust(gaussian(S), loss), gtsam.Unit3(self.d_b))

    @property
    def tangents_n(self) -> FloatArray:
        """Unit vectors at s_n towards growing elevation and growing azimuth (clockwise from north), shape (2, 3)."""
        east = skew(self.down_n) @ self.s_n
        azimuth = east / np.linalg.norm(east)
        return np.stack([skew(azimuth) @ self.s_n, azimuth])

    @property
    def _sqrt_information(self) -> FloatArray:
        cos_elevation = np.sqrt(1.0 - (self.down_n @ self.s_n) ** 2)
        S: FloatArray = sqrt_information_of_covariance(self.cov) / np.array([1.0, cos_elevation])
        return S
