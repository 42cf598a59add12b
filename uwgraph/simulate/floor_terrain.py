"""The sea floor: heights and albedo on an endless metric grid in north and east, made where they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uwgraph.simulate.floor_model import Ground
from uwgraph.simulate.floor_noise import Grid, Single, fractal
from uwgraph.simulate.floor_photos import Photo
from uwgraph.simulate.floor_stones import raise_stones
from uwgraph.simulate.floor_texture import Texture
from uwgraph.types import FloatArray

TEXEL_M: Final = 0.004
HEIGHT_STEP_M: Final = 0.008
_EARTH_M: Final = 6.371e6
_RELIEF, _RIPPLE = 10, 40
_RIPPLE_M: Final = 0.003


class Tiles:
    """Square tiles of a grid, made on demand; the last used ones are kept."""

    def __init__(self, make: Callable[[Grid], NDArray[Any]], step: float, size: int, keep: int) -> None:
        self.step, self.size = step, size

        def made(i: int, j: int) -> NDArray[Any]:
            return make(Grid((i * size, j * size), (size, size), step))

        self._tile = lru_cache(maxsize=keep)(made)

    def crop(self, first: tuple[int, int], shape: tuple[int, int]) -> NDArray[Any]:
        """The nodes from ``first`` on, shape (rows, columns, ...)."""
        low = [index // self.size for index in first]
        high = [(index + count - 1) // self.size + 1 for index, count in zip(first, shape, strict=True)]
        rows = []
        for i in range(low[0], high[0]):
            r0, r1 = self._part(i, first[0], shape[0])
            parts = []
            for j in range(low[1], high[1]):
                c0, c1 = self._part(j, first[1], shape[1])
                parts.append(self._tile(i, j)[r0:r1, c0:c1])
            rows.append(np.concatenate(parts, axis=1))
        return np.concatenate(rows, axis=0)

    def _part(self, tile: int, first: int, count: int) -> tuple[int, int]:
        begin = tile * self.size
        return max(first - begin, 0), min(first + count - begin, self.size)

    def at(self, ne: ArrayLike) -> NDArray[Any]:
        """Bilinear values at places (N, 2): north, east [m]."""
        x = np.atleast_2d(np.asarray(ne, dtype=np.float64)) / self.step
        whole = np.floor(x).astype(np.int64)
        part = x - whole
        group = np.unique(whole // self.size, axis=0, return_inverse=True)[1].ravel()
        order = np.argsort(group, kind="stable")
        found: list[NDArray[Any]] = []
        for members in np.split(order, np.cumsum(np.bincount(group))[:-1]):
            corner = whole[members].min(axis=0)
            count = whole[members].max(axis=0) + 2 - corner
            nodes = self.crop((int(corner[0]), int(corner[1])), (int(count[0]), int(count[1]))).astype(np.float64)
            (i, j), (u, v) = (whole[members] - corner).T, part[members].T
            shape = (-1,) + (1,) * (nodes.ndim - 2)
            u, v = u.reshape(shape), v.reshape(shape)
            found.append(
                (nodes[i, j] * (1 - v) + nodes[i, j + 1] * v) * (1 - u)
                + (nodes[i + 1, j] * (1 - v) + nodes[i + 1, j + 1] * v) * u
            )
        values = np.concatenate(found)
        made = np.empty_like(values)
        made[order] = values
        return made


class Terrain:
    """The floor of one simulated dive, in its navigation frame.

    Parameters
    ----------
    ground : Ground
    seed : int
    depth : float
        m, of the mean floor below the sea surface.
    photos : sequence of Photo
        Stock of texture; heights do not depend on it.
    photo_pixel_m : float
        Size of its pixels.
    """

    def __init__(
        self,
        ground: Ground,
        seed: int,
        depth: float,
        photos: Sequence[Photo] = (),
        photo_pixel_m: float = 0.875 * TEXEL_M,
    ) -> None:
        self.ground, self.seed, self.depth = ground, seed, depth
        texture = Texture(ground, seed, photos, photo_pixel_m)
        self.colours: Final = Tiles(texture, TEXEL_M, 512, keep=256)
        """Albedo, coded: see :func:`uwgraph.simulate.floor_texture.decoded`."""
        self.heights: Final = Tiles(self._relief, HEIGHT_STEP_M, 256, keep=512)
        """m above the mean floor."""

    def height(self, ne: ArrayLike) -> FloatArray:
        """Height above the mean floor, m, shape (N,), at (north, east), shape (N, 2): bilinear between nodes."""
        return np.asarray(self.heights.at(ne), dtype=np.float64)

    def down(self, ne: ArrayLike) -> FloatArray:
        """D of the floor in n, m, shape (N,): the Earth's curve included."""
        places = np.atleast_2d(np.asarray(ne, dtype=np.float64))
        return self.mean_down(places) - self.height(places)

    def mean_down(self, ne: FloatArray) -> FloatArray:
        """D of the mean floor, m, shape (...,), at (..., 2)."""
        down: FloatArray = self.depth - (ne**2).sum(axis=-1) / (2.0 * _EARTH_M)
        return down

    def albedo(self, ne: ArrayLike) -> FloatArray:
        """Blue, green and red reflectance, shape (N, 3), at (north, east), shape (N, 2)."""
        code = np.clip(self.colours.at(ne), 0.0, 255.0)
        return np.asarray((code / 255.0) ** 2, dtype=np.float64)

    def _relief(self, grid: Grid) -> Single:
        height = np.zeros(grid.shape, dtype=np.float32)
        if self.ground.texture == "tiles":
            return height
        height += np.float32(self.ground.relief) * fractal(self.seed, _RELIEF, grid, 20.0, 0.6)
        height += np.float32(_RIPPLE_M) * fractal(self.seed, _RIPPLE, grid, 0.3, 0.05, 0.6)
        if self.ground.texture == "natural":
            raise_stones(height, self.seed, grid, self.ground.stones)
        return height
