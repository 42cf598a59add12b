"""Target neighbours and impostors of large-margin nearest neighbours.

Points are sorted by class throughout: a class is a slice, and pairs within it are struck out block by block.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from sklearn.neighbors import NearestNeighbors

from uwgraph.types import FloatArray

IndexArray = NDArray[np.intp]

BLOCK = 1 << 20
"""Entries of the largest temporary array: what bounds the memory."""
COARSE = 0.1
"""Largest error of a squared distance in single precision (in margins) with which impostors are still sought in it."""
DENSE = 1.0 / 16.0
"""Share of pairs above which a full matrix product is faster than one pair after the other."""


@dataclass(frozen=True, eq=False)
class Impostors:
    """Pairs (i, l) of different class with |y_i - y_l|^2 below the radius of i, of a block of points i."""

    rows: slice
    """The block."""
    i: IndexArray
    """Sorted, counted from the start of the block."""
    l: IndexArray  # noqa: E741
    distance: FloatArray
    """Squared."""


def class_starts(labels: IndexArray) -> IndexArray:
    """Where each class of sorted ``labels`` starts, and the number of points at the end, shape (C + 1,)."""
    return np.append(np.flatnonzero(np.diff(labels, prepend=-1)), len(labels))


def target_neighbours(Y: FloatArray, starts: IndexArray, k: int) -> IndexArray:
    """The ``k`` nearest points of the same class, shape (N, k); -1 where the class has no more."""
    targets = np.full((len(Y), k), -1, dtype=np.intp)
    for a, b in pairwise(starts):
        count = min(k, b - a - 1)
        if count > 0:
            nearest = NearestNeighbors(n_neighbors=count).fit(Y[a:b]).kneighbors(return_distance=False)
            targets[a:b, :count] = a + nearest
    return targets


def squared_distances(Y: FloatArray, i: IndexArray, j: IndexArray) -> FloatArray:
    """|y_i - y_j|^2 of pairs, without cancellation, in blocks."""
    out = np.empty(len(i))
    step = max(1, BLOCK // max(1, Y.shape[1]))
    for a in range(0, len(i), step):
        part = slice(a, a + step)
        difference = Y[i[part]] - Y[j[part]]
        out[part] = np.einsum("ij,ij->i", difference, difference)
    return out


def impostors(Y: FloatArray, starts: IndexArray, radius: FloatArray) -> Iterator[Impostors]:
    """All impostors, block by block of rows i; ``radius`` is squared, shape (N,), with -inf for points without targets.

    A matrix product proposes pairs, with the tolerance of its rounding; the distances of the proposed ones decide.
    """
    n = len(Y)
    square = np.einsum("ij,ij->i", Y, Y)
    # |y_i - y_l|^2 - radius_i as one product
    left = np.column_stack([-2.0 * Y, np.ones(n), square - np.where(np.isfinite(radius), radius, 0.0)])
    right = np.column_stack([Y, square, np.ones(n)])
    error = 8.0 * (Y.shape[1] + 4) * float(square.max() + np.max(radius, initial=0.0))
    single = error * np.finfo(np.float32).eps <= COARSE
    tolerance = error * np.finfo(np.float32 if single else np.float64).eps
    quick_left, quick_right = (a.astype(np.float32) if single else a for a in (left, right))
    for a in range(0, n, max(1, BLOCK // n)):
        rows = slice(a, min(a + max(1, BLOCK // n), n))
        excess = quick_left[rows] @ quick_right.T
        _strike_out_classes(excess, a, starts)
        excess[~np.isfinite(radius[rows])] = np.inf
        pairs = np.flatnonzero(excess < tolerance)
        i, l = np.divmod(pairs, n)  # noqa: E741
        if len(pairs) > DENSE * excess.size:
            distance = np.maximum((left[rows] @ right.T).ravel()[pairs] + radius[rows][i], 0.0)
        else:
            distance = squared_distances(Y, i + a, l)
        near = distance < radius[rows][i]
        yield Impostors(rows, i[near], l[near], distance[near])


def _strike_out_classes(excess: NDArray[np.floating], first: int, starts: IndexArray) -> None:
    """Set the pairs of the same class to infinity; the rows are the points from ``first`` on."""
    last = first + len(excess)
    c = int(np.searchsorted(starts, first, side="right")) - 1
    while starts[c] < last:
        a, b = starts[c], starts[c + 1]
        excess[max(a - first, 0) : b - first, a:b] = np.inf
        c += 1
