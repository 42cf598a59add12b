"""Heading against true north."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np

from factors.adapter import ArrayMeasurement, Loss, Poses
from factors.lie import FloatArray, skew
from factors.noise import gaussian, robust

FORWARD_B = np.array([1.0, 0.0, 0.0])
FORWARD_UNIT3 = gtsam.Unit3(FORWARD_B)


@dataclass(frozen=True, eq=False)
class Heading(ArrayMeasurement):
    """Heading of the body's x axis: the axis has no component along the horizontal direction right of the heading.

    The residual is cos(pitch) sin(heading error). Pitch and roll are left alone (precision exactly zero). A false zero
    sits at 180 degrees: the initial heading must be right within 90.
    """

    variables = ("Pose3",)

    heading: float
    """Measured heading clockwise from true north, rad."""
    sigma: float
    """1-sigma of the heading, rad."""
    pitch: float = 0.0
    """Approximate pitch of the body, rad: scales the residual back to an angle."""
    R_n_local: FloatArray = field(default_factory=lambda: np.eye(3))
    """Axes of the local north, east and down in n, shape (3, 3); the identity at the origin of the dive."""

    def residuals(self, poses: Poses) -> FloatArray:
        return np.asarray(poses.R_nb[:, :, 0] @ self.right_n)[:, None]

    def jacobians(self, pose: gtsam.Pose3) -> tuple[FloatArray]:
        rotation = -self.right_n @ pose.rotation().matrix() @ skew(FORWARD_B)
        return (np.concatenate([rotation, np.zeros(3)])[None],)

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Isotropic.Sigma(1, self.sigma * np.cos(self.pitch))

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        # The attitude factor's two rows are B^T R_nb e_x in the basis B of its reference, which flips at due north:
        # picking our direction out of B needs no knowledge of which row is which.
        reference = gtsam.Unit3(self.R_n_local @ np.array([np.cos(self.heading), np.sin(self.heading), 0.0]))
        S = np.zeros((2, 2))
        S[0] = self.right_n @ reference.basis() / (self.sigma * np.cos(self.pitch))
        return gtsam.AttitudeFactorPose3(keys[0], reference, robust(gaussian(S), loss), FORWARD_UNIT3)

    @property
    def right_n(self) -> FloatArray:
        """The horizontal direction 90 degrees clockwise of the measured heading, unit vector in n, shape (3,)."""
        right: FloatArray = self.R_n_local @ np.array([-np.sin(self.heading), np.cos(self.heading), 0.0])
        return right
