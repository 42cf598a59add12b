"""Albedo of the floor, tile by tile: real photographs in pieces, or grown from noise, and stones upon it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.simulate.floor_model import Ground
from uwgraph.simulate.floor_noise import Grid, Single, cell_rng, field, fractal
from uwgraph.simulate.floor_photos import Photo
from uwgraph.simulate.floor_stones import paint_stones

Coded = NDArray[np.uint8]

PATCH_CELL_M: Final = 0.6
_PATCH_RADIUS_M: Final = 0.55
_BENDS: Final = ((0.025, 0.25), (0.06, 0.9))
"""1-sigma and size of what bends the photographs, m."""
_PATCH_REACH_M: Final = _PATCH_RADIUS_M + 3.0 * 0.065
_PATCH_SCALE: Final = (0.75, 1.3)
_GRAIN, _TONE, _HUE, _WARP, _WEED, _PATCH = 200, 220, 240, 260, 280, 300
_SAND: Final = np.array([0.17, 0.205, 0.225], dtype=np.float32)
_WEED_COLOUR: Final = np.array([0.045, 0.085, 0.07], dtype=np.float32)
_FINEST_M: Final = 0.016
_LINEAR: Final = (np.arange(256, dtype=np.float32) / np.float32(255.0)) ** 2


@dataclass(frozen=True, eq=False)
class Texture:
    """The floor's colours; blue, green, red as everywhere in OpenCV."""

    ground: Ground
    seed: int
    photos: Sequence[Photo] = ()
    photo_pixel_m: float = 0.0035

    def __call__(self, grid: Grid) -> Coded:
        """Albedo at the nodes, shape (rows, columns, 3), coded by a square root; see :func:`decoded`."""
        if self.ground.texture == "plain":
            grain = fractal(self.seed, _GRAIN, grid, 0.5, _FINEST_M, 0.8)
            return _coded(_SAND * np.exp(np.float32(0.03) * grain)[..., None])
        if self.ground.texture == "tiles":
            return self._repeated(grid)
        return _coded(self._natural(grid))

    def _repeated(self, grid: Grid) -> Coded:
        """One square of natural floor with a joint around it, again and again."""
        period = round(self.ground.tile_m / grid.step)
        one = self._natural(Grid((0, 0), (period, period), grid.step))
        joint = max(period // 30, 1)
        one[:joint] = one[:, :joint] = 0.05
        rows, columns = (
            (first + np.arange(n)) % period for first, n in zip(grid.first, grid.shape, strict=True)
        )  # fmt: skip
        return _coded(one[rows[:, None], columns[None, :]])

    def _natural(self, grid: Grid) -> Single:
        grain = fractal(self.seed, _GRAIN, grid, 0.256, _FINEST_M, 0.8)
        albedo = self._quilt(grid) if self.photos else self._grown(grid)
        tone = np.float32(0.3) * fractal(self.seed, _TONE, grid, 9.0, 0.5, 0.7) + np.float32(0.2) * grain
        hue = np.float32(0.08) * fractal(self.seed, _HUE, grid, 6.0, 1.0)
        albedo *= np.exp(np.stack([tone - hue, tone, tone + hue], axis=-1))
        paint_stones(albedo, grain, self.seed, grid, self.ground.stones)
        return albedo

    def _grown(self, grid: Grid) -> Single:
        """Sand and patches of weed."""
        sand = np.float32(0.3) * fractal(self.seed, _GRAIN + 10, grid, 1.0, _FINEST_M, 0.85)
        weed = fractal(self.seed, _WEED, grid, 1.6, 0.025, 0.6)
        share = (0.5 + 0.5 * np.tanh(5.0 * (weed - 0.5)))[..., None].astype(np.float32)
        colours: Single = (_SAND * (1.0 - share) + _WEED_COLOUR * share) * np.exp(sand)[..., None]
        return colours

    def _quilt(self, grid: Grid) -> Single:
        """Pieces of photographs, each turned, scaled, perhaps mirrored, and bent as nowhere else on the floor.

        What two places have of one photograph in common is thus not of one shape, and makes no false revisit.
        """
        north, east = grid.north[:, None] + self._bend(grid, 0), grid.east[None, :] + self._bend(grid, 5)
        weight = np.full((*grid.shape, 1), 1e-4, dtype=np.float32)
        total = weight * _SAND
        for cell in grid.cells(PATCH_CELL_M, _PATCH_REACH_M):
            rng = cell_rng(self.seed, _PATCH, cell)
            photo = self.photos[int(rng.integers(len(self.photos)))]
            centre = photo.centres[int(rng.integers(len(photo.centres)))]
            turn, mirror = rng.uniform(0.0, 2.0 * np.pi), rng.choice([-1.0, 1.0])
            scale = rng.uniform(*_PATCH_SCALE) * self.photo_pixel_m
            place = [(index + rng.uniform(0.3, 0.7)) * PATCH_CELL_M for index in cell]
            near = grid.around(place[0], place[1], _PATCH_REACH_M)
            dn, de = north[near] - np.float32(place[0]), east[near] - np.float32(place[1])
            inside = 1.0 - (dn * dn + de * de) * np.float32(_PATCH_RADIUS_M**-2)
            column, row, width, height = cv2.boundingRect((inside > 0.0).astype(np.uint8)) if dn.size else (0, 0, 0, 0)
            if not width:
                continue
            disc = np.s_[row : row + height, column : column + width]
            dn, de, inside = dn[disc], de[disc], np.maximum(inside[disc], np.float32(0.0))
            c, s = np.float32(np.cos(turn) / scale), np.float32(np.sin(turn) / scale)
            x = c * dn + s * de + np.float32(centre[0])
            y = np.float32(mirror) * (c * de - s * dn) + np.float32(centre[1])
            piece = cv2.remap(photo.texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
            share = np.square(np.square(np.float32(rng.uniform(0.4, 1.0)) * inside * piece[..., 3]))[..., None]
            total[near][disc] += piece[..., :3] * share
            weight[near][disc] += share
        quilt: Single = total / weight
        return quilt

    def _bend(self, grid: Grid, layer: int) -> Single:
        bend = np.zeros(grid.shape, dtype=np.float32)
        for number, (sigma, size) in enumerate(_BENDS):
            bend += np.float32(sigma) * field(self.seed, _WARP + layer + number, grid, size)
        return bend


def decoded(code: Coded) -> Single:
    """Albedo from its code."""
    return np.asarray(cv2.LUT(code, _LINEAR))


def _coded(albedo: Single) -> Coded:
    return np.asarray(np.rint(255.0 * np.sqrt(np.clip(albedo, 0.0, 1.0))), dtype=np.uint8)
