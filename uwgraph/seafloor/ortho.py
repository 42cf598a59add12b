"""The floor from directly above: textures laid onto a raster, later ones over earlier ones with soft edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.seafloor.patch import Colours, Patch
from uwgraph.types import BoolArray, FloatArray

FEATHER: Final = 0.15
"""Width of a texture's soft edge, in parts of its shorter side."""
_STRETCH: Final = 3.0
"""A pixel that covers so many times what is usual in its image is not drawn."""
_LARGEST: Final = 8_000_000
"""A texture is enlarged to no more pixels."""
_ROUND_A_GAP: Final = 4
"""Neighbours of 8 that make an empty pixel a gap."""

Canvas = NDArray[np.uint8]
"""Shape (H, W, 4): blue, green, red, and 255 where there is floor."""


@dataclass(frozen=True)
class Raster:
    """A grid of pixels seen from above: rows go south, columns go east."""

    north: float
    """North of the upper edge in n, m."""
    east: float
    """East of the left edge in n, m."""
    pixel: float
    """m."""
    height: int
    width: int

    @classmethod
    def around(cls, low: FloatArray, high: FloatArray, pixel: float, max_pixels: int) -> Raster:
        """The raster of the floor between two corners (north, east); its pixels grow where it would be too large."""
        span = np.maximum(high - low, pixel)
        pixel = max(pixel, float(np.sqrt(np.prod(span) / max_pixels)), float(span.max()) / max_pixels)
        height, width = (max(int(np.ceil(extent / pixel)), 1) for extent in span)
        return cls(float(high[0]), float(low[1]), pixel, height, width)

    def column_row(self, ne: FloatArray) -> FloatArray:
        """Columns and rows (edges at whole numbers) of north and east (..., 2)."""
        return np.stack([(ne[..., 1] - self.east) / self.pixel, (self.north - ne[..., 0]) / self.pixel], axis=-1)

    def blank(self) -> Canvas:
        return np.zeros((self.height, self.width, 4), dtype=np.uint8)


def lay(canvas: Canvas, raster: Raster, patch: Patch, R_nb: FloatArray, p_n: FloatArray) -> None:
    """Lay a patch's texture onto the canvas, in place."""
    at, texture = _dense(raster.column_row(patch.pixels_n(R_nb, p_n)[..., :2]), patch.texture)
    inside = _smooth(at)
    column, row = at[..., 0], at[..., 1]
    inside &= (column >= 0.0) & (column < raster.width) & (row >= 0.0) & (row < raster.height)
    if not inside.any():
        return
    cell = at[inside].astype(np.intp)
    low, high = cell.min(axis=0), cell.max(axis=0) + 1
    colours, seen = _gathered(cell - low, high - low, texture[inside])
    window = canvas[low[1] : high[1], low[0] : high[0]]
    share = np.where(window[..., 3] > 0, _soft(seen), seen.astype(np.float32))[..., None]
    mixed = window[..., :3] * (1.0 - share) + colours * share
    window[..., :3] = np.where(seen[..., None], mixed.round(), window[..., :3])
    window[..., 3] |= np.where(seen, np.uint8(255), np.uint8(0))


def _stretch(at: FloatArray) -> FloatArray:
    """Raster pixels from each pixel (H, W) to its neighbours, the most of all; NaN beside what is not known."""
    down, across = (_larger(np.abs(np.diff(at, axis=axis))) for axis in (0, 1))
    down, across = np.pad(down, ((1, 1), (0, 0)), mode="edge"), np.pad(across, ((0, 0), (1, 1)), mode="edge")
    return np.asarray(np.maximum.reduce([down[1:], down[:-1], across[:, 1:], across[:, :-1]]), dtype=np.float64)


def _larger(pair: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(pair[..., 0], pair[..., 1]))


def _dense(at: FloatArray, texture: Colours) -> tuple[FloatArray, Colours]:
    """Places (H, W, 2) and texture, enlarged where the raster is finer than they are."""
    stretch = _stretch(at)
    usual = float(np.median(stretch[np.isfinite(stretch)])) if np.isfinite(stretch).any() else 1.0
    times = int(np.clip(np.ceil(usual), 1, max(int(np.sqrt(_LARGEST / stretch.size)), 1)))
    if times == 1:
        return at, texture
    size = (at.shape[1] * times, at.shape[0] * times)
    larger = (cv2.resize(x, size, interpolation=cv2.INTER_LINEAR) for x in (at, texture))
    return np.asarray(next(larger), np.float64), np.asarray(next(larger), np.uint8)


def _gathered(
    cell: NDArray[np.intp], size: NDArray[np.intp], colours: NDArray[np.uint8]
) -> tuple[FloatArray, BoolArray]:
    """Mean colour (h, w, 3) of the texture's pixels in each pixel of a window, and where there are any."""
    width, height = size
    index = cell[:, 1] * width + cell[:, 0]
    count = np.bincount(index, minlength=width * height)
    sums = [np.bincount(index, colours[:, i], minlength=width * height) for i in range(3)]
    total = np.stack([*sums, count], axis=-1).reshape(height, width, 4)
    around = cv2.boxFilter(np.minimum(total, 1.0), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    gap = (total[..., 3] == 0) & (around[..., 3] >= _ROUND_A_GAP)
    total[gap] = cv2.boxFilter(total, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)[gap]
    seen = total[..., 3] > 0
    return total[..., :3] / np.maximum(total[..., 3:], 1), seen


def _smooth(at: FloatArray) -> BoolArray:
    """Pixels (H, W) that are known, and not stretched over the edge of an obstacle or by a mismatch."""
    stretch = _stretch(at)
    known = np.isfinite(stretch)
    known[known] = stretch[known] < _STRETCH * np.median(stretch[known])
    return np.asarray(known)


def _soft(seen: BoolArray) -> NDArray[np.float32]:
    """0 at the edge of what is seen, 1 from the feather's width inwards."""
    inner = cv2.distanceTransform(np.pad(seen, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    width = max(FEATHER * min(seen.shape), 1.0)
    return np.asarray(np.minimum(inner / width, 1.0), dtype=np.float32)
