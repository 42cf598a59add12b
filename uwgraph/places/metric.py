"""The learnt metric of descriptors: d_M^2 is a plain squared distance after a linear map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class Metric:
    """d_M(a, b)^2 = |z(a) - z(b)|^2 with z(x) = L u / |u|, u = components (x - mean)."""

    mean: NDArray[np.float32]
    """Shape (D,)."""
    components: NDArray[np.float32]
    """Of the PCA, scaled, shape (P, D)."""
    L: FloatArray
    """Shape (Q, P), in such a unit that images nearer than 1 are likely of one place."""

    @property
    def size(self) -> int:
        """Length of z."""
        return len(self.L)

    def project(self, X: ArrayLike) -> FloatArray:
        """z of descriptors, shape (N, D) or (D,); shape (N, Q) or (Q,)."""
        u = (np.asarray(X, dtype=np.float32) - self.mean) @ self.components.T
        length = np.linalg.norm(u, axis=-1, keepdims=True)
        return np.asarray((u / np.maximum(length, np.float32(1e-12))).astype(np.float64) @ self.L.T)
