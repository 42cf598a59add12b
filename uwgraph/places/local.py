"""Local features: OpenCV's SIFT or ORB, the strongest of every cell of a grid, so that they cover the image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from uwgraph.dive.rig import NonNegative, Settings
from uwgraph.places.enhance import Enhancement, Grey, enhance
from uwgraph.types import FloatArray

MAX_DETECTED: Final = 20_000
"""OpenCV stops after the strongest so many, so that a noisy image cannot take forever."""
MIN_SIDE: Final = 16
"""Narrower images have no features."""


class LocalSettings(Settings):
    """How features are found."""

    kind: Literal["sift", "orb"] = "sift"
    limit: Annotated[int, Field(ge=8, le=MAX_DETECTED)] = 1200
    """Most features of an image."""
    rows: Annotated[int, Field(ge=1, le=64)] = 6
    columns: Annotated[int, Field(ge=1, le=64)] = 8
    """The grid; every cell keeps its share of the limit, and what others leave over goes to the strongest."""
    max_side: Annotated[int, Field(ge=64, le=8192)] = 800
    """Larger images are reduced to this many pixels along their longer side."""
    contrast: NonNegative = 0.02
    """SIFT's contrast threshold; lower than OpenCV's own, for water."""
    upright: bool = False
    """Take every feature as upright: better where the camera never rolls, useless where it does."""

    @property
    def width(self) -> int:
        """Numbers of a local descriptor as a vocabulary sees it."""
        return 256 if self.kind == "orb" else 128


@dataclass(frozen=True, eq=False)
class LocalFeatures:
    """Features of one image, the strongest first."""

    uv: FloatArray
    """Pixels (u, v) in the image as it was given, shape (N, 2)."""
    descriptors: NDArray[Any]
    """RootSIFT, float32, shape (N, 128), unit length; or ORB, uint8, shape (N, 32), 256 bits."""

    def __len__(self) -> int:
        return len(self.uv)


def features_of(
    image: NDArray[Any], how: Enhancement = "clahe", settings: LocalSettings | None = None, mask: Grey | None = None
) -> LocalFeatures:
    """The features of the enhanced image (:func:`enhance`); ``mask`` is used where it has the size of the image."""
    grey = enhance(image, how, mask)
    return extract(grey, settings, mask if mask is not None and mask.shape == grey.shape else None)


def extract(grey: Grey, settings: LocalSettings | None = None, mask: Grey | None = None) -> LocalFeatures:
    """The features of an 8-bit grey image (H, W) where ``mask`` (H, W) is not 0; none where there is nothing to see.

    The same image gives the same features in the same order. RootSIFT: Arandjelovic & Zisserman, CVPR 2012.
    """
    settings = settings or LocalSettings()
    width = 32 if settings.kind == "orb" else 128
    none = LocalFeatures(np.zeros((0, 2)), np.zeros((0, width), np.uint8 if width == 32 else np.float32))
    small, scale = _reduced(grey, settings.max_side)
    if min(small.shape) < MIN_SIDE:
        return none
    small_mask = None if mask is None else cv2.resize(mask, small.shape[::-1], interpolation=cv2.INTER_NEAREST)
    detector = _detector(settings)
    points = detector.detect(small, small_mask)
    if not points:
        return none
    points = [points[i] for i in _spread(points, small.shape, settings)]
    if settings.upright:
        for point in points:
            point.angle = 0.0
    points, descriptors = detector.compute(small, points)
    if descriptors is None or not len(points):
        return none
    uv = (np.array([p.pt for p in points], dtype=np.float64) + 0.5) / scale - 0.5
    return LocalFeatures(uv, descriptors if settings.kind == "orb" else root(descriptors))


def root(sift: NDArray[Any]) -> NDArray[np.float32]:
    """RootSIFT of SIFT descriptors (N, 128): unit length in the Hellinger sense."""
    total = np.maximum(sift.sum(axis=1, keepdims=True, dtype=np.float32), 1e-12)
    return np.asarray(np.sqrt(sift / total), dtype=np.float32)


def _reduced(grey: Grey, max_side: int) -> tuple[Grey, FloatArray]:
    """The image no longer than ``max_side``, and its size over the given one along columns and rows, shape (2,)."""
    factor = min(1.0, max_side / max(grey.shape))
    if factor == 1.0:
        return grey, np.ones(2)
    size = [max(1, round(n * factor)) for n in grey.shape[::-1]]
    small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return small, np.array(size) / grey.shape[::-1]


def _detector(settings: LocalSettings) -> Any:
    if settings.kind == "orb":
        return cv2.ORB.create(nfeatures=min(8 * settings.limit, MAX_DETECTED), fastThreshold=10)
    # without precise doubling of the image every feature is a quarter of a pixel off, in turned views to either side
    return cv2.SIFT.create(nfeatures=MAX_DETECTED, contrastThreshold=settings.contrast, enable_precise_upscale=True)


def _spread(points: Any, shape: tuple[int, ...], settings: LocalSettings) -> NDArray[np.intp]:
    """Indices of the features to keep: each cell's strongest first, the rest by strength."""
    place = np.array([p.pt for p in points])
    cells = np.array([settings.columns, settings.rows])
    column, row = np.clip(place * cells / shape[1::-1], 0, cells - 1).astype(np.intp).T
    cell = row * settings.columns + column
    response = np.array([p.response for p in points])
    order = np.lexsort((place[:, 0], place[:, 1], -response))
    by_cell = order[np.argsort(cell[order], kind="stable")]
    first = np.searchsorted(cell[by_cell], cell[by_cell])
    rank = np.empty(len(points), np.intp)
    rank[by_cell] = np.arange(len(points)) - first
    share = max(1, settings.limit // int(cells.prod()))
    kept = order[np.argsort(rank[order] >= share, kind="stable")][: settings.limit]
    return np.asarray(kept[np.argsort(-response[kept], kind="stable")])
