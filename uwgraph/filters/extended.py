"""The error-state Kalman filter: one state, and its errors to first order, in the same square-root form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from factors.lie import skew
from uwgraph.filters.roots import lower_root, solve_lower
from uwgraph.filters.state import Belief, State
from uwgraph.filters.unscented import Seen
from uwgraph.types import FloatArray


def predict(belief: Belief, t_ns: int, moved: State, F: FloatArray, noise_rows: FloatArray) -> Belief:
    """The belief after a motion with derivative F and additive noise noise_rows^T noise_rows."""
    return Belief(t_ns, moved, lower_root(np.concatenate([(F @ belief.S).T, noise_rows])))


def predict_and_carry(
    belief: Belief, t_ns: int, moved: State, F: FloatArray, noise_rows: FloatArray
) -> tuple[Belief, FloatArray]:
    """:func:`predict`, and what carries correlations along, as in :mod:`uwgraph.filters.unscented`."""
    FS = F @ belief.S
    S = lower_root(np.concatenate([FS.T, noise_rows]))
    return Belief(t_ns, moved, S), solve_lower(S, FS).T


def see(belief: Belief, residual: FloatArray, H: FloatArray) -> Seen:
    """A measurement's residual and its derivative H at the belief's state by the first a numbers of the tangent."""
    a = H.shape[1]
    return Seen(residual, (H @ belief.S[:a, :a]).T, np.eye(a))


def iterate(
    prior: Belief,
    linearize: Callable[[State], tuple[FloatArray, FloatArray]],
    S_R: FloatArray,
    tolerance: float = 1e-12,
    most: int = 50,
) -> Belief:
    """The iterated update: Gauss-Newton on prior and measurement (Bell & Cathey 1993).

    ``linearize`` gives the residual, shape (m,), and its derivative, shape (m, n), at a state. The posterior is the
    maximum a posteriori of the two, as a graph with one state has it.
    """
    x = prior.x
    for _ in range(most):
        z, H = linearize(x)
        away = prior.x.to(x)
        # d(x0 + away + d) / d(away): the tangent at x is not the tangent at the prior
        J = _right_jacobian(prior.x, away)
        seen = Seen(z - H @ np.linalg.solve(J, away), (H @ np.linalg.solve(J, prior.S)).T, np.eye(prior.x.size))
        conditioned = seen.with_noise(S_R)
        d = -prior.S @ (conditioned.gain @ conditioned.whiten(seen.mean))
        following = prior.x.plus(d)
        step = np.abs(x.to(following)).max()
        x = following
        if step < tolerance:
            break
    S = np.asarray(np.linalg.solve(_right_jacobian(prior.x, d), prior.S @ conditioned.L))
    return replace(prior, x=x, S=lower_root(S.T))


def _right_jacobian(x: State, d: FloatArray) -> FloatArray:
    """Derivative of the tangent at x by the tangent at x + d: the inverse right Jacobian of each rotation."""
    J = np.eye(x.size)
    for at in x.rot.tolist():
        phi = d[at : at + 3]
        angle = float(np.linalg.norm(phi))
        W = skew(phi)
        c = 1.0 / 12.0 if angle < 1e-4 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
        J[at : at + 3, at : at + 3] = np.eye(3) + 0.5 * W + c * W @ W
    return J
