"""Random fields on an endless plane: the value at a place depends on the place and the seed alone.

So every tile can be made by itself, in any order, and meets its neighbours without a seam.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.float32]
Whole = NDArray[np.int64]

_VALUE_SIGMA: Final = np.sqrt(1.0 / 3.0) * 151.0 / 315.0
"""1-sigma of a bicubic B-spline through uniform values in [-1, 1], averaged over the plane."""


@dataclass(frozen=True)
class Grid:
    """Nodes ``(first + k) * step`` along north (rows) and east (columns)."""

    first: tuple[int, int]
    shape: tuple[int, int]
    step: float
    """m."""

    @property
    def north(self) -> Single:
        """North of the rows, m, shape (rows,)."""
        return self._axis(0)

    @property
    def east(self) -> Single:
        """East of the columns, m, shape (columns,)."""
        return self._axis(1)

    def _axis(self, axis: int) -> Single:
        return ((self.first[axis] + np.arange(self.shape[axis])) * self.step).astype(np.float32)

    def cells(self, size: float, margin: float) -> list[tuple[int, int]]:
        """The square cells of a ``size`` whose content, reaching ``margin`` beyond them, can touch the grid."""
        low, high = zip(*(self._reach(axis, size, margin) for axis in (0, 1)), strict=True)
        return [(i, j) for i in range(low[0], high[0]) for j in range(low[1], high[1])]

    def _reach(self, axis: int, size: float, margin: float) -> tuple[int, int]:
        first, last = (self.first[axis] * self.step, (self.first[axis] + self.shape[axis] - 1) * self.step)
        return int(np.floor((first - margin) / size)), int(np.floor((last + margin) / size)) + 1

    def around(self, north: float, east: float, radius: float) -> tuple[slice, slice]:
        """Rows and columns within ``radius`` of a place; may be empty."""
        rows, columns = (
            slice(
                max(int(np.ceil((x - radius) / self.step)) - first, 0),
                max(min(int(np.floor((x + radius) / self.step)) - first + 1, count), 0),
            )
            for x, first, count in zip((north, east), self.first, self.shape, strict=True)
        )
        return rows, columns


def cell_rng(seed: int, layer: int, cell: tuple[int, int]) -> np.random.Generator:
    """The generator of what lies in one cell of a layer."""
    return np.random.default_rng([seed, layer, cell[0] % 2**32, cell[1] % 2**32])


def field(seed: int, layer: int, grid: Grid, size: float) -> Single:
    """Smooth noise of mean 0 and variance 1 whose features are about ``size`` [m] across; the shape of the grid."""
    rows, i = _spline(grid.first[0], grid.shape[0], grid.step / size)
    columns, j = _spline(grid.first[1], grid.shape[1], grid.step / size)
    values = 2.0 * _uniform(seed, layer, i[:, None], j[None, :]) - 1.0
    made: Single = rows @ (values / np.float32(_VALUE_SIGMA)) @ columns.T
    return made


def fractal(seed: int, layer: int, grid: Grid, largest: float, smallest: float, roughness: float = 0.5) -> Single:
    """Octaves of :func:`field`, ``largest`` to ``smallest`` [m], each ``roughness`` of the one before; variance 1."""
    count = max(int(np.floor(np.log2(largest / smallest) + 1e-9)) + 1, 1)
    weight = roughness ** np.arange(count)
    weight /= np.linalg.norm(weight)
    total = np.zeros(grid.shape, dtype=np.float32)
    for octave in range(count):
        total += np.float32(weight[octave]) * field(seed, layer + octave, grid, largest * 0.5**octave)
    return total


def _spline(first: int, count: int, ratio: float) -> tuple[Single, Whole]:
    """Uniform cubic B-spline from lattice values to nodes, shape (count, L), and the lattice's indices (L,)."""
    x = (first + np.arange(count)) * ratio
    cell = np.floor(x).astype(np.int64)
    u = x - cell
    taps = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], axis=1) / 6.0
    lattice = np.arange(cell[0] - 1, cell[-1] + 3)
    weights = np.zeros((count, len(lattice)), dtype=np.float32)
    np.put_along_axis(weights, (cell - cell[0])[:, None] + np.arange(4), taps.astype(np.float32), axis=1)
    return weights, lattice


def _uniform(seed: int, layer: int, i: Whole, j: Whole) -> Single:
    """Hash of integers to [0, 1): the finaliser of splitmix64 (Steele et al., OOPSLA 2014), twice."""
    key = np.array([seed, layer], dtype=np.uint64)
    h = _mix(i.astype(np.uint64) + _mix(key[:1] + np.uint64(1)))
    h = _mix(h ^ _mix(j.astype(np.uint64) + _mix(key[1:] + np.uint64(2))))
    return ((h >> np.uint64(40)).astype(np.float32)) * np.float32(2.0**-24)


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    x = x * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))
