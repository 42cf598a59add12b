"""The objective of large-margin nearest neighbours and its gradients, with respect to L and to M = L^T L.

Weinberger and Saul, Distance metric learning for large margin nearest neighbor classification, JMLR 10 (2009):

    (1 - mu) sum_{i, j~>i} d_ij + mu sum_{i, j~>i, l} (1 - y_il) [1 + d_ij - d_il]_+ ,   d_ij = |L (x_i - x_j)|^2

Each active term adds +-(x_i - x_j)(x_i - x_j)^T to the gradient. With the terms' weights W as edges of a graph, their
sum is X^T lap(W) X: two matrix products in place of a sum of outer products.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from uwgraph.places.lmnn_impostors import DENSE, IndexArray, impostors, squared_distances
from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class Objective:
    """The sum over a training set, plus what holds the metric at its start.

    The latter is ``shrinkage * N * |M - M_0|^2 / |M_0|^2`` (Frobenius norms), convex in M as all the rest.
    """

    X: FloatArray
    """Points sorted by class, shape (N, D)."""
    starts: IndexArray
    """Where the classes start, shape (C + 1,)."""
    targets: IndexArray
    """Target neighbours, shape (N, k); -1 for none."""
    push_weight: float
    """mu."""
    shrinkage: float
    start: FloatArray
    """L_0, shape (P, D)."""

    def of_components(self, L: FloatArray) -> tuple[float, FloatArray]:
        """Value at L, shape (P, D), and its gradient."""
        Y = self.X @ L.T
        value, lap_Y = self._pull_and_push(Y, Y)
        gram, cross, gram_0 = L @ L.T, L @ self.start.T, self.start @ self.start.T
        weight = self.shrinkage * len(Y) / float(np.sum(gram_0**2))
        held = np.sum(gram**2) - 2.0 * np.sum(cross**2) + np.sum(gram_0**2)
        return value + weight * float(held), 2.0 * lap_Y.T @ self.X + 4.0 * weight * (gram @ L - cross @ self.start)

    def of_metric(self, M: FloatArray) -> tuple[float, FloatArray]:
        """Value at M, symmetric and positive semi-definite, shape (D, D), and its gradient."""
        value, lap_X = self._pull_and_push(self.X @ factor(M).T, self.X)
        M_0 = self.start.T @ self.start
        weight = self.shrinkage * len(self.X) / float(np.sum(M_0**2))
        return value + weight * float(np.sum((M - M_0) ** 2)), self.X.T @ lap_X + 2.0 * weight * (M - M_0)

    def pull_and_push(self, Y: FloatArray) -> float:
        """The equation's value where the points lie at Y, shape (N, P)."""
        return self._pull_and_push(Y, np.empty((len(Y), 0)))[0]

    def _pull_and_push(self, Y: FloatArray, Z: FloatArray) -> tuple[float, FloatArray]:
        """The equation's value where the points lie at Y, and lap(W) Z."""
        n, k = self.targets.shape
        mu = self.push_weight
        i, slot = np.nonzero(self.targets >= 0)
        j = self.targets[i, slot]
        pull = np.full((n, k), -np.inf)
        pull[i, slot] = squared_distances(Y, i, j)
        value = (1.0 - mu) * float(pull[i, slot].sum())
        edges = np.full((n, k), 1.0 - mu)
        lap_Z = np.zeros_like(Z)
        for found in impostors(Y, self.starts, 1.0 + pull.max(axis=1)):
            terms = np.zeros(len(found.i))
            for s in range(k):
                hinge = 1.0 + pull[found.rows, s][found.i] - found.distance
                active = hinge > 0.0
                value += mu * float(hinge[active].sum())
                edges[found.rows, s] += mu * np.bincount(found.i, active, minlength=len(edges[found.rows]))
                terms += active
            add_laplacian(lap_Z, Z, found.rows, found.i, found.l, -mu * terms)
        add_laplacian(lap_Z, Z, slice(0, n), i, j, edges[i, slot])
        return value, lap_Z


def factor(M: FloatArray) -> FloatArray:
    """L with M = L^T L, shape (D, D), of the positive part of a symmetric M; the largest direction first."""
    values, vectors = np.linalg.eigh(M)
    return np.asarray((np.sqrt(np.maximum(values, 0.0)) * vectors).T[::-1])


def add_laplacian(
    lap_Z: FloatArray, Z: FloatArray, rows: slice, i: IndexArray, j: IndexArray, weight: FloatArray
) -> None:
    """Add lap(W) Z of edges from ``rows.start + i`` to j, ``i`` sorted; z^T lap(W) z sums weight (z_i - z_j)^2."""
    n, count = len(Z), rows.stop - rows.start
    ends = np.append(0, np.cumsum(np.bincount(i, minlength=count)))
    W = sparse.csr_array((weight, j, ends), shape=(count, n))
    if W.nnz > DENSE * count * n:
        W = W.toarray()
    lap_Z[rows] += np.bincount(i, weight, minlength=count)[:, None] * Z[rows] - W @ Z
    lap_Z += np.bincount(j, weight, minlength=n)[:, None] * Z - W.T @ Z[rows]
