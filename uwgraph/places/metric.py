"""The learnt metric of descriptors: d_M^2 is a plain squared distance after a linear map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class Metric:
    """d_M(a, b)^2 = |z(a) - z(b)|^2 with z = scale * y / |y|, y = x + C^T (S - I) C (x - mean).

    Along C, which spans the images it was learnt from, the metric is M = S^2; elsewhere it stays Euclidean, so that
    places that nobody trained on keep apart. The length is taken out because trained images end up longer than new
    ones, and would else be nobody's neighbour.
    """

    mean: NDArray[np.float32]
    """Shape (D,)."""
    components: NDArray[np.float32]
    """C, orthonormal rows, shape (P, D)."""
    change: NDArray[np.float32]
    """S - I, symmetric, shape (P, P)."""
    scale: float
    """Such that images nearer than 1 are likely of one place."""

    @property
    def size(self) -> int:
        """Length of z, D."""
        return len(self.mean)

    def project(self, X: ArrayLike) -> NDArray[np.float32]:
        """z of descriptors, shape (N, D) or (D,), of the same shape."""
        x = np.asarray(X, dtype=np.float32)
        y = x + ((x - self.mean) @ self.components.T @ self.change) @ self.components
        length = np.linalg.norm(y, axis=-1, keepdims=True)
        return np.asarray(np.float32(self.scale) * y / np.maximum(length, np.float32(1e-12)), dtype=np.float32)


def principal_components(X: NDArray[np.float32], count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean (D,) and at most ``count`` principal axes (P, D) of samples (N, D); none where all samples are the same."""
    n, mean = len(X), X.mean(axis=0, dtype=np.float64)
    centred = X - mean
    values, vectors = scipy.linalg.eigh(centred @ centred.T, subset_by_index=(max(n - count, 0), n - 1))
    values, vectors = values[::-1], vectors[:, ::-1]
    rounding = 1e-12 * float(np.sum(np.square(X, dtype=np.float64)))  # of single precision, squared
    kept = values > max(1e-9 * values[0], rounding)
    axes = (vectors[:, kept].T @ centred) / np.sqrt(values[kept])[:, None]
    return mean.astype(np.float32), axes.astype(np.float32)


def symmetric_root(M: FloatArray) -> FloatArray:
    """S, symmetric and positive semi-definite, with S S = M."""
    values, vectors = np.linalg.eigh(M)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
