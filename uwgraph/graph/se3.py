"""Rigid motions as arrays: poses, their adjoints and logarithms, one row each.

A pose (R, p) takes points of its own axes to those it is seen from. Errors are small motions in the pose's own axes,
rotation before translation (GTSAM's tangent).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from factors.lie import exp_so3, skew
from uwgraph.types import FloatArray, RelativePoses

SMALL_ANGLE = 1e-4


@dataclass(frozen=True, eq=False)
class Poses:
    """N poses."""

    R: FloatArray
    """Shape (N, 3, 3)."""
    p: FloatArray
    """Shape (N, 3), m."""

    @classmethod
    def measured(cls, stream: RelativePoses) -> Poses:
        """The motions of a stream."""
        return cls(exp_so3(stream.rotvec), stream.p)

    def __len__(self) -> int:
        return len(self.p)

    def __getitem__(self, index: Any) -> Poses:
        return Poses(self.R[index], self.p[index])

    def __matmul__(self, other: Poses) -> Poses:
        return Poses(self.R @ other.R, self.p + (self.R @ other.p[..., None])[..., 0])

    def inverse(self) -> Poses:
        R_t = np.swapaxes(self.R, -1, -2)
        return Poses(R_t, -(R_t @ self.p[..., None])[..., 0])

    def to(self, other: Poses) -> Poses:
        """The other poses seen from these."""
        return self.inverse() @ other

    def adjoint(self) -> FloatArray:
        """What turns a small motion in the pose's axes into one in the axes it is seen from, shape (N, 6, 6)."""
        A = np.zeros((*self.p.shape[:-1], 6, 6))
        A[..., :3, :3] = A[..., 3:, 3:] = self.R
        A[..., 3:, :3] = skew(self.p) @ self.R
        return A

    def log(self) -> FloatArray:
        """Rotation vector and translation of the screw that leads here, shape (N, 6): GTSAM's ``Pose3.Logmap``."""
        w = Rotation.from_matrix(self.R).as_rotvec()
        angle = np.linalg.norm(w, axis=-1)
        small = angle < SMALL_ANGLE
        half = np.where(small, SMALL_ANGLE, angle) / 2.0
        bend = np.where(small, 1.0 / 12.0, (1.0 - half / np.tan(half)) / (4.0 * half**2))
        W = skew(w)
        V_inv = np.eye(3) - 0.5 * W + bend[..., None, None] * (W @ W)
        return np.concatenate([w, (V_inv @ self.p[..., None])[..., 0]], axis=-1)


def moved(cov: FloatArray, adjoint: FloatArray) -> FloatArray:
    """Covariances of errors seen from other axes, shape (N, 6, 6)."""
    turned: FloatArray = adjoint @ cov @ np.swapaxes(adjoint, -1, -2)
    return turned
