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


def solve_lower(S: FloatArray, b: FloatArray) -> FloatArray:
    """S^-1 b of a lower-triangular S."""
    x, _ = dtrtrs(S, b, lower=1)
    return np.asarray(x)


@dataclass(frozen=True, eq=False)
class Conditioned:
    """A unit normal vector u, conditioned on a measurement of which it makes part."""

    S_z: FloatArray
    """Root of the covariance of the innovation, noise included, shape (m, m); its diagonal is positive.

    QR alone leaves the signs to chance, and innovations on one side of zero would alternate when whitened.
    """
    gain: FloatArray
    """E[u z^T] S_z^-T, shape (a, m): what u moves by for an innovation whitened by ``S_z``."""
    L: FloatArray
    """Lower root of the covariance of u afterwards, shape (a, a)."""

    def whiten(self, innovation: FloatArray) -> FloatArray:
        """S_z^-1 innovation: a unit normal vector where the filter is right."""
        return solve_lower(self.S_z, innovation)


def condition(Z: FloatArray, U: FloatArray, S_R: FloatArray) -> Conditioned:
    """Condition a unit normal vector on a measurement.

    Parameters
    ----------
    Z, U
        Deviations of the predicted measurement and of u, shape (rows, m) and (rows, a): Z^T Z is the spread of the
        prediction, U^T U the unit matrix, U^T Z their covariance.
    S_R
        Root of the noise, R = S_R S_R^T, shape (m, m).
    """
    rows, m = Z.shape
    a = U.shape[1]
    A = np.zeros((max(rows + m, m + a), m + a))
    A[:rows, :m], A[:rows, m:], A[rows : rows + m, :m] = Z, U, S_R.T
    L = lower_root(A)
    L[:, :m] *= np.copysign(1.0, L.diagonal()[:m])
    return Conditioned(L[:m, :m], L[m:, :m], L[m:, m:])
