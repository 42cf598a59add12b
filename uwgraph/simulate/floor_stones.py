"""Stones, pebbles and shells: each drawn once from the seed and its cell, with its own outline."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from uwgraph.simulate.floor_noise import Grid, Single, cell_rng, field

_LAYER: Final = 100
_CELL_M: Final = 1.0
_WAVES: Final = np.arange(2, 6)
"""Of an outline, per turn."""
_SKIRT: Final = 1.5
"""Radii that a stone with its bays, its capes and its dark foot reaches at most."""


@dataclass(frozen=True)
class Kind:
    """One size class."""

    layer: int
    radius: tuple[float, float]
    """Smallest and largest, m; small ones are more frequent."""
    per_m2: float
    height: float
    """Over the smaller half axis; small enough for the slopes to stay below 45 degrees."""
    tone: tuple[float, float]
    """Range of the albedo."""


STONES: Final = Kind(_LAYER, (0.05, 0.30), 0.9, 0.42, (0.08, 0.36))
PEBBLES: Final = Kind(_LAYER + 1, (0.014, 0.05), 10.0, 0.40, (0.06, 0.45))
SHELLS: Final = Kind(_LAYER + 2, (0.008, 0.024), 2.5, 0.20, (0.45, 0.85))
KINDS: Final = (PEBBLES, SHELLS, STONES)


@dataclass(frozen=True, eq=False)
class Stone:
    """One of them, in n."""

    north: float
    east: float
    axes: tuple[float, float]
    """Half axes, m."""
    turn: float
    """Of the first axis from north to east, rad."""
    phases: Single
    lobes: Single
    height: float
    colour: Single
    """Albedo, shape (3,): blue, green, red."""

    @property
    def reach(self) -> float:
        """m, from the middle; nothing of it lies beyond."""
        return _SKIRT * max(self.axes)

    def distance(self, grid: Grid, near: tuple[slice, slice]) -> Single:
        """0 in the middle and 1 at the outline, at nodes of the grid."""
        dn = (grid.north[near[0]] - np.float32(self.north))[:, None]
        de = (grid.east[near[1]] - np.float32(self.east))[None, :]
        z = (dn + 1j * de) * np.complex64(np.exp(-1j * self.turn))
        z = z.real / np.float32(self.axes[0]) + np.complex64(1j) * (z.imag / np.float32(self.axes[1]))
        rho = np.abs(z)
        z /= np.maximum(rho, np.float32(1e-6))
        outline, power = np.ones_like(rho), z
        for lobe, phase in zip(self.lobes, self.phases, strict=True):
            power = power * z
            outline += (np.complex64(lobe * np.exp(1j * phase)) * power).real
        return np.asarray(rho / outline, dtype=np.float32)


def stones_near(seed: int, grid: Grid, density: float) -> Iterator[tuple[Stone, tuple[slice, slice]]]:
    """Those that touch the grid, always in the same order, and where."""
    for kind in KINDS:
        for cell in grid.cells(_CELL_M, _SKIRT * kind.radius[1]):
            for stone in _in_cell(seed, kind, cell, density):
                near = grid.around(stone.north, stone.east, stone.reach)
                if all(part.stop > part.start for part in near):
                    yield stone, near


@lru_cache(maxsize=4096)
def _in_cell(seed: int, kind: Kind, cell: tuple[int, int], density: float) -> tuple[Stone, ...]:
    rng = cell_rng(seed, kind.layer, cell)
    rocky = field(seed, kind.layer + 50, Grid(cell, (1, 1), _CELL_M), 5.0)[0, 0]
    count = rng.poisson(kind.per_m2 * _CELL_M**2 * density * np.exp(0.8 * rocky - 0.3))
    return tuple(_drawn(kind, cell, rng) for _ in range(count))


def _drawn(kind: Kind, cell: tuple[int, int], rng: np.random.Generator) -> Stone:
    u = rng.random(6)
    small, large = kind.radius
    radius = small * (large / small) ** (u[0] ** 1.7)
    axes = (radius, radius * (0.6 + 0.4 * u[1]))
    tone = kind.tone[0] + (kind.tone[1] - kind.tone[0]) * u[2] ** 1.5
    tint = 1.0 + np.array([-0.16, 0.0, 0.16]) * (u[3] - 0.25) * 2.0
    return Stone(
        north=(cell[0] + u[4]) * _CELL_M,
        east=(cell[1] + u[5]) * _CELL_M,
        axes=axes,
        turn=rng.uniform(0.0, np.pi),
        phases=rng.uniform(0.0, 2.0 * np.pi, len(_WAVES)).astype(np.float32),
        lobes=(rng.uniform(0.0, 0.16, len(_WAVES)) / np.sqrt(_WAVES - 1.0)).astype(np.float32),
        height=kind.height * axes[1],
        colour=(tone * tint).astype(np.float32),
    )


def raise_stones(height: Single, seed: int, grid: Grid, density: float) -> None:
    """Put the stones' bodies onto a relief: domes of (1 + cos) whose slopes are moderate all over."""
    tops = np.zeros_like(height)
    for stone, near in stones_near(seed, grid, density):
        body = 0.5 * stone.height * (1.0 + np.cos(np.pi * np.minimum(stone.distance(grid, near), 1.0)))
        np.maximum(tops[near], body, out=tops[near])
    height += tops


def paint_stones(albedo: Single, grain: Single, seed: int, grid: Grid, density: float) -> None:
    """Colour the stones into an albedo (rows, columns, 3); ``grain`` is noise of variance 1, the same everywhere."""
    for stone, near in stones_near(seed, grid, density):
        rho = stone.distance(grid, near)
        edge = max(0.12, 1.2 * grid.step / stone.axes[1])
        inside = np.clip((1.0 - rho) / edge + 0.5, 0.0, 1.0)[..., None]
        foot = (1.0 - 0.45 * np.exp(-np.square((rho - 1.0) / 0.2)))[..., None]
        skin = stone.colour * np.exp(0.28 * grain[near])[..., None]
        albedo[near] = (albedo[near] * (1.0 - inside) + skin * inside) * foot
