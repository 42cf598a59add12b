"""The nearest descriptors: a matrix product, no approximation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uwgraph.errors import DataError
from uwgraph.types import BoolArray, FloatArray, TimeArray

_FIRST: Final = 256
_REMEDY: Final = "leave out images without a descriptor, and use one model for all"


@dataclass(frozen=True, eq=False)
class Nearest:
    """What was found, the nearest first."""

    sample: NDArray[np.intp]
    """Numbers of the samples in the order in which they were added, shape (k,)."""
    distance: FloatArray
    """Squared, in the metric of the descriptors (d_M of the raw ones), shape (k,)."""


class Index:
    """Descriptors with stamps, which can be searched and added to."""

    def __init__(self, size: int) -> None:
        self._z = np.zeros((_FIRST, size), np.float32)
        self._square = np.zeros(_FIRST, np.float32)
        self._t_ns = np.zeros(_FIRST, np.int64)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def size(self) -> int:
        """Length of a descriptor."""
        return int(self._z.shape[1])

    @property
    def descriptors(self) -> NDArray[np.float32]:
        """Shape (N, size)."""
        return self._z[: self._count]

    @property
    def t_ns(self) -> TimeArray:
        """Stamps, shape (N,)."""
        return self._t_ns[: self._count]

    @property
    def nbytes(self) -> int:
        """Memory in use, bytes."""
        return self._z.nbytes + self._square.nbytes + self._t_ns.nbytes

    def add(self, z: ArrayLike, t_ns: int) -> int:
        """Add one descriptor, shape (size,), and return its index."""
        self.extend(np.atleast_2d(np.asarray(z, dtype=np.float32)), np.array([t_ns]))
        return self._count - 1

    def extend(self, Z: ArrayLike, t_ns: TimeArray) -> None:
        """Add descriptors, shape (N, size), with stamps, shape (N,).

        Raises
        ------
        DataError
            When they have another size or are not finite.
        """
        new = np.asarray(Z, dtype=np.float32)
        if new.ndim != 2 or new.shape[1] != self.size or len(new) != len(t_ns) or not np.all(np.isfinite(new)):
            raise DataError(
                f"descriptors of shape {new.shape} with {len(t_ns)} stamps cannot be kept beside ones of {self.size}",
                where="index",
                remedy=_REMEDY,
            )
        self._make_room(len(new))
        place = slice(self._count, self._count + len(new))
        self._z[place], self._t_ns[place] = new, t_ns
        self._square[place] = np.einsum("ij,ij->i", new, new)
        self._count += len(new)

    def search(
        self, z: ArrayLike, k: int = 5, *, t_ns: int | None = None, apart_s: float = 0.0, among: BoolArray | None = None
    ) -> Nearest:
        """The ``k`` nearest, or fewer, of the samples at least ``apart_s`` from ``t_ns`` in time and in ``among`` (N,).

        A single-precision product proposes; the distances of the proposed are exact.
        """
        query = self.checked(z)
        score = self._square[: self._count] - 2.0 * (self.descriptors @ query)
        if t_ns is not None and apart_s > 0.0:
            score[np.abs(self.t_ns - t_ns) < round(apart_s * 1e9)] = np.inf
        if among is not None:
            score[~among] = np.inf
        allowed = int(np.count_nonzero(np.isfinite(score)))
        proposed = min(allowed, 2 * k + 8)
        if proposed < 1 or k < 1:
            return Nearest(np.zeros(0, np.intp), np.zeros(0))
        near = np.argpartition(score, proposed - 1)[:proposed]
        distance = np.sum((self._z[near].astype(np.float64) - query) ** 2, axis=1)
        order = np.lexsort((near, distance))[:k]
        return Nearest(near[order], distance[order])

    def checked(self, z: ArrayLike) -> NDArray[np.float32]:
        """A descriptor of this index, shape (size,); raises :class:`DataError` for others."""
        query = np.asarray(z, dtype=np.float32)
        if query.shape != (self.size,) or not np.all(np.isfinite(query)):
            raise DataError(
                f"a descriptor of shape {query.shape} among ones of {self.size}, or not finite",
                where="index",
                remedy=_REMEDY,
            )
        return query

    def _make_room(self, more: int) -> None:
        need, room = self._count + more, len(self._t_ns)
        if need > room:
            extra = max(need, 2 * room) - room
            self._z = np.vstack([self._z, np.zeros((extra, self.size), np.float32)])
            self._square = np.append(self._square, np.zeros(extra, np.float32))
            self._t_ns = np.append(self._t_ns, np.zeros(extra, np.int64))
