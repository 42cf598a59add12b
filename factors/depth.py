"""Depth below the sea surface, along the vertical of the place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import gsw
import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.adapter import ArrayMeasurement, Loss, Poses
from factors.lie import FloatArray, skew
from factors.noise import gaussian, robust

STANDARD_ATMOSPHERE = 101_325.0


def depth_from_pressure(
    pressure: ArrayLike, lat: ArrayLike, surface_pressure: float = STANDARD_ATMOSPHERE
) -> FloatArray:
    """Depth [m] of absolute pressure [Pa] at latitude [rad] (TEOS-10, standard sea water).

    Parameters
    ----------
    surface_pressure
        Pressure of the air at the surface, Pa; 0 when the sensor already reads gauge pressure.
    """
    decibar = (np.asarray(pressure, dtype=np.float64) - surface_pressure) * 1e-4
    return np.asarray(-gsw.z_from_p(decibar, np.degrees(lat)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Depth(ArrayMeasurement):
    """Depth of a sensor, linearised about a place nearby.

    down_n . (p_n + R_nb l_b - p_ref_n) = depth - depth_ref. The surface being curved, a reference x metres away
    horizontally costs x^2 / 2R of depth: 0.8 mm at 100 m.
    """

    variables = ("Pose3",)

    depth: float
    """Measured depth of the sensor, m, positive down."""
    sigma: float
    """1-sigma, m."""
    down_n: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """Local vertical at the reference place, unit vector in n, shape (3,)."""
    p_ref_n: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Reference place in n, shape (3,), m."""
    depth_ref: float = 0.0
    """Depth of the reference place, m."""
    l_b: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Lever arm from the body origin to the sensor, shape (3,), m."""

    def residuals(self, poses: Poses) -> FloatArray:
        p = poses.p_n + poses.R_nb @ self.l_b
        return np.asarray((p - self.p_ref_n) @ self.down_n - (self.depth - self.depth_ref))[:, None]

    def jacobians(self, pose: gtsam.Pose3) -> tuple[FloatArray]:
        down_b = self.down_n @ pose.rotation().matrix()
        return (np.concatenate([-down_b @ skew(self.l_b), down_b])[None],)

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Isotropic.Sigma(1, self.sigma)

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        S = np.zeros((3, 3))
        S[0] = self.down_n / self.sigma
        point = self.p_ref_n + self.down_n * (self.depth - self.depth_ref)
        return gtsam.GPSFactorArm(keys[0], point, self.l_b, robust(gaussian(S), loss))
