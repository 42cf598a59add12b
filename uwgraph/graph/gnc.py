"""Graduated non-convexity: the trajectory and which closures it can believe, together.

Truncated least squares (Yang, Antonante, Tzoumas & Carlone, RA-L 2020, eqs. 13 to 15): every closure has a weight, and
the cost goes from a convex one to the one that cuts off beyond the limit. The odometry is never weighted. Where all
closures fit the trajectory that they make, that is all. Else the weights are found in the linear graph of the closures'
ends about it, where a step costs milliseconds, and the whole trajectory is solved again with those that are left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from scipy.linalg import solve as solve_dense
from scipy.sparse import bsr_array

from uwgraph.chi_square import chi2_quantile
from uwgraph.graph.builder import Problem
from uwgraph.graph.joint import joint_poses
from uwgraph.graph.relative import BetweenKeyframes, sqrt_information
from uwgraph.graph.se3 import Poses
from uwgraph.graph.solver import Solved
from uwgraph.types import BoolArray, FloatArray

IndexArray = NDArray[np.intp]

MU_GROWTH = 1.4
MAX_STEPS = 100
MAX_SOLUTIONS = 5


@dataclass(frozen=True, eq=False)
class Graduated:
    """Where it ended."""

    problem: Problem
    """With the closures that are believed."""
    solved: Solved
    weight: FloatArray
    """0 or 1, shape (N,)."""


def graduate(
    problem: Problem,
    values: gtsam.Values,
    closures: BetweenKeyframes,
    inliers: float,
    solve: Callable[[Problem], Solved],
) -> Graduated:
    """Solve a problem with closures, leaving out those that fit worse than the quantile ``inliers``.

    ``solve`` solves a problem from its own first guess.
    """
    limit = chi2_quantile(inliers, np.maximum(np.any(sqrt_information(closures.cov) != 0.0, axis=2).sum(axis=1), 1))

    def fit(believed: BoolArray) -> tuple[Problem, Solved]:
        weighted = problem.plus("closures", closures.select(believed).factors(), values)
        return weighted, solve(weighted)

    believed = np.ones(len(closures), dtype=np.bool_)
    weighted, solved = fit(believed)
    for _ in range(MAX_SOLUTIONS):
        if np.array_equal(believed, squared_residuals(solved.values, closures) <= limit):
            break
        values, before = solved.values, believed
        believed = LinearClosures.at(problem, values, closures).inliers(limit)
        if np.array_equal(believed, before):
            break
        weighted, solved = fit(believed)
    return Graduated(weighted, solved, believed.astype(np.float64))


@dataclass(frozen=True, eq=False)
class LinearClosures:
    """Closures in the linear graph of their ends: whitened residuals b + A u, with u ~ N(0, P) from the odometry."""

    b: FloatArray
    """Where the odometry alone would have them, shape (6 N,)."""
    M: FloatArray
    """A P A^T, shape (6 N, 6 N)."""

    @classmethod
    def at(cls, problem: Problem, values: gtsam.Values, closures: BetweenKeyframes) -> LinearClosures:
        """About a trajectory; ``problem`` is that without closures."""
        ends, place = np.unique(np.concatenate([closures.i, closures.j]), return_inverse=True)
        i, j = place.reshape(2, -1)
        odometry = joint_poses(problem, values, ends.tolist())
        seen = poses_of(values, closures.i).to(poses_of(values, closures.j))
        S = sqrt_information(closures.cov)
        by_i, by_j = -S @ seen.inverse().adjoint(), S
        A = _blocks(by_i, i, len(ends)) + _blocks(by_j, j, len(ends))
        P = odometry.cov.swapaxes(1, 2).reshape(6 * len(ends), -1)
        e = closures.T.to(seen).log()
        return cls((S @ e[:, :, None]).ravel() + A @ odometry.mean.ravel(), A @ (A @ P).T)

    def inliers(self, limit: FloatArray) -> BoolArray:
        """Closures that truncated least squares believes, mask of shape (N,)."""
        misfit = self.squared_residuals(np.ones(len(limit))) / limit
        mu = 1.0 / max(2.0 * float(misfit.max()) - 1.0, 1.0)
        for _ in range(MAX_STEPS):
            weight = truncated_weight(misfit, mu)
            misfit = self.squared_residuals(weight) / limit
            if np.isin(weight, (0.0, 1.0)).all():
                break
            mu *= MU_GROWTH
        believed: BoolArray = weight > 0.5
        return believed

    def squared_residuals(self, weight: FloatArray) -> FloatArray:
        """Of the least-squares solution with these weights: r = (I + M W)^-1 b, shape (N,)."""
        root = np.sqrt(np.repeat(weight, 6))
        z = solve_dense(np.eye(len(root)) + root[:, None] * self.M * root, root * self.b, assume_a="pos")
        r = self.b - self.M @ (root * z)
        squared: FloatArray = np.sum(r.reshape(-1, 6) ** 2, axis=1)
        return squared


def _blocks(each: FloatArray, column: IndexArray, columns: int) -> bsr_array:
    """One 6x6 block a row, shape (6 N, 6 columns)."""
    rows = np.arange(len(each) + 1)
    return bsr_array((each, column, rows), shape=(6 * len(each), 6 * columns))


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
