"""The unscented transform over a part of a state: for what moves, or tells of, no more than that part.

Sigma points of the whole state lie sqrt(n) sigmas away, so that a filter which remembers 50 places would look at
headings twelve sigmas off. Here they are drawn from the part's own k numbers, P_aa = L L^T, and take the rest of the
state with them as it is correlated; what is not correlated with the part goes through unchanged. On a linear problem
this is the transform of the whole state, at any k.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from uwgraph.filters.roots import lower_root
from uwgraph.filters.state import Belief, Index, State
from uwgraph.filters.unscented import Motion, Residual, Seen, Spread, Weights
from uwgraph.types import FloatArray


@cache
def _weights(spread: Spread, k: int) -> Weights:
    return spread.of(k)


@dataclass(frozen=True, eq=False)
class Points:
    """Sigma points of a part of a belief, whose errors are S u with a unit normal vector u."""

    weights: Weights
    Q: FloatArray
    """Orthonormal: the directions of u that move the part, shape (n, k)."""
    D: FloatArray
    """Tangent vectors of the points, shape (2 k + 1, n)."""

    @classmethod
    def of(cls, belief: Belief, at: Index, spread: Spread) -> Points:
        """Sigma points of the numbers ``at`` of the tangent, shape (k,)."""
        weights = _weights(spread, len(at))
        Q, _ = np.linalg.qr(belief.S[at].T)
        return cls(weights, Q, weights.points @ (belief.S @ Q).T)

    @property
    def others(self) -> FloatArray:
        """Rows of u's covariance in all other directions, shape (n, n)."""
        return np.eye(len(self.Q)) - self.Q @ self.Q.T


def predict(belief: Belief, t_ns: int, at: Index, motion: Motion, noise_rows: FloatArray, spread: Spread) -> Belief:
    """As :func:`unscented.predict`, for a motion that moves the numbers ``at`` and depends on no others."""
    points = Points.of(belief, at, spread)
    moved = motion(belief.x.plus(points.D))
    centre = State(moved.R[0], moved.y[0], moved.rot)
    x = centre.plus(points.weights.mean @ centre.to(moved))
    rows = points.weights.root * x.to(moved)
    return Belief(t_ns, x, lower_root(np.concatenate([rows, points.others @ belief.S.T, noise_rows])))


def see(belief: Belief, at: Index, residual: Residual, spread: Spread) -> Seen:
    """As :func:`unscented.see`, for a residual that depends on no other numbers than ``at``."""
    points = Points.of(belief, at, spread)
    z = residual(belief.x.plus(points.D))
    mean = points.weights.mean @ z
    Z = np.concatenate([points.weights.root * (z - mean), np.zeros((len(belief.S), z.shape[1]))])
    return Seen(mean, Z, np.concatenate([points.weights.rows @ points.Q.T, points.others]))
