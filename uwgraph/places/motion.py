"""What a pair of images says: the motion of the body, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from gtsam import Rot3
from numpy.typing import NDArray

from uwgraph.places.plane import Geometry
from uwgraph.types import NOT_MEASURED, FloatArray, RelativePoses

SEEN: Final = 4.0
"""A translation shorter than this many of its own 1-sigma has no direction."""

CONTRADICTION: Final = 4.0
"""The motion and what else is known of the pair contradict each other at more sigma than this."""
TURNS_OTHERWISE: Final = "turns otherwise than the gyro"
NOT_WHERE_SOUNDED: Final = "the scale is not plausible: the floor is not where the echo sounder says"

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Motion:
    """Pose of the body at the second moment seen from the body at the first."""

    p: FloatArray
    """Shape (3,), m, in the axes of the first; of length one where no scale was known."""
    rotvec: FloatArray
    """Shape (3,), rad."""
    cov: FloatArray
    """Tangent at the pose (rotation, translation, axes of the second), shape (6, 6)."""
    accepted: bool
    reason: str
    """How it was found, or why not."""
    seen_a: IndexArray = field(default_factory=lambda: np.zeros(0, np.intp))
    """The features of the first view that agree, shape (inliers,)."""
    seen_b: IndexArray = field(default_factory=lambda: np.zeros(0, np.intp))
    """Those of the second view, in the same order."""
    geometry: Geometry | None = None
    """What the cameras saw."""
    parallax: float = 0.0
    """Median way of the points through the image that is due to the translation, pixels."""
    flow: float = 0.0
    """Median way of the points through the image, pixels."""
    metric: bool = False
    """Whether the scale is known."""

    @property
    def inliers(self) -> int:
        """How many points agree."""
        return len(self.seen_a)

    def refused(self, reason: str) -> Motion:
        """The same, not accepted."""
        return replace(self, accepted=False, reason=reason)

    @property
    def position_sigma(self) -> float:
        """1-sigma of the translation along its worst direction, m."""
        return float(np.sqrt(np.linalg.eigvalsh(self.cov[3:, 3:])[-1]))

    @property
    def rotation_sigma(self) -> float:
        """1-sigma of the rotation about its worst axis, rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.cov[:3, :3])[-1]))


def failed(reason: str) -> Motion:
    """No motion."""
    return Motion(np.zeros(3), np.zeros(3), NOT_MEASURED * np.eye(6), False, reason)


def motion_in_body(g: Geometry, cov: FloatArray, l_b: FloatArray, metric: bool) -> tuple[FloatArray, FloatArray]:
    """Translation of the body's origin (3,) and the covariance (6, 6) of the pose in GTSAM's tangent.

    ``cov`` is that of (small rotation in the axes of b, c). Where the scale is not known, c gets length one and the
    variance :data:`NOT_MEASURED` along it; in all directions where even its direction is within its noise.
    """
    c = g.c
    unknown = np.zeros((3, 3))
    if not metric:
        length = float(np.linalg.norm(c))
        directed = length > SEEN * float(np.sqrt(np.trace(cov[3:, 3:])))
        unit = np.diag(np.r_[np.ones(3), np.full(3, 1.0 / max(length, 1e-12) if directed else 1.0)])
        cov, c = unit @ cov @ unit, c / length if directed else c
        unknown = NOT_MEASURED * (np.outer(c, c) if directed else np.eye(3))
    p = c + l_b - g.R @ l_b
    T = np.zeros((6, 6))
    T[:3, :3] = np.eye(3)
    T[3:, :3] = np.cross(np.eye(3), l_b)  # R l moves by R (theta x l)
    T[3:, 3:] = g.R.T
    full = T @ cov @ T.T
    full[3:, 3:] += g.R.T @ unknown @ g.R
    return p, 0.5 * (full + full.T)


def rotation_vector(R: FloatArray) -> FloatArray:
    """Rotation vector (3,) of a matrix (3, 3)."""
    return np.asarray(Rot3.Logmap(Rot3(R)))


def relative_poses(moments: list[tuple[int, int]], motions: list[Motion]) -> RelativePoses:
    """Motions between (from_ns, t_ns) as a stream, in the order of t_ns."""
    times = np.array(moments, dtype=np.int64).reshape(-1, 2)
    order = np.lexsort((times[:, 0], times[:, 1]))
    rows = [motions[i] for i in order]
    return RelativePoses(
        t_ns=times[order, 1],
        from_ns=times[order, 0],
        p=np.array([m.p for m in rows]).reshape(-1, 3),
        rotvec=np.array([m.rotvec for m in rows]).reshape(-1, 3),
        cov=np.array([m.cov for m in rows]).reshape(-1, 6, 6),
        accepted=np.array([m.accepted for m in rows], dtype=np.bool_),
        reason=np.array([m.reason for m in rows], dtype=np.str_),
        inliers=np.array([m.inliers for m in rows], dtype=np.int64),
    )
