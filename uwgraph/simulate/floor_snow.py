"""Marine snow: bright blurred specks between the camera and the floor, others in every picture."""

from __future__ import annotations

from typing import Final

import numpy as np

from uwgraph.camera.model import Camera
from uwgraph.simulate.floor_light import Light
from uwgraph.simulate.floor_noise import Single
from uwgraph.types import FloatArray

_FAR_M: Final = 2.5
_NEAR_M: Final = 0.15
_RADIUS_M: Final = 0.0009
_SPREAD: Final = 0.5
_WHITENESS: Final = 0.5
_APERTURE_M: Final = 0.003
_FOCUS_M: Final = 2.5
_LENS_PX: Final = 0.8


def drift(camera: Camera, per_m3: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Places before the camera in body axes from it (N, 3), and radii (N,), m."""
    sphere = camera.size[0] * camera.size[1] / (camera.f[0] * camera.f[1])
    count = rng.poisson(min(per_m3 * sphere * _FAR_M**3 / 3.0, 1e4))
    uv = rng.uniform(-0.5, 0.5, (count, 2)) * camera.size + (np.array(camera.size) - 1.0) / 2.0
    r = np.maximum(_FAR_M * rng.random(count) ** (1.0 / 3.0), _NEAR_M)
    radius = _RADIUS_M * np.exp(_SPREAD * rng.standard_normal(count))
    X = r[:, None] * (camera.rays(uv) @ camera.R_bs.T) if count else np.zeros((0, 3))
    known = np.isfinite(X).all(axis=1)
    return X[known], radius[known]


def add_snow(radiance: Single, camera: Camera, light: Light, X: FloatArray, radius: FloatArray) -> None:
    """Add specks at X (N, 3), body axes from the camera, to a picture (H, W, 3)."""
    if not len(X):
        return
    seen = camera.project(X @ camera.R_bs)
    r = np.linalg.norm(X, axis=1)
    glow = _glow(light, X, r)
    f = float(np.mean(camera.f))
    size = f * radius / r
    sigma = np.hypot(_LENS_PX, 0.5 * f * _APERTURE_M * np.abs(1.0 / r - 1.0 / _FOCUS_M))
    peak = glow * np.minimum(size**2 / (2.0 * sigma**2), 1.0)[:, None]
    width, height = camera.size
    for (u, v), s, colour in zip(seen, sigma, peak.astype(np.float32), strict=True):
        if not (-3.0 * s <= u < width + 3.0 * s and -3.0 * s <= v < height + 3.0 * s):
            continue
        rows = np.arange(max(int(v - 3.0 * s), 0), min(int(v + 3.0 * s) + 2, height), dtype=np.float32)
        columns = np.arange(max(int(u - 3.0 * s), 0), min(int(u + 3.0 * s) + 2, width), dtype=np.float32)
        if not len(rows) or not len(columns):
            continue
        spot = np.outer(np.exp(-0.5 * ((rows - v) / s) ** 2), np.exp(-0.5 * ((columns - u) / s) ** 2))
        near = np.s_[int(rows[0]) : int(rows[-1]) + 1, int(columns[0]) : int(columns[-1]) + 1]
        radiance[near] += spot[..., None].astype(np.float32) * colour


def _glow(light: Light, X: FloatArray, r: FloatArray) -> FloatArray:
    """Radiance of the specks that arrives, shape (N, 3)."""
    c = light.attenuation.astype(np.float64)
    E = light.daylight * np.exp(-np.outer(r, c))
    for lamp in light.lamps:
        irradiance, way = light.of_lamp(lamp, X.T.astype(np.float32))
        E = E + irradiance[:, None] * np.exp(-np.outer(way + r, c))
    return np.asarray(_WHITENESS / np.pi * E, dtype=np.float64)
