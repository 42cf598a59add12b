"""States that grow and shrink: a part of the state remembered, or something seen from it, appended and dropped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uwgraph.filters.roots import lower_root
from uwgraph.filters.state import Belief, State
from uwgraph.types import FloatArray


def augmented(
    belief: Belief, y: FloatArray, J: FloatArray, noise_rows: FloatArray | None = None, R: FloatArray | None = None
) -> Belief:
    """x <- [x; g(x, z)] and P <- [[P, P J^T], [J P, J P J^T + noise]].

    Parameters
    ----------
    y
        The new numbers, shape (k,); where a rotation ``R``, shape (3, 3), is appended, their first three are unused.
    J
        Derivative of the new part's tangent by the state's, shape (k, n).
    noise_rows
        Rows whose squares are the noise of g, shape (rows, k); none for a copy of what the state already has.
    """
    x, n, k = belief.x, belief.x.size, len(y)
    rotations, rot = x.R, x.rot
    if R is not None:
        rotations, rot = np.concatenate([rotations, R[None]]), np.append(rot, n)
        y = np.concatenate([np.zeros(3), y[3:]])
    S = np.zeros((n + k, n + k))
    S[:n, :n] = belief.S
    S[n:, :n] = J @ belief.S
    if noise_rows is not None:
        S[n:, n:] = lower_root(np.vstack([noise_rows, np.zeros((k, k))]))
    return replace(belief, x=State(rotations, np.concatenate([x.y, y]), rot), S=S)


def without(belief: Belief, at: int, size: int) -> Belief:
    """The belief about everything but ``size`` numbers of the tangent that begin at ``at``."""
    x = belief.x
    keep = np.r_[0:at, at + size : x.size]
    rotations = (x.rot < at) | (x.rot >= at + size)
    rot = x.rot[rotations]
    left = State(np.ascontiguousarray(x.R[rotations]), x.y[keep], np.where(rot > at, rot - size, rot))
    rows = belief.S[keep].T
    return replace(belief, x=left, S=lower_root(rows))
