"""Noise statistics with fading memory (Sage & Husa 1969), and what they are for: equations as in the literature.

v is the innovation or residual as prediction minus measurement. Spreads are covariances of the predicted measurement
*without* its noise. The unbiased estimators may lose their definiteness; the residual one cannot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class Noise:
    """What a filter believes of the noise of one kind of measurement."""

    R: FloatArray
    """Covariance, shape (m, m)."""
    r: FloatArray
    """Mean, shape (m,); zero unless it is estimated."""
    count: int = 0
    """Measurements it was learnt from."""

    @classmethod
    def stated(cls, m: int) -> Noise:
        """Whitened by what is stated: the unit matrix."""
        return cls(np.eye(m), np.zeros(m))


def fading_weight(k: int, b: float, k0: int = 0) -> float:
    """d_k = (1 - b) / (1 - b^(k + k0)) of the k-th measurement, k = 1, 2, ...: b^(age) normalised to the sum 1.

    ``k0`` measurements of the stated noise are taken to have come before: without them the first one replaces it.
    """
    return (1.0 - b) / (1.0 - b ** (k + k0))


def residual_noise(noise: Noise, e: FloatArray, spread: FloatArray, d: float, cap: float = np.inf) -> Noise:
    """R <- (1 - d) R + d (e e^T + spread), from the residual e and the spread *after* the measurement was used.

    ``cap``: e^T R^-1 e counts for no more than this many times its dimension.
    """
    size = float(e @ np.linalg.solve(noise.R, e)) / len(e)
    e = e * min(1.0, np.sqrt(cap / size)) if size > 0.0 else e
    R = (1.0 - d) * noise.R + d * (np.outer(e, e) + spread)
    return replace(noise, R=0.5 * (R + R.T), count=noise.count + 1)


def unbiased_noise(noise: Noise, v: FloatArray, spread: FloatArray, d: float) -> Noise | None:
    """R <- (1 - d) R + d (v v^T - spread), from the innovation v and the spread *before* the measurement was used.

    None where that is not positive definite.
    """
    R = (1.0 - d) * noise.R + d * (np.outer(v, v) - spread)
    R = 0.5 * (R + R.T)
    if np.linalg.eigvalsh(R)[0] <= 0.0:
        return None
    return replace(noise, R=R, count=noise.count + 1)


def noise_mean(noise: Noise, v: FloatArray, d: float) -> Noise:
    """r <- (1 - d) r + d v, from the innovation taken without r; not together with the mean of the system's noise."""
    return replace(noise, r=(1.0 - d) * noise.r + d * v)


def system_noise(Q: FloatArray, gained: FloatArray, P: FloatArray, P0: FloatArray, d: float) -> FloatArray:
    """Q <- (1 - d) Q + d (K v v^T K^T + P - P0).

    Parameters
    ----------
    gained
        K v: what the state moved by, shape (n,).
    P, P0
        Covariance after the measurement, and of the propagated points alone, *without* Q: with Q its expectation would
        be zero, and Q would die away.
    """
    new: FloatArray = (1.0 - d) * Q + d * (np.outer(gained, gained) + P - P0)
    return 0.5 * (new + new.T)


def system_mean(q: FloatArray, moved: FloatArray, d: float) -> FloatArray:
    """q <- (1 - d) q + d (x_k - sum W f(chi)), from the difference of posterior and propagated mean."""
    mean: FloatArray = (1.0 - d) * q + d * moved
    return mean


def innovation_covariance(V: FloatArray | None, v: FloatArray, rho: float) -> FloatArray:
    """V_k = (rho V_{k-1} + v v^T) / (1 + rho), begun with v v^T (Zhou & Frank 1996)."""
    square = np.outer(v, v)
    return square if V is None else (rho * V + square) / (1.0 + rho)


def fading_factor(V: FloatArray, P_zz: FloatArray, spread: FloatArray, most: float) -> float:
    """lambda = max(1, 1 + tr(V - P_zz) / tr(spread)), all in units in which the noise is white; at most ``most``."""
    total = float(np.trace(spread))
    if total <= 0.0:
        return 1.0
    return float(np.clip(1.0 + np.trace(V - P_zz) / total, 1.0, most))
