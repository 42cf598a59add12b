"""States on a manifold: some rotations and some numbers, and a Gaussian belief about them.

The tangent of a state has n numbers. Triples of it that begin at ``rot`` are rotations of the right (body) side,
R Exp(d); all others add. The covariance is kept as a lower-triangular root S, P = S S^T, so that it is positive
semidefinite whatever happens to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uwgraph.filters import kernels
from uwgraph.types import FloatArray

Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class State:
    """One state, or M of them with a leading axis."""

    R: FloatArray
    """Rotations, shape (K, 3, 3) or (M, K, 3, 3)."""
    y: FloatArray
    """Numbers, shape (n,) or (M, n); zero where the tangent is a rotation."""
    rot: Index
    """Where each rotation begins in the tangent, shape (K,)."""

    @property
    def size(self) -> int:
        """Length n of the tangent."""
        return int(self.y.shape[-1])

    def plus(self, d: FloatArray) -> State:
        """This state moved by a tangent vector, shape (n,), or by each of M, shape (M, n)."""
        if d.ndim == 2:
            return State(*kernels.plus(self.R, self.y, d, self.rot), self.rot)
        R, y = kernels.plus(self.R, self.y, d[None], self.rot)
        return State(R[0], y[0], self.rot)

    def to(self, other: State) -> FloatArray:
        """The tangent vectors from this state to the other, or to each of M others: the inverse of :meth:`plus`."""
        if other.y.ndim == 2:
            d: FloatArray = kernels.minus(other.R, other.y, self.R, self.y, self.rot)
            return d
        return np.asarray(kernels.minus(other.R[None], other.y[None], self.R, self.y, self.rot)[0])

    def core(self, n: int) -> State:
        """The first n numbers of one state alone, the rotation that begins them included, and no other."""
        return State(self.R[:1], self.y[:n], self.rot[:1])

    def with_core(self, core: State) -> State:
        """This state with its first numbers and its first rotation replaced."""
        y = np.concatenate([core.y, self.y[core.size :]])
        return State(np.concatenate([core.R, self.R[1:]]), y, self.rot)


@dataclass(frozen=True, eq=False)
class Belief:
    """A Gaussian on a manifold."""

    t_ns: int
    x: State
    S: FloatArray
    """Lower-triangular root of the covariance of the tangent at ``x``, shape (n, n)."""

    @property
    def P(self) -> FloatArray:
        """Covariance, shape (n, n)."""
        P: FloatArray = self.S @ self.S.T
        return P

    def grown(self, factor: float) -> Belief:
        """The covariance multiplied by a factor."""
        return replace(self, S=np.sqrt(factor) * self.S)
