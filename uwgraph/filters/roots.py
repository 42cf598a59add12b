"""Square roots of covariances by QR alone: what a filter does to its covariance, without ever subtracting.

Rows of deviations A (shape (rows, n)) stand for the covariance A^T A. A prediction stacks deviations, a measurement
conditions them; both are one triangularisation (Morf & Kailath 1975; van der Merwe & Wan 2001), and P = S S^T cannot
lose its definiteness.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg.lapack import dgeqrf, dtrtrs

from uwgraph.types import FloatArray


@cache
def _lower(n: int) -> FloatArray:
    return np.tri(n)


def lower_root(rows: FloatArray) -> FloatArray:
    """S, lower triangular, shape (n, n), with S S^T = rows^T rows; at least n rows."""
    n = rows.shape[1]
    qr, *_ = dgeqrf(rows)
    S: FloatArray = qr[:n].T * _lower(n)
    return S


@dataclass(frozen=True, eq=False)
class Conditioned:
    """A measurement and a state conditioned on it."""

    S_z: FloatArray
    """Root of the covariance of the innovation, noise included, shape (m, m)."""
    gain: FloatArray
    """P_xz S_z^-T, shape (n, m): what the state moves by for an innovation whitened by ``S_z``."""
    S: FloatArray
    """Root of the state's covariance afterwards, shape (n, n)."""

    def whiten(self, innovation: FloatArray) -> FloatArray:
        """S_z^-1 innovation: a unit normal vector where the filter is right."""
        white, _ = dtrtrs(self.S_z, innovation, lower=1)
        return np.asarray(white)


def condition(Z: FloatArray, X: FloatArray, S_R: FloatArray) -> Conditioned:
    """Condition a state on a measurement.

    Parameters
    ----------
    Z, X
        Deviations of the predicted measurement and of the state, shape (rows, m) and (rows, n): Z^T Z is the spread of
        the prediction, X^T X = P, X^T Z = P_xz.
    S_R
        Root of the noise, R = S_R S_R^T, shape (m, m).
    """
    rows, m = Z.shape
    n = X.shape[1]
    A = np.zeros((rows + m, m + n))
    A[:rows, :m], A[:rows, m:], A[rows:, :m] = Z, X, S_R.T
    if len(A) < m + n:
        A = np.vstack([A, np.zeros((m + n - len(A), m + n))])
    L = lower_root(A)
    return Conditioned(L[:m, :m], L[m:, :m], L[m:, m:])
