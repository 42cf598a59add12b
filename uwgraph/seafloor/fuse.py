"""Patches fused into one cloud, cell by cell.

Seen from above the floor is a grid of cells. What lies in one cell is averaged, weighted by inverse variance, and kept
apart only where a vertical gap is more than the points' own noise: an overhang, or a mismatch that cleaning takes away.
Within one keyframe errors are common: its points of one cell count as one observation of their mean variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.errors import ConfigError
from uwgraph.types import FloatArray

_GAP_SIGMAS: Final = 3.0
_BUFFER_ROWS: Final = 1_000_000
_REACH: Final = 1 << 30
"""Cells from the origin that an index can tell."""

_W, _P, _C, _DD, _COMMON, _COUNT = 0, slice(1, 4), slice(4, 7), 7, 8, 9
_COLUMNS: Final = 10


@dataclass(frozen=True, eq=False)
class Cloud:
    """The fused floor."""

    points_n: FloatArray
    """Shape (M, 3), m."""
    colours: NDArray[np.uint8]
    """Blue, green, red, shape (M, 3)."""
    sigma: FloatArray
    """1-sigma by the keyframes' own noise, without the errors of their poses, shape (M,), m."""
    spread: FloatArray
    """Vertical standard deviation among the keyframes that saw the cell, NaN where only one did, shape (M,), m."""
    keyframes: NDArray[np.int64]
    """How many keyframes saw it, shape (M,)."""

    def __len__(self) -> int:
        return len(self.points_n)

    def select(self, index: NDArray[np.bool_] | NDArray[np.intp]) -> Cloud:
        """The points that a mask or an index array picks."""
        points_n, colours, sigma = self.points_n[index], self.colours[index], self.sigma[index]
        return Cloud(points_n, colours, sigma, self.spread[index], self.keyframes[index])


class Fusion:
    """Sums per cell; memory grows with the area of the floor, not with the number of keyframes."""

    def __init__(self, voxel: float) -> None:
        self.voxel = voxel
        self._keys = np.zeros(0, dtype=np.int64)
        self._rows = np.zeros((0, _COLUMNS))
        self._waiting: list[tuple[NDArray[np.int64], FloatArray]] = []

    def add(self, points_n: FloatArray, colours: FloatArray, sigma: FloatArray, common: float = 0.0) -> None:
        """Add a keyframe's points (M, 3), colours (M, 3) and 1-sigma (M,); ``common``: what no second look averages."""
        if not len(points_n):
            return
        w = sigma**-2.0
        down = points_n[:, 2]
        rows = np.column_stack(
            [w, w[:, None] * points_n, w[:, None] * colours, w * down * down, w * common**2, np.ones(len(w))]
        )
        keys, rows = _merged(self._key(points_n), rows, self.voxel)
        rows[:, :_COUNT] /= rows[:, _COUNT:]
        mean = rows[:, _P][:, 2] / rows[:, _W]
        rows[:, _DD], rows[:, _COUNT] = rows[:, _W] * mean * mean, 1.0
        self._waiting.append((keys, rows))
        if sum(len(k) for k, _ in self._waiting) > _BUFFER_ROWS:
            self._flush()

    def cloud(self) -> Cloud:
        """What has been fused so far."""
        self._flush()
        rows = self._rows
        w, count = rows[:, _W], rows[:, _COUNT]
        mean = rows[:, _P] / w[:, None]
        variance = np.maximum(rows[:, _DD] / w - mean[:, 2] ** 2, 0.0)
        several = count > 1.5
        unbiased = variance * count / np.where(several, count - 1.0, 1.0)
        colours = np.clip(rows[:, _C] / w[:, None], 0.0, 255.0).astype(np.uint8)
        spread = np.where(several, np.sqrt(unbiased), np.nan)
        sigma = np.sqrt((1.0 + rows[:, _COMMON]) / w)
        return Cloud(mean, colours, sigma, spread, count.round().astype(np.int64))

    def _key(self, points_n: FloatArray) -> NDArray[np.int64]:
        cell = np.floor(points_n[:, :2] / self.voxel)
        if np.abs(cell).max() >= _REACH:
            raise ConfigError("is too small for so wide a map", where="voxel_m", remedy="give a larger one")
        key = cell.astype(np.int64)
        return np.asarray(key[:, 0] * (2 * _REACH) + key[:, 1])

    def _flush(self) -> None:
        if self._waiting:
            keys = np.concatenate([self._keys, *(k for k, _ in self._waiting)])
            rows = np.concatenate([self._rows, *(r for _, r in self._waiting)])
            self._keys, self._rows = _merged(keys, rows, self.voxel)
            self._waiting = []


def _merged(keys: NDArray[np.int64], rows: FloatArray, voxel: float) -> tuple[NDArray[np.int64], FloatArray]:
    """Rows of the same cell that no gap parts, summed."""
    down = rows[:, _P][:, 2] / rows[:, _W]
    order = np.lexsort((down, keys))
    keys, rows, down = keys[order], rows[order], down[order]
    variance = 1.0 / rows[:, _W]
    gap = np.diff(down) > voxel + _GAP_SIGMAS * np.sqrt(variance[1:] + variance[:-1])
    first = np.flatnonzero(np.concatenate([[True], (np.diff(keys) != 0) | gap]))
    return keys[first], np.add.reduceat(rows, first, axis=0)
