"""The floor beneath one camera: a plane through the soundings around the keyframe.

One echo sounder tells the slope along the track, and hardly any across: across, the floor is level with a stated
1-sigma. What the soundings scatter about the plane is the floor's roughness: no second look averages it away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from uwgraph.dive.model import Dive
from uwgraph.seafloor.poses import Poses
from uwgraph.types import BoolArray, FloatArray, TimeArray

WINDOW_NS: Final = 30_000_000_000
"""Soundings of another lap, after more time than this, are another keyframe's."""
REACH: Final = 1.0
"""Width of the weights around the keyframe, in parts of the altitude."""
ALIKE: Final = 0.5
"""Soundings closer than this see the same ups and downs, in parts of the altitude."""
_HUBER: Final = 1.5
_ROUNDS: Final = 5
_STEEPEST: Final = 0.15
"""Rays that meet the floor at a smaller sine than this are too grazing to be placed."""


@dataclass(frozen=True, eq=False)
class Soundings:
    """Where an echo sounder met the floor."""

    t_ns: TimeArray
    """Shape (M,), the dive's clock."""
    points_n: FloatArray
    """Shape (M, 3), m."""
    sigma: FloatArray
    """1-sigma along the beam, shape (M,), m."""
    altitude: FloatArray
    """Along the beam, shape (M,), m."""


@dataclass(frozen=True, eq=False)
class Plane:
    """z = theta . (1, x, y): down of the floor from the body's origin at (north, east) from it."""

    theta: FloatArray
    """Shape (3,): m and slopes."""
    cov: FloatArray
    """Shape (3, 3)."""
    roughness: float
    """1-sigma of the floor about the plane, m."""


def sounded(dive: Dive, poses: Poses, t_ns: TimeArray, used: BoolArray) -> Soundings:
    """The dive's soundings ``used`` with the vehicle's poses at their moments."""
    assert dive.altitude is not None
    stream, rig = dive.altitude.select(used), dive.rig.altitude
    beam_b = rig.l_b + stream.altitude[:, None] * rig.R_bs[:, 2]
    points = np.einsum("mij,mj->mi", poses.R_nb, beam_b) + poses.p_n
    sigma = np.where(np.isfinite(stream.sigma), stream.sigma, rig.sigma)
    good = np.isfinite(points).all(axis=1) & (stream.altitude > 0.0)
    return Soundings(t_ns[good], points[good], sigma[good], stream.altitude[good])


def plane_at(soundings: Soundings, t_ns: int, p_n: FloatArray, slope_sigma: float) -> Plane | None:
    """The plane around a keyframe at ``p_n``; None where there is no sounding near it.

    Weighted least squares with a prior of the slopes, reweighted by Huber's function against echoes of fish.
    """
    first, last = np.searchsorted(soundings.t_ns, [t_ns - WINDOW_NS, t_ns + WINDOW_NS])
    x = soundings.points_n[first:last] - p_n
    if not len(x):
        return None
    away = np.hypot(x[:, 0], x[:, 1])
    reach = REACH * float(np.median(soundings.altitude[first:last]))
    near = away < 3.0 * reach
    if not (away < 2.0 * reach).any():
        return None
    x, weight = x[near], np.exp(-0.5 * (away[near] / reach) ** 2)
    A = np.column_stack([np.ones(len(x)), x[:, :2]])
    prior = np.diag([0.0, slope_sigma**-2, slope_sigma**-2])
    sigma = soundings.sigma[first:last][near]
    crowd = _crowd(x, ALIKE * reach / REACH)
    theta, robust, rough = np.array([np.median(x[:, 2]), 0.0, 0.0]), np.ones(len(x)), 0.0
    for _ in range(_ROUNDS):
        information = weight * robust / (sigma**2 + crowd * rough**2)
        H = A.T @ (information[:, None] * A) + prior
        theta = np.linalg.solve(H, A.T @ (information * x[:, 2]))
        left = x[:, 2] - A @ theta
        scale = 1.4826 * float(np.median(np.abs(left)))
        rough = float(np.sqrt(max(scale**2 - np.median(sigma) ** 2, 0.0)))
        robust = np.minimum(1.0, _HUBER * np.hypot(sigma, rough) / np.maximum(np.abs(left), 1e-12))
    return Plane(theta, np.asarray(np.linalg.inv(H), dtype=np.float64), rough)


def _crowd(x: FloatArray, alike: float) -> float:
    """How many soundings (M, 3) in a row see the same ups and downs."""
    step = np.linalg.norm(np.diff(x[:, :2], axis=0), axis=1)
    return float(np.clip(alike / max(float(np.mean(step)), 1e-6), 1.0, len(x))) if len(step) else 1.0


def meet(
    plane: Plane, rays_b: FloatArray, l_b: FloatArray, R_nb: FloatArray, far: float
) -> tuple[FloatArray, FloatArray]:
    """Where rays (..., 3) from ``l_b`` in the body meet the plane, in the body, m, and the 1-sigma along them (...).

    The 1-sigma is the plane's own, without the floor's roughness. NaN where a ray misses, grazes, or goes farther than
    ``far``.
    """
    d, o = rays_b @ R_nb.T, R_nb @ l_b
    height, slope = plane.theta[0], plane.theta[1:]
    sine = d[..., 2] - d[..., :2] @ slope
    length = (height + slope @ o[:2] - o[2]) / np.where(sine > _STEEPEST, sine, np.nan)
    length = np.where((length > 0.0) & (length < far), length, np.nan)
    at = o + length[..., None] * d
    J = np.concatenate([np.ones_like(at[..., :1]), at[..., :2]], axis=-1)
    variance = np.einsum("...i,ij,...j->...", J, plane.cov, J)
    return l_b + length[..., None] * rays_b, np.sqrt(variance) / sine
