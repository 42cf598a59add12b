"""Robust least squares on a geometry, with a covariance that neighbouring errors do not flatter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.chi_square import chi2_quantile
from uwgraph.places.plane import Geometry
from uwgraph.types import FloatArray

Residuals = Callable[[Geometry], FloatArray]
Linearised = Callable[[Geometry], tuple[FloatArray, FloatArray]]

ROUNDS: Final = 3
STEPS: Final = 15
HUBER: Final = 1.5
"""Whitened residuals above this are weighted down."""
INDEPENDENT: Final = 100
"""No more points than this count as independent: light, blur and the lens's calibration err alike all over an image.

On simulated images of a floor (moving lamps, relief, JPEG) 250 points err in all like 80 to 100 would.
"""
MIN_SIGMA: Final = 0.1
"""Features are never taken as better than this, pixels."""
DAMPING: Final = (1e-6, 1e6)
"""Levenberg and Marquardt's: at the start, and where a step is given up."""
SETTLED: Final = 1e-6
"""Relative change of the cost below which a round ends."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The end of a refinement."""

    geometry: Geometry
    cov: FloatArray
    """Of the small changes of :meth:`Geometry.moved`, shape (P, P)."""
    sigma: float
    """Robust 1-sigma of the points' residuals, in their own unit."""
    aid_cost: float
    """Sum of the squares of the aids' whitened residuals."""


def refine(
    start: Geometry, points: Linearised, dims: NDArray[np.intp], aids: Residuals, block: NDArray[np.intp]
) -> Fit:
    """Minimise the points' residuals (Huber, their scale estimated) and the aids' (whitened) together.

    Parameters
    ----------
    start : Geometry
        The first guess.
    points : callable
        geometry -> residuals of N points, shape (N, D), unused dimensions zero, and their derivative (N, D, P).
    dims : shape (N,)
        How many dimensions of each point's residual are used.
    aids : callable
        geometry -> whitened residuals (M,) of what else is known.
    block : shape (N,)
        Points of one block may err together: relief, the rim of the lens, what moves. Where blocks agree less with
        each other than independent points would, the covariance grows by that much.
    """
    at = start
    for _ in range(ROUNDS):
        sigma = robust_sigma(points(at)[0], dims)
        at = _minimised(at, points, dims, aids, sigma)
    r, J = points(at)
    sigma = robust_sigma(r, dims)
    known, by_known = _numeric(aids, at, J.shape[2])
    weight = _weights(r, dims, sigma) / sigma**2
    scores = np.einsum("n,nd,ndp->np", weight, r, J)
    per_point = np.einsum("n,ndp,ndq->npq", weight, J, J)
    of_aids = by_known.T @ by_known
    information = per_point.sum(axis=0) / _together(scores, per_point, of_aids, block) + of_aids
    return Fit(at, _inverse(information), sigma, float(known @ known))


def robust_sigma(r: FloatArray, dims: NDArray[np.intp]) -> float:
    """1-sigma per dimension of residuals (N, D), from the median of their squares."""
    squares = (r * r).sum(axis=1) / chi2_quantile(0.5, dims)
    return max(float(np.sqrt(np.median(squares))), MIN_SIGMA)


def _minimised(at: Geometry, points: Linearised, dims: NDArray[np.intp], aids: Residuals, sigma: float) -> Geometry:
    """Levenberg and Marquardt's steps with Huber's weights."""
    damping = DAMPING[0]
    r, J = points(at)
    cost = _cost(r, dims, aids(at), sigma)
    for _ in range(STEPS):
        known, by_known = _numeric(aids, at, J.shape[2])
        weight = _weights(r, dims, sigma) / sigma**2
        A = np.einsum("n,ndp,ndq->pq", weight, J, J) + by_known.T @ by_known
        g = np.einsum("n,ndp,nd->p", weight, J, r) + by_known.T @ known
        before = cost
        while damping < DAMPING[1]:
            step = -np.linalg.lstsq(A + damping * np.diag(np.diag(A)), g, rcond=None)[0]
            tried = at.moved(step)
            r_tried, J_tried = points(tried)
            cost_tried = _cost(r_tried, dims, aids(tried), sigma)
            if cost_tried <= cost:
                at, r, J, cost, damping = tried, r_tried, J_tried, cost_tried, max(damping / 10.0, 1e-12)
                break
            damping *= 10.0
        if before - cost < SETTLED * before:
            return at
    return at


def _weights(r: FloatArray, dims: NDArray[np.intp], sigma: float) -> FloatArray:
    size = np.sqrt((r * r).sum(axis=1) / dims) / sigma
    return np.asarray(HUBER / np.maximum(size, HUBER))


def _cost(r: FloatArray, dims: NDArray[np.intp], known: FloatArray, sigma: float) -> float:
    size = np.sqrt((r * r).sum(axis=1) / dims) / sigma
    huber = np.where(size < HUBER, size * size, HUBER * (2.0 * size - HUBER))
    return float((dims * huber).sum() + known @ known)


def _numeric(aids: Residuals, at: Geometry, size: int, h: float = 1e-6) -> tuple[FloatArray, FloatArray]:
    """The aids' residuals (M,) and their derivative (M, P)."""
    steps = h * np.eye(size)
    columns = [(aids(at.moved(step)) - aids(at.moved(-step))) / (2.0 * h) for step in steps]
    return aids(at), np.stack(columns, axis=1)


def _together(scores: FloatArray, per_point: FloatArray, of_aids: FloatArray, block: NDArray[np.intp]) -> float:
    """How much larger the covariance is than for independent points, at least 1.

    The sum of squares of the blocks' scores over its expectation for independent errors of variance one, whose
    residuals are (I - H) e; in the metric of the information, averaged over all directions.
    """
    _, index = np.unique(block, return_inverse=True)
    count = index.max() + 1
    u = np.zeros((count, scores.shape[1]))
    A = np.zeros((count, *per_point.shape[1:]))
    np.add.at(u, index, scores)
    np.add.at(A, index, per_point)
    inverse = _inverse(A.sum(axis=0) + of_aids)
    hat = inverse @ A
    expected = np.trace(hat, axis1=1, axis2=2).sum() - np.einsum("bij,bji->", hat, hat)
    found = float(np.einsum("bi,ij,bj->", u, inverse, u))
    return max(1.0, found / max(float(expected), 1e-9), len(block) / INDEPENDENT)


def _inverse(information: FloatArray) -> FloatArray:
    """Inverse of a symmetric matrix whose rows have different units."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(scaled, rcond=1e-14, hermitian=True) * np.outer(scale, scale))
