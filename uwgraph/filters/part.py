"""The unscented transform over a part of a state: for what moves, or tells of, no more than that part.

Sigma points of the whole state lie sqrt(n) sigmas away, so that a filter which remembers 50 places would look at
headings twelve sigmas off. Here they are drawn from the part's own k numbers and take the rest of the state with them
as it is correlated. On a linear problem this is the transform of the whole state, whatever k.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.linalg.lapack import dgeqrf, dormqr

from uwgraph.filters import unscented
from uwgraph.filters.monitor import See
from uwgraph.filters.roots import lower_root
from uwgraph.filters.state import Belief, Index, State
from uwgraph.filters.unscented import Motion, Residual, Spread, Weights
from uwgraph.types import FloatArray


@cache
def weights(spread: Spread, k: int) -> Weights:
    """The spread over k numbers."""
    return spread.of(k)


def facing(belief: Belief, at: Index) -> Belief:
    """The belief with its root turned: the numbers ``at``, shape (k,), depend on its first k columns alone.

    Any S T with an orthogonal T is a root of the same covariance; this one is not triangular any more.
    """
    reflectors, tau, *_ = dgeqrf(belief.S[at].T)
    S, *_ = dormqr("R", "N", reflectors, tau, belief.S, len(belief.S))
    S[at, len(at) :] = 0.0
    return replace(belief, S=np.asarray(S))


def lowered(belief: Belief) -> Belief:
    """The belief with its root turned lower triangular again."""
    return replace(belief, S=lower_root(belief.S.T))


def sight(residual: Residual, k: int, spread: Spread) -> See:
    """A residual that depends on k numbers, over beliefs that face them: see :func:`unscented.see`."""
    return lambda facing: unscented.see(facing, residual, weights(spread, k))


def predict(belief: Belief, t_ns: int, k: int, motion: Motion, noise_rows: FloatArray, spread: Spread) -> Belief:
    """As :func:`unscented.predict`, for a motion of the first k numbers that depends on no others."""
    points = weights(spread, k)
    moved = motion(belief.x.plus(points.deviations(belief.S)))
    centre = State(moved.R[0], moved.y[0], moved.rot)
    x = centre.plus(points.mean @ centre.to(moved))
    rows = [points.root * x.to(moved), belief.S[:, k:].T, noise_rows]
    return Belief(t_ns, x, lower_root(np.concatenate(rows)))
