"""Linear-Gaussian systems, and the Kalman filter of the textbooks with full matrices: what every filter is held to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwgraph.filters.state import Belief, State
from uwgraph.types import FloatArray

Moments = tuple[FloatArray, FloatArray]
"""Mean and covariance."""


def predicted(x: FloatArray, P: FloatArray, F: FloatArray, Q: FloatArray) -> Moments:
    return F @ x, F @ P @ F.T + Q


def updated(x: FloatArray, P: FloatArray, H: FloatArray, R: FloatArray, z: FloatArray) -> Moments:
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return x + K @ (z - H @ x), P - K @ H @ P


def vector(y: FloatArray) -> State:
    """A state of numbers alone."""
    return State(np.zeros((0, 3, 3)), np.asarray(y, dtype=np.float64), np.zeros(0, dtype=np.int64))


def belief_of(x: FloatArray, P: FloatArray, t_ns: int = 0) -> Belief:
    return Belief(t_ns, vector(x), np.asarray(np.linalg.cholesky(P)))


def covariance(rng: np.random.Generator, n: int) -> FloatArray:
    A: FloatArray = rng.normal(size=(n, n)) * rng.uniform(0.3, 3.0, size=n)
    return A @ A.T + 0.05 * np.eye(n)


@dataclass(frozen=True, eq=False)
class System:
    """x' = F x + noise(Q), z = H x + noise(R)."""

    F: FloatArray
    Q: FloatArray
    H: FloatArray
    R: FloatArray

    @classmethod
    def drawn(cls, rng: np.random.Generator, n: int, m: int) -> System:
        """Eigenvalues of F inside the unit circle, so that nothing grows over many steps."""
        F = rng.normal(size=(n, n))
        F *= rng.uniform(0.5, 1.0) / np.abs(np.linalg.eigvals(F)).max()
        return cls(F, covariance(rng, n), rng.normal(size=(m, n)), covariance(rng, m))

    @property
    def noise_rows(self) -> FloatArray:
        return np.asarray(np.linalg.cholesky(self.Q)).T

    @property
    def S_R(self) -> FloatArray:
        return np.asarray(np.linalg.cholesky(self.R))


def held_to(belief: Belief, expected: Moments, tolerance: float = 1e-9) -> None:
    """The belief is what the textbook says, and its root is a lower triangle."""
    x, P = expected
    scale = max(1.0, float(np.abs(P).max()), float(np.abs(x).max()))
    np.testing.assert_allclose(belief.x.y, x, rtol=0.0, atol=tolerance * scale)
    np.testing.assert_allclose(belief.P, P, rtol=0.0, atol=tolerance * scale)
    np.testing.assert_array_equal(belief.S, np.tril(belief.S))
