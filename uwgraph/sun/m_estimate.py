"""Robust least squares of a few unknowns: iteratively reweighted, the covariance from the loss's own efficiency.

Huber & Ronchetti, Robust Statistics, 2nd ed. 2009, chapters 6 and 7. Rows of residuals are whitened: each of k numbers,
of unit variance when the stated noise is right, and weighted as one by its length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from uwgraph.chi_square import chi2_quantile
from uwgraph.sun.information import block_sandwich
from uwgraph.types import FloatArray

Loss = Literal["l1", "l2", "huber", "soft_l1"]
X = TypeVar("X")

NEGLIGIBLE: Final = 1e-3
"""The step that ends the search, in sigmas of the result."""

_LINEAR_BEYOND: Final = {"l1": 0.05, "huber": 1.345}
"""Where the losses leave the parabola, in sigmas: L1 is rounded at its tip, so that Newton's steps end."""


@dataclass(frozen=True, eq=False)
class Estimate(Generic[X]):
    """Where the robust cost is least."""

    x: X
    cov: FloatArray
    """Covariance of the tangent parameters, shape (p, p), rows taken as independent."""
    scale: float
    """Robust size of the whitened residuals: 1 when the stated noise is right, and never below."""
    cost: float
    """Sum of the losses at that scale, comparable with half a chi-square."""
    residuals: FloatArray
    """Whitened, shape (N, k)."""
    scores: FloatArray
    """Half the derivative of the cost by the tangent parameters, row by row, shape (N, p)."""
    curvature: FloatArray
    """Half its expected second derivative, shape (p, p)."""
    converged: bool


def m_estimate(
    residuals: Callable[[list[X]], FloatArray],
    move: Callable[[X, FloatArray], X],
    x: X,
    parameters: int,
    loss: Loss,
    *,
    step: float = 1e-5,
    iterations: int = 60,
) -> Estimate[X]:
    """The local minimum next to ``x`` of the sum of ``loss`` over the rows.

    Parameters
    ----------
    residuals : callable
        Whitened residuals, shape (K, N, k), of K candidates at once.
    move : callable
        The candidate at small tangent parameters, shape (p,), from another one.
    parameters : int
        p, the number of tangent parameters.
    step : float
        For the central differences.
    """
    steps = step * np.concatenate([np.zeros((1, parameters)), np.eye(parameters), -np.eye(parameters)])
    damping, converged = 0.0, False
    for _ in range(iterations):
        around = residuals([move(x, d) for d in steps])
        r, J = around[0], np.moveaxis(around[1 : parameters + 1] - around[parameters + 1 :], 0, -1) / (2.0 * step)
        scale = robust_scale(r)
        weights = _weight(np.sum(r * r, axis=-1) / scale**2, loss)
        g = np.einsum("n,nki,nk->i", weights, J, r)
        H = np.einsum("n,nki,nkj->ij", weights, J, J)
        H += 1e-12 * np.trace(H) * np.eye(parameters)
        d = np.full(parameters, np.inf)
        for _ in range(8):
            d = -np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
            ahead = move(x, d)
            if robust_cost(residuals([ahead])[0], scale, loss) <= robust_cost(r, scale, loss):
                x, damping = ahead, damping / 10.0 if damping > 1e-3 else 0.0
                break
            damping = max(10.0 * damping, 1e-2)
        if d @ H @ d < (NEGLIGIBLE * scale) ** 2:
            converged = True
            break
    information = np.einsum("nki,nkj->ij", J, J)
    return Estimate(
        x,
        cov=inefficiency(loss, r.shape[1]) * scale**2 * np.linalg.pinv(information, hermitian=True),
        scale=scale,
        cost=float(robust_cost(r, scale, loss)),
        residuals=r,
        scores=np.einsum("n,nki,nk->ni", weights, J, r),
        curvature=_mean_weight(loss, r.shape[1]) * information,
        converged=converged,
    )


def grouped_cov(found: Estimate[X], group: NDArray[np.intp]) -> FloatArray:
    """The covariance, grown by what the summed scores of groups of rows exceed those of independent rows.

    ``group`` numbers the first rows, from 0; rows beyond it (priors) stay alone.
    """
    groups, p = len(np.unique(group)), len(found.cov)
    if groups < p + 2:
        return found.cov
    sandwich = block_sandwich(found.scores[: len(group)], group, found.curvature)
    excess = float(np.trace(np.linalg.solve(found.cov, sandwich))) / p * groups / (groups - p)
    return found.cov * max(1.0, excess)


def robust_scale(r: FloatArray) -> float:
    """Median length of residuals (N, k) over that of the unit normal (the scaled MAD where k = 1); at least 1."""
    k = r.shape[-1]
    return max(1.0, float(np.sqrt(np.median(np.sum(r * r, axis=-1)) / _chi_square(k)[2000])))


def robust_cost(r: FloatArray, scale: float, loss: Loss) -> FloatArray:
    """Sum of the losses of rows (..., N, k), shape (...), over the mean second derivative for normal residuals."""
    z2 = np.sum(r * r, axis=-1) / scale**2
    if loss == "l2":
        rho = z2 / 2.0
    elif loss == "soft_l1":
        rho = np.sqrt(1.0 + z2) - 1.0
    else:
        c, z = _LINEAR_BEYOND[loss], np.sqrt(z2)
        rho = np.where(z <= c, z2 / 2.0, c * z - c * c / 2.0)
    total: FloatArray = rho.sum(axis=-1) / _mean_weight(loss, r.shape[-1])
    return total


@lru_cache
def inefficiency(loss: Loss, k: int) -> float:
    """Variance over that of least squares, for normal residuals: (E[psi^2] / k) / (E[r psi] / k)^2."""
    z2 = _chi_square(k)
    return float(np.mean(_weight(z2, loss) ** 2 * z2) / k) / _mean_weight(loss, k) ** 2


@lru_cache
def _mean_weight(loss: Loss, k: int) -> float:
    """E[r psi] / k, which for normal residuals is the expected derivative of psi (Stein 1981)."""
    z2 = _chi_square(k)
    return float(np.mean(_weight(z2, loss) * z2) / k)


@lru_cache
def _chi_square(k: int) -> FloatArray:
    """Evenly spaced quantiles of chi-square with k degrees."""
    return chi2_quantile((np.arange(4000) + 0.5) / 4000, k)


def _weight(z2: FloatArray, loss: Loss) -> FloatArray:
    """psi(z) / z of squared lengths."""
    if loss == "l2":
        return np.ones_like(z2)
    if loss == "soft_l1":
        return np.asarray(1.0 / np.sqrt(1.0 + z2))
    return np.asarray(np.minimum(1.0, _LINEAR_BEYOND[loss] / np.sqrt(np.maximum(z2, 1e-300))))
