"""Which feature of one image is which of another.

Mutual nearest neighbours pass where they are clearly nearer than the second neighbour (Lowe, IJCV 2004) and than any
feature elsewhere in either image: a tile's corner that its own image holds a hundred times tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.places.local import LocalFeatures
from uwgraph.places.vlad import as_floats
from uwgraph.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from uwgraph.places.view import View

RATIO: Final = 0.8
"""A match is nearer than this part of the distance to the next likely one."""
APART: Final = 4.0
"""Pixels; features closer than this are the same thing found twice."""
NOISE: Final = {np.dtype(np.float32): 0.2, np.dtype(np.uint8): 12.0}
"""Distance that the same point has from itself in another image: RootSIFT, and bits of ORB."""
NEIGHBOURS: Final = 6
FAR: Final = 1e9
"""Distance of a neighbour that does not exist."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Pairs of features of two views."""

    a: NDArray[np.intp]
    """Indices in the first view, shape (M,)."""
    b: NDArray[np.intp]
    """Indices in the second view, shape (M,)."""
    distinct: BoolArray
    """Whether nothing else in either image looks like it, shape (M,)."""

    def __len__(self) -> int:
        return len(self.a)

    def select(self, index: BoolArray) -> Matches:
        """Those that a mask picks."""
        return Matches(self.a[index], self.b[index], self.distinct[index])


def match(a: View, b: View) -> Matches:
    """Mutual nearest neighbours of two views' features."""
    if not (len(a) and len(b)):
        return Matches(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0, np.bool_))
    likeness = _likeness(a.features, b.features)
    index, first, second = _nearest(likeness, b.features)
    back, _, second_back = _nearest(np.ascontiguousarray(likeness.T), a.features)
    mutual = np.flatnonzero(back[index] == np.arange(len(a)))
    partner = index[mutual]
    noise = NOISE[a.features.descriptors.dtype]
    rival = np.minimum.reduce([second[mutual], second_back[partner], a.twins[mutual], b.twins[partner]])
    return Matches(mutual, partner, np.maximum(first[mutual], noise) < RATIO * rival)


def twin_distances(features: LocalFeatures) -> FloatArray:
    """Descriptor distance to the most alike feature elsewhere in the same image, shape (N,)."""
    if len(features) < 2:
        return np.full(len(features), FAR)
    index, distance = _neighbours(_likeness(features, features), features)
    elsewhere = np.linalg.norm(features.uv[index] - features.uv[:, None], axis=2) > APART
    return np.asarray(np.where(elsewhere, distance, FAR).min(axis=1))


def _likeness(a: LocalFeatures, b: LocalFeatures) -> NDArray[np.float32]:
    """Shape (N, M), the larger the nearer: cosines of RootSIFT, or equal bits less others of ORB."""
    if a.descriptors.dtype == np.uint8:
        x, y = (2.0 * as_floats(f.descriptors) - 1.0 for f in (a, b))
        return np.asarray(x @ y.T, dtype=np.float32)
    return np.asarray(a.descriptors @ b.descriptors.T, dtype=np.float32)


def _nearest(likeness: NDArray[np.float32], b: LocalFeatures) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """The nearest feature of b, its distance, and that of the next one elsewhere, each of shape (N,)."""
    index, distance = _neighbours(likeness, b)
    elsewhere = np.linalg.norm(b.uv[index] - b.uv[index[:, :1]], axis=2) > APART
    return index[:, 0], distance[:, 0], np.where(elsewhere, distance, FAR).min(axis=1)


def _neighbours(likeness: NDArray[np.float32], b: LocalFeatures) -> tuple[NDArray[np.intp], FloatArray]:
    """The nearest features of b and their distances, (N, k) each, nearest first."""
    k = min(NEIGHBOURS, len(b))
    index = np.argpartition(-likeness, k - 1, axis=1)[:, :k]
    found = np.take_along_axis(likeness, index, axis=1).astype(np.float64)
    order = np.lexsort((index, -found), axis=1)
    index, found = np.take_along_axis(index, order, axis=1), np.take_along_axis(found, order, axis=1)
    if b.descriptors.dtype == np.uint8:
        return index, 0.5 * (8 * b.descriptors.shape[1] - found)
    return index, np.sqrt(np.maximum(2.0 - 2.0 * found, 0.0))
