"""Covariances of all variables in one backward pass over the eliminated graph.

The sparse-inverse recursion (Takahashi 1973; Bjorck, Numerical Methods for Least Squares Problems, 6.7.4): a
conditional R x_F + S x_P = d gives Sigma_FP = -R^-1 S Sigma_PP and Sigma_FF = (R^T R)^-1 + R^-1 S Sigma_PP S^T R^-T.
Every Sigma_PP that is needed lies within the clique of the parent that was eliminated first, so nothing outside the
cliques is formed.
"""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri

from uwgraph.types import FloatArray

IndexArray = NDArray[np.intp]


def marginal_covariances(bayes_net: gtsam.GaussianBayesNet) -> Mapping[int, FloatArray]:
    """Marginal covariance of every variable of a Bayes net with one frontal variable per conditional.

    Parameters
    ----------
    bayes_net : gtsam.GaussianBayesNet
        From ``eliminateSequential(ordering, gtsam.EliminateQR)``.

    Returns
    -------
    dict
        Covariance, shape (d, d), of every key.
    """
    conditionals = [bayes_net.at(i) for i in range(bayes_net.size())]
    order = {c.firstFrontalKey(): i for i, c in enumerate(conditionals)}
    clique: dict[int, FloatArray] = {}
    columns: dict[int, dict[int, IndexArray]] = {}
    marginals: dict[int, FloatArray] = {}
    waiting = _last_use(conditionals, order)
    for conditional in reversed(conditionals):
        keys = conditional.keys()
        key, parents = keys[0], keys[1:]
        R_inv = inverse_root(conditional)
        d = len(R_inv)
        if not parents:
            joint = R_inv @ R_inv.T
        else:
            nearest = min(parents, key=order.__getitem__)
            index = np.concatenate([columns[nearest][p] for p in parents])
            Sigma_P = clique[nearest][index[:, None], index]
            G = R_inv @ conditional.S()
            joint = np.empty((d + len(index), d + len(index)))
            joint[d:, d:] = Sigma_P
            joint[:d, d:] = -G @ Sigma_P
            joint[d:, :d] = joint[:d, d:].T
            Sigma_F = R_inv @ R_inv.T - G @ joint[d:, :d]
            joint[:d, :d] = 0.5 * (Sigma_F + Sigma_F.T)  # an asymmetry of one rounding would grow exponentially
        marginals[key] = joint[:d, :d].copy()
        clique[key] = joint
        columns[key] = _columns(key, d, parents, marginals)
        for done in waiting.get(key, ()):
            del clique[done], columns[done]
    return marginals


def inverse_root(conditional: gtsam.GaussianConditional) -> FloatArray:
    """R^-1 of the conditional, whitened where QR left a noise model."""
    R = conditional.R()
    model = conditional.get_model()
    inverse, _ = dtrtri(R)
    if model is not None and not model.isUnit():
        inverse = inverse * model.sigmas()
    result: FloatArray = inverse
    return result


def _columns(key: int, d: int, parents: list[int], marginals: Mapping[int, FloatArray]) -> dict[int, IndexArray]:
    """Where each variable of a clique stands in its joint covariance."""
    place = {key: np.arange(d)}
    offset = d
    for p in parents:
        width = len(marginals[p])
        place[p] = np.arange(offset, offset + width)
        offset += width
    return place


def _last_use(conditionals: list[gtsam.GaussianConditional], order: Mapping[int, int]) -> Mapping[int, list[int]]:
    """Which cliques nobody asks for any more after each variable: memory stays that of the widest front."""
    last = {c.firstFrontalKey(): c.firstFrontalKey() for c in conditionals}
    for conditional in conditionals:
        keys = conditional.keys()
        if len(keys) > 1:
            nearest = min(keys[1:], key=order.__getitem__)
            if last[nearest] == nearest:
                last[nearest] = keys[0]
    waiting: dict[int, list[int]] = {}
    for clique, user in last.items():
        waiting.setdefault(user, []).append(clique)
    return waiting
