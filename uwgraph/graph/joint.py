"""The joint covariance of chosen poses: how sure a graph is of the motion between any two of them.

Everything else is eliminated first; what is left, a chain over the chosen keyframes, is covered by the recursion of
:mod:`uwgraph.graph.marginals` with all columns kept: Sigma_F,: = -R^-1 S Sigma_P,: from the last variable to the first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from numpy.typing import NDArray

from uwgraph.graph.builder import DVL_CALIBRATION, Problem
from uwgraph.graph.marginals import inverse_root
from uwgraph.types import FloatArray

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class JointPoses:
    """Small motions of M poses in their own axes: what a graph, linearised somewhere, says about them."""

    mean: FloatArray
    """Where it would have them, shape (M, 6); zero where it is linearised at its own solution."""
    cov: FloatArray
    """Shape (M, M, 6, 6)."""


def joint_poses(problem: Problem, values: gtsam.Values, keyframes: Sequence[int]) -> JointPoses:
    """Poses of ``keyframes`` (each once) in the problem linearised at ``values``, everything else integrated out."""
    kept = [symbol(k) for k in keyframes for symbol in (X, V, B)]
    if values.exists(DVL_CALIBRATION):
        kept.append(DVL_CALIBRATION)
    reduced = problem.linearize(values).marginal(kept, gtsam.EliminateQR)
    bayes_net = reduced.eliminateSequential(problem.ordering(reduced), gtsam.EliminateQR)
    conditionals = [bayes_net.at(n) for n in range(bayes_net.size())]
    M = len(keyframes)
    slots = _slots(conditionals, {X(k): np.arange(6) + 6 * n for n, k in enumerate(keyframes)})
    size = max(int(s.max()) for s in slots.values()) + 1
    C = np.zeros((size, size))
    for conditional in reversed(conditionals):
        keys = conditional.keys()
        own = slots[keys[0]]
        R_inv = inverse_root(conditional)
        parents = np.concatenate([own[:0], *(slots[p] for p in keys[1:])])
        G = R_inv @ conditional.S()
        row = -G @ C[parents]
        cov = R_inv @ R_inv.T - row[:, parents] @ G.T
        C[own], C[:, own] = row, row.T
        C[np.ix_(own, own)] = 0.5 * (cov + cov.T)
    step = bayes_net.optimize()
    mean = np.array([step.at(X(k)) for k in keyframes])
    return JointPoses(mean, C[: 6 * M, : 6 * M].reshape(M, 6, M, 6).swapaxes(1, 2))


def _slots(conditionals: Sequence[gtsam.GaussianConditional], poses: Mapping[int, IndexArray]) -> dict[int, IndexArray]:
    """Rows of every variable: poses have their own, all others share rows with those that are no longer asked for."""
    last_use: dict[int, int] = {}
    for n, conditional in enumerate(conditionals):
        for key in conditional.keys():  # noqa: SIM118
            last_use.setdefault(key, n)
    slots = dict(poses)
    end = 6 * len(poses)
    free: dict[int, list[IndexArray]] = {}
    for n, conditional in reversed(list(enumerate(conditionals))):
        keys = conditional.keys()
        if keys[0] not in poses:
            width = conditional.R().shape[0]
            if not free.setdefault(width, []):
                free[width].append(np.arange(end, end + width))
                end += width
            slots[keys[0]] = free[width].pop()
        for key in keys:
            if key not in poses and last_use[key] == n:
                free.setdefault(len(slots[key]), []).append(slots[key])
    return slots
