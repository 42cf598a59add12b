"""Colours without the lamps' cone, the water's veil and the colour cast.

What a pixel sees on average over a dive is the light's, not the floor's. So every pixel and channel is brought to the
same mean and deviation (grey world per pixel: Johnson-Roberson et al. 2010, Journal of Field Robotics 27(1)), which
takes off the additive veil and the multiplicative loss at once; then each image as a whole to the dive's brightness.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.seafloor.patch import Colours
from uwgraph.types import FloatArray

MEAN: Final = 115.0
"""Brightness of the average floor in corrected images."""
DEVIATION: Final = 36.0
"""Standard deviation of brightness in corrected images."""
_CELLS: Final = 48
"""Width of the grid that the light is estimated on."""
_SMOOTH: Final = 3.0
"""Cells; the light is smooth, the floor is not."""
_ALIKE: Final = 1.25
"""Distances within this factor share the light."""
_ENOUGH: Final = 5
"""So many images tell a light of their own."""
_UNKNOWN: Final = np.iinfo(np.int64).min
_SAMPLE: Final = 100_000
"""Values of an image that tell its brightness."""
_LEAST: Final = 2.0
"""Grey levels: no channel is amplified as if it varied by less."""

Field = NDArray[np.float32]


def as_colours(image: NDArray[Any]) -> Colours:
    """An image as it was recorded, (H, W) or (H, W, 3) of 8 or 16 bits, in three colours of 8 bits."""
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image, dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Light:
    """What a camera sees on average, at every cell of a coarse grid."""

    mean: Field
    """Shape (rows, columns, 3)."""
    deviation: Field
    """Shape (rows, columns, 3)."""

    def corrected(self, image: Colours) -> Colours:
        """An image of the floor as under even, white light; its brightness is the dive's."""
        size = (image.shape[1], image.shape[0])
        mean, deviation = (
            cv2.resize(field, size, interpolation=cv2.INTER_LINEAR) for field in (self.mean, self.deviation)
        )
        even = (image.astype(np.float32) - mean) / deviation
        step = max(int(np.sqrt(even.size / _SAMPLE)), 1)
        even -= np.median(even[::step, ::step].reshape(-1, 3), axis=0)
        return np.asarray(np.clip(MEAN + DEVIATION * even, 0.0, 255.0), dtype=np.uint8)


def light_of(images: Iterable[Colours]) -> Light | None:
    """The light of a sample of a camera's images; None where there is none."""
    total: NDArray[Any] = np.zeros(0)
    squares: NDArray[Any] = np.zeros(0)
    count = 0
    for image in images:
        grid = (_CELLS, max(round(_CELLS * image.shape[0] / image.shape[1]), 2))
        levels = image.astype(np.float32)
        first, second = (cv2.resize(x, grid, interpolation=cv2.INTER_AREA) for x in (levels, levels * levels))
        total, squares = (total + first, squares + second) if count else (first, second)
        count += 1
    if not count:
        return None
    mean, square = (np.asarray(cv2.GaussianBlur(x / count, (0, 0), _SMOOTH), np.float32) for x in (total, squares))
    return Light(mean, np.sqrt(np.maximum(square - mean * mean, _LEAST**2)))


def bands(distance: FloatArray) -> NDArray[np.int64]:
    """Which images (N,) share a light: those from alike distances [m], if they are enough; the others join the nearest.

    Images from unknown (NaN) distances are a band of their own.
    """
    known = np.isfinite(distance)
    band = np.where(known, np.round(np.log(np.where(known, distance, 1.0)) / np.log(_ALIKE)), _UNKNOWN).astype(np.int64)
    names, counts = np.unique(band[known], return_counts=True)
    large = names[counts >= _ENOUGH] if (counts >= _ENOUGH).any() else names[[counts.argmax()]] if len(names) else names
    if len(large):
        band[known] = large[np.abs(band[known][:, None] - large).argmin(axis=1)]
    return band
