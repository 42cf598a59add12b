"""What a camera sees of the simulated floor: ray by ray to the terrain, its colour, the light, the water."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.model import Camera
from uwgraph.camera.refraction import refractive_index
from uwgraph.simulate.floor_light import Light
from uwgraph.simulate.floor_noise import Single
from uwgraph.simulate.floor_terrain import HEIGHT_STEP_M, TEXEL_M, Terrain
from uwgraph.simulate.floor_texture import decoded
from uwgraph.types import FloatArray

_ITERATIONS: Final = 6
_FLATTEST: Final = 0.1
"""Rays that go down less than this part of their length see no floor."""
_COARSE: Final = 16
_MARGIN_M: Final = 0.5
_FADED: Final = 1.5


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera and its rays in the water."""

    camera: Camera

    @cached_property
    def rays_b(self) -> Single:
        """Unit rays in body axes, shape (3, H, W); straight up where a pixel sees nothing."""
        rays = self.camera.outside(self.camera.pixels(), refractive_index())[0]
        rays = np.where(np.isfinite(rays).all(axis=1, keepdims=True), rays, [0.0, 0.0, -1.0])
        width, height = self.camera.size
        return np.ascontiguousarray(rays.T.reshape(3, height, width), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Sight:
    """Where rays meet the floor."""

    r: Single
    """Range, m; the farthest where nothing is met."""
    met: NDArray[np.bool_]
    step_ne: Single
    """From the camera to the floor, north and east, shape (2, H, W), m."""
    normal_n: Single
    """Unit normal of the floor, upwards, in n, shape (3, H, W)."""


def look(terrain: Terrain, p_n: FloatArray, rays_n: Single, farthest: float) -> Sight:
    """Rays (3, H, W) from ``p_n`` to the terrain.

    Fixed-point iteration on the height; it contracts since the slope of the floor times the tangent of the ray's angle
    from the vertical is below 1.
    """
    down = np.maximum(rays_n[2], np.float32(_FLATTEST))
    under = np.float32(terrain.mean_down(p_n[:2]) - p_n[2])
    slope_ne = rays_n[:2] / down
    drop = np.minimum(under, np.float32(farthest) * down)
    reach = float(np.abs(slope_ne * drop).max()) + _MARGIN_M + 4.0 * terrain.ground.relief
    patch = _Patch.around(terrain, p_n[:2], reach)
    for _ in range(_ITERATIONS):
        drop = under - patch.height(slope_ne * drop)
        np.minimum(drop, np.float32(farthest) * down, out=drop)
    r = np.maximum(drop / down, np.float32(0.0))
    met = (rays_n[2] > _FLATTEST) & (r < farthest * 0.999)
    step_ne = slope_ne * drop
    return Sight(np.where(met, r, np.float32(farthest)), met, step_ne, patch.normal(step_ne))


def ranges(terrain: Terrain, p_n: FloatArray, d_n: FloatArray, farthest: float) -> FloatArray:
    """Range, m, shape (N,), of the terrain from ``p_n`` along unit ``d_n``, (N, 3) each; NaN beyond ``farthest``."""
    r = np.full(len(p_n), np.nan)
    under = terrain.mean_down(p_n[:, :2]) - p_n[:, 2]
    near = np.flatnonzero((d_n[:, 2] > _FLATTEST) & (under < (farthest + _MARGIN_M) * d_n[:, 2]))
    p_n, d_n, under = p_n[near], d_n[near], under[near]
    found = under / d_n[:, 2]
    for _ in range(_ITERATIONS if len(near) else 0):
        found = (under - terrain.height(p_n[:, :2] + found[:, None] * d_n[:, :2])) / d_n[:, 2]
    r[near] = np.where((found > 0.0) & (found <= farthest), found, np.nan)
    return r


@dataclass(frozen=True, eq=False)
class _Patch:
    """Heights around the camera; places are steps north and east from it."""

    nodes: Single
    corner: tuple[float, float]
    """Row and column of the camera."""

    @classmethod
    def around(cls, terrain: Terrain, ne: FloatArray, reach: float) -> _Patch:
        first = np.floor((ne - reach) / HEIGHT_STEP_M).astype(int)
        count = int(2.0 * reach / HEIGHT_STEP_M) + 2
        nodes = terrain.heights.crop((int(first[0]), int(first[1])), (count, count))
        row, column = ne / HEIGHT_STEP_M - first
        return cls(nodes, (float(row), float(column)))

    def height(self, step_ne: Single) -> Single:
        return np.asarray(_sampled(self.nodes, self.corner, step_ne, HEIGHT_STEP_M), dtype=np.float32)

    def normal(self, step_ne: Single) -> Single:
        across = np.float32(1.0 / (2.0 * HEIGHT_STEP_M))
        gn, ge = (
            _sampled(cv2.sepFilter2D(self.nodes, -1, *kernels), self.corner, step_ne, HEIGHT_STEP_M) * across
            for kernels in ((_ONE, _CENTRAL), (_CENTRAL, _ONE))
        )
        norm = 1.0 / np.sqrt(1.0 + gn * gn + ge * ge)
        return np.stack([-gn * norm, -ge * norm, -norm])


_ONE: Final = np.ones(1, dtype=np.float32)
_CENTRAL: Final = np.array([-1.0, 0.0, 1.0], dtype=np.float32)


def _sampled(nodes: NDArray[Any], corner: tuple[float, float], step_ne: Single, step: float) -> NDArray[Any]:
    """Bilinear values at steps (2, H, W) from the corner's place."""
    scale = np.float32(1.0 / step)
    rows, columns = (step_ne[k] * scale + np.float32(corner[k]) for k in (0, 1))
    return np.asarray(cv2.remap(nodes, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def colours(terrain: Terrain, p_n: FloatArray, sight: Sight, pixel_rad: float) -> Single:
    """Albedo (H, W, 3), averaged over what a pixel of ``pixel_rad`` covers."""
    if not sight.met.any():
        return np.zeros((*sight.r.shape, 3), dtype=np.float32)
    low, high = (
        np.array([float(pick(sight.step_ne[k][sight.met])) for k in (0, 1)]) + p_n[:2] for pick in (np.min, np.max)
    )
    first = np.floor(low / TEXEL_M).astype(int) - 4
    shape = np.ceil(high / TEXEL_M).astype(int) + 5 - first
    code = terrain.colours.crop((int(first[0]), int(first[1])), (int(shape[0]), int(shape[1])))
    footprint = float(np.median(sight.r[sight.met])) * pixel_rad / TEXEL_M
    if footprint > 1.05:
        code = cv2.GaussianBlur(code, (0, 0), 0.4 * np.sqrt(footprint**2 - 1.0))
    row, column = p_n[:2] / TEXEL_M - first
    seen = _sampled(code, (float(row), float(column)), sight.step_ne, TEXEL_M)
    return decoded(seen.astype(np.uint8, copy=False))


def radiance(terrain: Terrain, eye: Eye, light: Light, p_n: FloatArray, R_nb: FloatArray, sight_m: float) -> Single:
    """Blue, green, red (H, W, 3) of the floor and the water before it, for a camera at ``p_n``.

    Beyond ``sight_m`` the floor fades into the water.
    """
    R = R_nb.astype(np.float32)
    rays_b = eye.rays_b
    rays_n = np.tensordot(R, rays_b, axes=1)
    sight = look(terrain, p_n, rays_n, _FADED * sight_m)
    albedo = colours(terrain, p_n, sight, 1.0 / float(np.mean(eye.camera.f)))
    direct = light.reflected(albedo, rays_b * sight.r, sight.r, np.tensordot(R.T, sight.normal_n, axes=1))
    direct *= (sight.met * np.clip((_FADED - sight.r / np.float32(sight_m)) / (_FADED - 1.0), 0.0, 1.0))[..., None]
    direct = light.halo(direct, float(np.median(sight.r)))
    coarse = np.s_[_COARSE // 2 :: _COARSE, _COARSE // 2 :: _COARSE]
    veil = light.scattered(rays_b[(slice(None), *coarse)], sight.r[coarse])
    size = (direct.shape[1], direct.shape[0])
    made: Single = direct + cv2.resize(veil, size, interpolation=cv2.INTER_CUBIC)
    return made
