"""Do closures agree with the odometry, and with each other?

Pairwise consistent measurement set maximisation (Mangelson, Dominic, Eustice & Vasudevan, ICRA 2018): two closures and
the odometry between them form a cycle that must lead back to where it began; the largest set of closures that agree
two by two is kept. The odometry's covariance is the joint one of all poses concerned, from the smoothed graph without
closures: what both ways of a cycle have in common (a gyro bias, the DVL's scale) cancels as it does in truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwgraph.chi_square import chi2_quantile
from uwgraph.graph.prepare import UNMEASURED
from uwgraph.graph.se3 import Poses, moved
from uwgraph.types import BoolArray, FloatArray

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Odometry:
    """Poses without closures, and how sure they are of each other."""

    T_n: Poses
    """Poses in n, M of them."""
    cov: FloatArray
    """Their joint covariance, shape (M, M, 6, 6)."""


@dataclass(frozen=True, eq=False)
class Loops:
    """Closures between poses of an :class:`Odometry`."""

    i: IndexArray
    """Shape (N,)."""
    j: IndexArray
    """Shape (N,)."""
    T: Poses
    """Measured pose of j seen from i."""
    cov: FloatArray
    """Covariance in the tangent at T, shape (N, 6, 6)."""

    def __len__(self) -> int:
        return len(self.i)

    def select(self, index: Any) -> Loops:
        """Those that a mask or an index array picks."""
        return Loops(self.i[index], self.j[index], self.T[index], self.cov[index])


def gate(prediction: Poses, covariance: FloatArray, closure: Poses, closure_cov: FloatArray, quantile: float) -> Gated:
    """Held against a prediction of the same relative poses: squared Mahalanobis distances and whether they are inside.

    Parameters
    ----------
    prediction, closure
        N relative poses each.
    covariance, closure_cov
        Covariances in the tangents at them, shape (N, 6, 6).
    quantile
        Share of true closures that pass.
    """
    error = closure.to(prediction)
    return _within(error.log(), covariance + moved(closure_cov, error.inverse().adjoint()), quantile)


@dataclass(frozen=True, eq=False)
class Gated:
    """A chi-square test of each row."""

    d2: FloatArray
    """Shape (N,)."""
    limit: FloatArray
    """Shape (N,)."""

    @property
    def accepted(self) -> BoolArray:
        inside: BoolArray = self.d2 <= self.limit
        return inside


def _within(e: FloatArray, S: FloatArray, quantile: float) -> Gated:
    """e^T S^-1 e over the directions that were measured."""
    variance, Q = np.linalg.eigh(S)
    known = variance < UNMEASURED
    white = (np.swapaxes(Q, 1, 2) @ e[:, :, None])[..., 0]
    d2 = np.sum(np.where(known, white**2 / variance, 0.0), axis=1)
    return Gated(d2, chi2_quantile(quantile, np.maximum(known.sum(axis=1), 1)))


def against_odometry(odometry: Odometry, loops: Loops, quantile: float) -> Gated:
    """Every closure by itself against the odometry's own prediction."""
    i, j = loops.i, loops.j
    predicted = odometry.T_n[i].to(odometry.T_n[j])
    A = predicted.inverse().adjoint()
    P = odometry.cov
    cross = A @ P[i, j]
    cov = moved(P[i, i], A) + P[j, j] - cross - np.swapaxes(cross, 1, 2)
    return gate(predicted, cov, loops.T, loops.cov, quantile)


def consistent_pairs(odometry: Odometry, loops: Loops, quantile: float) -> BoolArray:
    """Which closures agree with which, shape (N, N), symmetric, true on the diagonal."""
    agree = np.eye(len(loops), dtype=np.bool_)
    for a in range(len(loops) - 1):
        b = np.arange(a + 1, len(loops))
        agree[a, b] = agree[b, a] = _cycles(odometry, loops, a, b, quantile).accepted
    return agree


def _cycles(odometry: Odometry, loops: Loops, a: int, b: IndexArray, quantile: float) -> Gated:
    """The cycles i -> j -> m -> k -> i of closure a = (i, j) with closures b = (k, m).

    To first order the error at their end, in the axes of i, is
    Ad_j (d_a - d_j) + Ad_m (d_m - d_b) - Ad_k d_k + d_i, with d the small motions of closures and poses in their own
    axes, and Ad_x the adjoint of x seen from i along closure b.
    """
    i, j, k, m = loops.i[a], loops.j[a], loops.i[b], loops.j[b]
    n = odometry.T_n
    T_ik = n[i].to(n[k])
    T_im = T_ik @ loops.T[b]
    T_ij = T_im @ n[m].to(n[j])
    e = (loops.T[a] @ T_ij.inverse()).log()
    Ad_j, Ad_k, Ad_m = T_ij.adjoint(), T_ik.adjoint(), T_im.adjoint()
    J = np.concatenate([np.broadcast_to(np.eye(6), Ad_j.shape), -Ad_j, -Ad_k, Ad_m], axis=2)
    poses = np.stack([np.full_like(k, i), np.full_like(k, j), k, m], axis=1)
    P = odometry.cov[poses[:, :, None], poses[:, None, :]].swapaxes(2, 3).reshape(len(b), 24, 24)
    return _within(e, J @ P @ np.swapaxes(J, 1, 2) + moved(loops.cov[a], Ad_j) + moved(loops.cov[b], Ad_m), quantile)
