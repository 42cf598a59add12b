"""The unscented transform on a manifold, in square-root form.

Sigma points are drawn afresh from every covariance, so also after the process noise went in: with points of the
propagated covariance alone a linear problem would not give the Kalman filter (Julier & Uhlmann 2004; Wan & van der
Merwe 2001; on manifolds Hertzberg et al. 2013).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from uwgraph.filters.roots import Conditioned, condition, lower_root, solve_lower
from uwgraph.filters.state import Belief, State
from uwgraph.types import FloatArray

Motion = Callable[[State], State]
"""Moves M states at once."""
Residual = Callable[[State], FloatArray]
"""Residuals of M states at once, prediction minus measurement, shape (M, m)."""


@dataclass(frozen=True)
class Spread:
    """How far sigma points lie from the mean: the usual alpha, beta and kappa.

    With alpha = 1, beta = 2 and kappa = 0 no weight is negative, for any number of states. Where others make the weight
    of the centre in the covariance negative it counts as zero: the covariance is then too large by the square of the
    second-order term, and stays a covariance.
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def of(self, n: int) -> Weights:
        return Weights(n, self)


@dataclass(frozen=True)
class Weights:
    """The spread for n states."""

    n: int
    spread: Spread

    @cached_property
    def scale(self) -> float:
        """sqrt(n + lambda)."""
        return float(self.spread.alpha * np.sqrt(self.n + self.spread.kappa))

    @cached_property
    def mean(self) -> FloatArray:
        """Shape (2 n + 1,)."""
        W = np.full(2 * self.n + 1, 0.5 / self.scale**2)
        W[0] = 1.0 - self.n / self.scale**2
        return W

    @cached_property
    def root(self) -> FloatArray:
        """Square roots of the weights of the covariance, shape (2 n + 1, 1)."""
        W = self.mean.copy()
        W[0] = max(W[0] + 1.0 - self.spread.alpha**2 + self.spread.beta, 0.0)
        return np.sqrt(W)[:, None]

    @cached_property
    def points(self) -> FloatArray:
        """The sigma points of a unit normal vector, shape (2 n + 1, n): zero, plus and minus the axes."""
        axes = self.scale * np.eye(self.n)
        return np.vstack([np.zeros((1, self.n)), axes, -axes])

    @cached_property
    def rows(self) -> FloatArray:
        """The same, weighted: rows^T rows is the unit matrix."""
        return self.root * self.points

    def deviations(self, S: FloatArray) -> FloatArray:
        """Tangent vectors of the sigma points along the first n columns of a root, shape (2 n + 1, size)."""
        D: FloatArray = self.points @ S[:, : self.n].T
        return D


def predict(belief: Belief, t_ns: int, motion: Motion, noise_rows: FloatArray, weights: Weights) -> Belief:
    """The belief after a motion with additive noise, whose covariance is noise_rows^T noise_rows."""
    x, E = _moved(belief, motion, weights)
    return Belief(t_ns, x, lower_root(np.concatenate([E, noise_rows])))


def predict_and_carry(
    belief: Belief, t_ns: int, motion: Motion, noise_rows: FloatArray, weights: Weights
) -> tuple[Belief, FloatArray]:
    """:func:`predict`, and what carries correlations along: G = E[u u'^T].

    u and u' are the unit normal vectors before and after, of which the state's errors are S u and S' u'.
    """
    x, E = _moved(belief, motion, weights)
    S = lower_root(np.concatenate([E, noise_rows]))
    n = weights.n
    carried = solve_lower(S, (weights.root[1, 0] * weights.scale) * (E[1 : n + 1] - E[n + 1 :]).T)
    return Belief(t_ns, x, S), carried.T


def _moved(belief: Belief, motion: Motion, weights: Weights) -> tuple[State, FloatArray]:
    """Mean of the moved sigma points, and their weighted deviations from it, shape (2 n + 1, size)."""
    moved = motion(belief.x.plus(weights.deviations(belief.S)))
    centre = State(moved.R[0], moved.y[0], moved.rot)
    x = centre.plus(weights.mean @ centre.to(moved))
    return x, weights.root * x.to(moved)


@dataclass(frozen=True, eq=False)
class Seen:
    """A measurement as a belief sees it: what does not depend on its noise."""

    mean: FloatArray
    """Mean residual, prediction minus measurement, shape (m,)."""
    Z: FloatArray
    """Weighted deviations of the prediction, shape (rows, m)."""
    U: FloatArray
    """Weighted deviations of u behind them, shape (rows, a): the state errs by S u, along the first a columns of S."""

    @property
    def spread(self) -> FloatArray:
        """Covariance of the prediction without the measurement's noise, shape (m, m)."""
        return np.asarray(self.Z.T @ self.Z)

    def with_noise(self, S_R: FloatArray) -> Conditioned:
        return condition(self.Z, self.U, S_R)


def see(belief: Belief, residual: Residual, weights: Weights) -> Seen:
    """A measurement's residual over the belief.

    Where it depends on the first numbers of the tangent alone, weights for so many states are enough: the columns of a
    lower-triangular root beyond them do not move what it sees.
    """
    z = residual(belief.x.plus(weights.deviations(belief.S)))
    mean = weights.mean @ z
    return Seen(mean, weights.root * (z - mean), weights.rows)


def moved_by(belief: Belief, seen: Seen, conditioned: Conditioned) -> Belief:
    """The belief after the measurement: x + S u, with u as it was conditioned."""
    a = len(conditioned.L)
    columns = belief.S[:, :a]
    x = belief.x.plus(-columns @ (conditioned.gain @ conditioned.whiten(seen.mean)))
    S = belief.S.copy()
    S[:, :a] = columns @ conditioned.L
    return replace(belief, x=x, S=S)
