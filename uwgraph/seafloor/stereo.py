"""A stereo pair: rectified, and disparities turned into points with their 1-sigma.

Both cameras are re-imaged onto virtual pinholes that share their axes, x along the baseline. The way goes through rays
in the water, so that lens models and flat ports need no case of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.model import Camera
from uwgraph.camera.refraction import refract
from uwgraph.errors import ConfigError
from uwgraph.seafloor.disparity import Pixels
from uwgraph.seafloor.patch import Colours
from uwgraph.types import FloatArray

_MIN_BASELINE_M: Final = 0.005
_MAX_DISPARITIES: Final = 256


@dataclass(frozen=True, eq=False)
class Stereo:
    """A rectified pair."""

    f: float
    """Focal length of both virtual pinholes, pixels."""
    c: tuple[float, float]
    """Their principal point, pixels."""
    size: tuple[int, int]
    """Width and height of their images, pixels."""
    baseline: float
    """m."""
    R_bv: FloatArray
    """Rotation of the virtual axes to the body, shape (3, 3)."""
    l_b: FloatArray
    """Place of the left pinhole in the body, shape (3,), m."""
    maps: tuple[tuple[Pixels, Pixels], tuple[Pixels, Pixels]]
    """Of the left and the right image: u and v behind each virtual pixel."""

    def rectified(self, image: Colours, side: int) -> Colours:
        """The left (0) or right (1) image as its virtual pinhole sees it."""
        return np.asarray(
            cv2.remap(image, *self.maps[side], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8
        )

    def disparity_range(self, near: float, far: float) -> tuple[int, int]:
        """Smallest disparity and how many, as StereoSGBM wants them, of points between two distances [m]."""
        low = max(int(self.f * self.baseline / far), 0)
        count = int(np.ceil((self.f * self.baseline / near - low) / 16.0)) * 16
        return low, int(np.clip(count, 16, min(_MAX_DISPARITIES, self.size[0] // 32 * 16)))


def stereo_of(left: Camera, right: Camera, n: float, max_pixels: int) -> Stereo:
    """The rectification of two cameras in a medium of refractive index ``n``.

    Raises
    ------
    ConfigError
        When they are at the same place, one behind the other, or do not look at the same scene.
    """
    towards = right.l_b - left.l_b
    baseline = float(np.linalg.norm(towards))
    ahead = left.R_bs[:, 2] + right.R_bs[:, 2]
    if baseline < _MIN_BASELINE_M:
        raise _unusable("have no baseline: both are at the same place")
    x = towards / baseline
    z = ahead - (ahead @ x) * x
    if np.linalg.norm(z) < 1.0:
        raise _unusable("look along their baseline, or away from each other")
    z /= np.linalg.norm(z)
    R_bv = np.column_stack([x, np.cross(z, x), z])
    low, high = _common_view((left, right), R_bv, n)
    if not (high - low > 0.05).all():
        raise _unusable("do not look at the same scene")
    f = _focal(left, n)
    f *= min(1.0, float(np.sqrt(max_pixels / np.prod((high - low) * f))))
    width, height = (max(int(extent), 2) for extent in (high - low) * f)
    cu, cv = (-low * f).tolist()
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays_b = np.stack([(u - cu) / f, (v - cv) / f, np.ones_like(u, dtype=np.float64)], axis=-1) @ R_bv.T
    rays_b = rays_b.reshape(-1, 3)
    u_left, v_left, u_right, v_right = (
        x.reshape(height, width) for camera in (left, right) for x in _pixels_of(camera, rays_b, n).T.copy()
    )
    maps = ((u_left, v_left), (u_right, v_right))
    return Stereo(f, (cu, cv), (width, height), baseline, R_bv, left.l_b, maps)


def block_points(
    stereo: Stereo, disparity: FloatArray, sigma_d: FloatArray, step: int
) -> tuple[FloatArray, FloatArray]:
    """Points in the body of blocks of ``step`` x ``step`` pixels, shape (rows, columns, 3), m, and their 1-sigma along
    the line of sight, from disparities and their 1-sigma (rows, columns), pixels."""
    rows, columns = disparity.shape
    u, v = np.meshgrid((np.arange(columns) + 0.5) * step - 0.5, (np.arange(rows) + 0.5) * step - 0.5)
    ray_v = np.stack([(u - stereo.c[0]) / stereo.f, (v - stereo.c[1]) / stereo.f, np.ones_like(u)], axis=-1)
    depth = stereo.f * stereo.baseline / disparity
    sigma = depth**2 / (stereo.f * stereo.baseline) * sigma_d * np.linalg.norm(ray_v, axis=-1)
    return (ray_v * depth[..., None]) @ stereo.R_bv.T + stereo.l_b, sigma


def _focal(camera: Camera, n: float) -> float:
    """Pixels per unit of tangent in the water: a flat port magnifies."""
    return float(np.mean(camera.f)) * (n if camera.port == "flat" else 1.0)


def _common_view(cameras: tuple[Camera, Camera], R_bv: FloatArray, n: float) -> tuple[FloatArray, FloatArray]:
    """Tangents (x, y) between which both cameras see, shapes (2,) and (2,)."""
    bounds = []
    for camera in cameras:
        width, height = camera.size
        edge = np.linspace(0.0, 1.0, 33)
        ends = [
            np.column_stack(pair)
            for pair in ((edge, 0 * edge), (edge, 0 * edge + 1), (0 * edge, edge), (0 * edge + 1, edge))
        ]
        uv = np.concatenate(ends) * [width - 1.0, height - 1.0]
        rays = camera.outside(uv, n)[0] @ R_bv
        ahead = rays[np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0.2)]
        tangents = ahead[:, :2] / ahead[:, 2:] if len(ahead) else np.zeros((1, 2))
        bounds.append((tangents.min(axis=0), tangents.max(axis=0)))
    return np.maximum(bounds[0][0], bounds[1][0]), np.minimum(bounds[0][1], bounds[1][1])


def _pixels_of(camera: Camera, rays_b: FloatArray, n: float) -> NDArray[np.float32]:
    """Pixels at which a camera sees rays (N, 3) in the water, float32 (N, 2); far outside where it does not."""
    rays = rays_b @ camera.R_bs
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    if camera.port == "flat" and n != 1.0:
        ahead = rays[:, 2:] > 0.0
        rays = np.where(
            ahead, refract(np.where(ahead, rays, [0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), 1.0 / n), np.nan
        )
    return np.nan_to_num(camera.project(rays), nan=-1e4).astype(np.float32)


def _unusable(problem: str) -> ConfigError:
    return ConfigError(
        f"the two cameras {problem}",
        where="R_bs, translation_m",
        remedy="correct the two camera files, or map with one",
    )
