"""Graduated non-convexity: the trajectory and which closures it can believe, together.

Truncated least squares (Yang, Antonante, Tzoumas & Carlone, RA-L 2020, eqs. 13 to 15): every closure has a weight; the
cost is convex at first and becomes, as mu grows, the one that cuts off beyond the limit. The weights scale the noise of
native factors; the odometry is never weighted. It begins from the fit to all closures, and is over at once where they
all fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from scipy.stats import chi2

from uwgraph.graph.builder import Problem
from uwgraph.graph.relative import BetweenKeyframes, sqrt_information
from uwgraph.graph.se3 import Poses
from uwgraph.graph.solver import Solved
from uwgraph.types import FloatArray

IndexArray = NDArray[np.intp]

MU_GROWTH = 1.4
MAX_STEPS = 30


@dataclass(frozen=True, eq=False)
class Graduated:
    """Where it ended."""

    problem: Problem
    """With the closures as they are weighted in the end."""
    solved: Solved
    weight: FloatArray
    """0 or 1, shape (N,)."""
    chi2: FloatArray
    """Squared whitened residuals at the end, shape (N,)."""


def graduate(
    problem: Problem,
    values: gtsam.Values,
    closures: BetweenKeyframes,
    inliers: float,
    solve: Callable[[Problem], Solved],
) -> Graduated:
    """Solve a problem with closures, leaving out those that fit worse than the quantile ``inliers``."""
    root = sqrt_information(closures.cov)
    limit = chi2.ppf(inliers, np.maximum(np.any(root != 0.0, axis=2).sum(axis=1), 1))

    def fit(weight: FloatArray, values: gtsam.Values) -> tuple[Problem, Solved, FloatArray]:
        weighted = problem.plus("closures", closures.select(weight > 0.0).factors(weight[weight > 0.0]), values)
        solved = solve(weighted)
        return weighted, solved, squared_residuals(solved.values, closures)

    weight = np.ones(len(closures))
    weighted, solved, d2 = fit(weight, values)
    misfit = d2 / limit
    if misfit.max() > 1.0:
        mu = 1.0 / (2.0 * misfit.max() - 1.0)
        for _ in range(MAX_STEPS):
            weight = truncated_weight(misfit, mu)
            weighted, solved, d2 = fit(weight, solved.values)
            misfit = d2 / limit
            if np.isin(weight, (0.0, 1.0)).all() and np.array_equal(weight == 1.0, misfit <= 1.0):
                break
            mu *= MU_GROWTH
        weight = np.where(misfit <= 1.0, 1.0, 0.0)
        weighted, solved, d2 = fit(weight, solved.values)
    return Graduated(weighted, solved, weight, d2)


def truncated_weight(misfit: FloatArray, mu: float) -> FloatArray:
    """Weights of truncated least squares at squared residuals over their limit."""
    between = np.sqrt(mu * (mu + 1.0) / np.maximum(misfit, 1e-12)) - mu
    weight: FloatArray = np.where(misfit >= (mu + 1.0) / mu, 0.0, np.where(misfit <= mu / (mu + 1.0), 1.0, between))
    return np.clip(weight, 0.0, 1.0)


def squared_residuals(values: gtsam.Values, closures: BetweenKeyframes) -> FloatArray:
    """Squared Mahalanobis distance of every closure from a trajectory, shape (N,)."""
    seen = poses_of(values, closures.i).to(poses_of(values, closures.j))
    e = closures.T.to(seen).log()
    d2: FloatArray = np.sum((sqrt_information(closures.cov) @ e[:, :, None])[..., 0] ** 2, axis=1)
    return d2


def poses_of(values: gtsam.Values, keyframes: IndexArray) -> Poses:
    """Poses of keyframes in n."""
    T = np.array([values.atPose3(X(k)).matrix() for k in keyframes.tolist()])
    return Poses(T[:, :3, :3], T[:, :3, 3])
