"""Which feature of one image is which of another.

Mutual nearest neighbours pass where they are clearly nearer than the second neighbour (Lowe, IJCV 2004) and than any
feature elsewhere in either image: a tile's corner that its own image holds a hundred times tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.places.local import LocalFeatures
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
    index, first, second = _nearest(a.features, b.features)
    back, _, second_back = _nearest(b.features, a.features)
    mutual = np.flatnonzero(back[index] == np.arange(len(a)))
    partner = index[mutual]
    noise = NOISE[a.features.descriptors.dtype]
    rival = np.minimum.reduce([second[mutual], second_back[partner], a.twins[mutual], b.twins[partner]])
    return Matches(mutual, partner, np.maximum(first[mutual], noise) < RATIO * rival)


def twin_distances(features: LocalFeatures) -> FloatArray:
    """Descriptor distance to the most alike feature elsewhere in the same image, shape (N,)."""
    if len(features) < 2:
        return np.full(len(features), FAR)
    index, distance = _neighbours(features, features)
    elsewhere = np.linalg.norm(features.uv[index] - features.uv[:, None], axis=2) > APART
    return np.asarray(np.where(elsewhere, distance, FAR).min(axis=1))


def _nearest(a: LocalFeatures, b: LocalFeatures) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """The nearest feature of b, its distance, and that of the next one elsewhere, each of shape (N,)."""
    index, distance = _neighbours(a, b)
    elsewhere = np.linalg.norm(b.uv[index] - b.uv[index[:, :1]], axis=2) > APART
    return index[:, 0], distance[:, 0], np.where(elsewhere, distance, FAR).min(axis=1)


def _neighbours(a: LocalFeatures, b: LocalFeatures) -> tuple[NDArray[np.intp], FloatArray]:
    """The nearest features of b and their distances, (N, k) each, nearest first."""
    k = min(NEIGHBOURS, len(b))
    norm = cv2.NORM_HAMMING if a.descriptors.dtype == np.uint8 else cv2.NORM_L2
    found = cv2.BFMatcher(norm).knnMatch(a.descriptors, b.descriptors, k)
    pairs = np.array([[(m.trainIdx, m.distance) for m in row] for row in found])
    return pairs[..., 0].astype(np.intp), pairs[..., 1]
