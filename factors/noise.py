"""Gaussian noise models whose information may be exactly zero in some directions.

Everything goes through a full square-root information S (whitened residual = S r): GTSAM's ``Gaussian.Information``
takes a Cholesky factor and silently returns nonsense for a singular matrix.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.lie import FloatArray


def sqrt_information(information: ArrayLike, rank: int | None = None) -> FloatArray:
    """S with S^T S = information, shape (..., n, n), by eigendecomposition.

    Parameters
    ----------
    information
        Symmetric positive semidefinite, shape (..., n, n). Negative eigenvalues are rounding and count as zero.
    rank
        Where given, only the ``rank`` largest eigenvalues are kept; the others become exactly zero.

    Raises
    ------
    ValueError
        When the matrix is not finite, or has an eigenvalue that is clearly negative.
    """
    information = np.asarray(information, dtype=np.float64)
    if not np.isfinite(information).all():
        raise ValueError("the information matrix is not finite")
    values, Q = np.linalg.eigh(information)
    if np.any(values[..., 0] < -1e-6 * np.maximum(values[..., -1], 0.0)) or np.any(values[..., -1] < 0.0):
        raise ValueError(f"the information matrix has a negative eigenvalue, {values[..., 0].min():.3g}")
    if rank is not None:
        values[..., : values.shape[-1] - rank] = 0.0
    S: FloatArray = np.sqrt(np.maximum(values, 0.0))[..., :, None] * np.swapaxes(Q, -1, -2)
    return S


def sqrt_information_of_covariance(covariance: ArrayLike) -> FloatArray:
    """S with S^T S = inverse of the covariance, shape (n, n); an infinite variance measures nothing.

    Raises
    ------
    ValueError
        When the measured block is not positive definite.
    """
    covariance = np.asarray(covariance, dtype=np.float64)
    unmeasured = np.isinf(covariance.diagonal())
    if not unmeasured.any():
        return _inverse_root(covariance)
    S = np.zeros_like(covariance)
    block = np.ix_(~unmeasured, ~unmeasured)
    S[block] = _inverse_root(covariance[block])
    return S


def _inverse_root(covariance: FloatArray) -> FloatArray:
    try:
        S: FloatArray = np.linalg.inv(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        S = np.full_like(covariance, np.nan)
    if not np.isfinite(S).all():
        raise ValueError("the covariance is not positive definite")
    return S


def gaussian(S: FloatArray) -> gtsam.noiseModel.Gaussian:
    """The noise model that whitens a residual r to S r."""
    return gtsam.noiseModel.Gaussian.SqrtInformation(S, False)


def robust(model: gtsam.noiseModel.Base, loss: gtsam.noiseModel.mEstimator.Base | None) -> gtsam.noiseModel.Base:
    """The model wrapped in a robust loss, or as it is where there is none."""
    return model if loss is None else gtsam.noiseModel.Robust.Create(loss, model)
