"""What a camera in air or under water sees of the sky, as Stokes vectors.

Every pixel's ray is followed out of the housing to the waves, through the facet it meets into the sky; the light comes
back through Fresnel's Mueller matrix of that very facet and through the water. Nothing here is shared with the
estimators but the camera's calibration.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.model import Camera
from uwgraph.simulate.eye import Eye
from uwgraph.simulate.fields import cap_directions
from uwgraph.simulate.scene import Scene
from uwgraph.simulate.sea import Patch
from uwgraph.simulate.sky import SUN_RADIUS, UP, Sky, horizontal_axis
from uwgraph.simulate.stokes import about, transmitted
from uwgraph.simulate.water import Downwelling, blurred, veil
from uwgraph.types import FloatArray

_LONG_M: Final = 0.5
"""Only longer waves are high enough to move the point where a ray meets the surface."""
_STEEPEST: Final = 0.4
"""No facet tilted by more than this, rad, lets in light from beyond it."""
_HEMISPHERE: Final = cap_directions(np.pi / 2.0, 2000)


@dataclass(frozen=True, eq=False)
class Shot:
    """One image to take: the camera, how it points, and where it is."""

    camera: Camera
    R_lb: FloatArray
    """Rotation body to the local level frame (north, east, down), shape (3, 3)."""
    s_l: FloatArray
    """Unit vector to the sun in l, shape (3,)."""
    depth: float | None = None
    """Metres below the mean surface; None in air."""
    place: FloatArray = field(default_factory=lambda: np.zeros(2))
    """North and east on the sea, m."""
    t_s: float = 0.0
    """Time of the waves, s."""

    def n(self, scene: Scene) -> float:
        return 1.0 if self.depth is None else scene.n


def render(scene: Scene, shot: Shot, seed: int = 0) -> FloatArray:
    """Stokes image (H, W, 3) under the camera's analyser model, Q > 0 along image x, U > 0 at 45 deg towards image y.

    The same ``seed`` gives the same clouds, occluders and waves.
    """
    n, (width, height) = shot.n(scene), shot.camera.size
    sky = scene.sky_at(shot.s_l, seed, _disc(scene, shot))
    image = np.zeros((width * height, 3))
    for number, offset in enumerate(_offsets(scene.samples)):
        eye = Eye.of(shot.camera, n, offset)
        moment = shot.t_s + scene.exposure_s * (number + 0.5) / scene.samples
        image += eye.behind_port(_seen(scene, shot, sky, eye, moment, seed)) / scene.samples
    eye = Eye.of(shot.camera, n)
    if shot.depth is not None:
        focal = float(np.mean(shot.camera.f))
        image = blurred(image.reshape(height, width, 3), scene.water, 1.15 * shot.depth, focal).reshape(-1, 3)
        image += eye.behind_port(_veil(scene, shot, sky, eye, shot.depth))
    image = eye.analysed(image) * _vignette(shot.camera, scene.vignetting)[:, None]
    image[~eye.seeing] = 0.0
    return image.reshape(height, width, 3)


def _seen(scene: Scene, shot: Shot, sky: Sky, eye: Eye, t: float, seed: int) -> FloatArray:
    """Stokes vectors (N, 3) about the eye's axes of the light that comes straight from the sky."""
    w, s = eye.w_b @ shot.R_lb.T, eye.s_b @ shot.R_lb.T
    if shot.depth is None:
        return about(sky.stokes(w), w, horizontal_axis(w), s)
    seen = np.zeros_like(w)
    upward = np.flatnonzero(-w[:, 2] > np.cos(np.arcsin(1.0 / scene.n) + _STEEPEST))
    normal, path = _meet(scene.sea(seed).at(shot.place, t), w[upward], shot.depth)
    through, stokes, axis = _through_surface(sky, w[upward], normal, scene.n)
    hit = upward[through]
    stokes = about(stokes, w[hit], axis, s[hit])
    stokes *= scene.water.transmittance(path[through])[:, None]
    stokes[:, 1:] *= scene.water.polarization_kept(path[through])[:, None]
    seen[hit] = stokes
    return seen


def _meet(patch: Patch, w: FloatArray, depth: float) -> tuple[FloatArray, FloatArray]:
    """Upward normals (N, 3) of the surface where rays from ``depth`` meet it, and the paths to it [m]."""
    path = depth / -w[:, 2]
    if len(patch.k) == 0:
        return np.broadcast_to(UP, w.shape), path
    long = patch.long(_LONG_M)
    for _ in range(2):
        path = np.maximum(depth + long.height(path[:, None] * w[:, :2]), 0.0) / -w[:, 2]
    slope = patch.slope(path[:, None] * w[:, :2])
    normal = np.column_stack([-slope, -np.ones(len(w))])
    return normal / np.linalg.norm(normal, axis=1)[:, None], path


def _through_surface(
    sky: Sky, w: FloatArray, normal: FloatArray, n: float
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Which rays ``w`` in water get out, the sky's light along them in water (M, 3), and its axes (M, 3)."""
    cos_w = (w * normal).sum(axis=1)
    cos2_a = 1.0 - n**2 * (1.0 - cos_w**2)
    through = np.flatnonzero((cos_w > 0.0) & (cos2_a > 0.0))
    w, normal, cos_w, cos_a = w[through], normal[through], cos_w[through], np.sqrt(cos2_a[through])
    a = n * w + (cos_a - n * cos_w)[:, None] * normal
    axis = np.cross(normal, w)
    size = np.linalg.norm(axis, axis=1)[:, None]
    axis = np.where(size < 1e-9, horizontal_axis(w), axis / np.maximum(size, 1e-9))
    stokes = about(sky.stokes(a), a, horizontal_axis(a), axis)
    return through, transmitted(stokes, cos_a, cos_w, n), axis


def _veil(scene: Scene, shot: Shot, sky: Sky, eye: Eye, depth: float) -> FloatArray:
    w, s = eye.w_b @ shot.R_lb.T, eye.s_b @ shot.R_lb.T
    return about(veil(scene.water, _downwelling(sky, scene.n), depth, w), w, horizontal_axis(w), s)


def _downwelling(sky: Sky, n: float) -> Downwelling:
    """Sky and sun as they enter a flat surface."""
    a = np.vstack([_HEMISPHERE, sky.s_l])
    light = replace(sky, sun_irradiance=0.0).stokes(a) * (2.0 * np.pi / len(_HEMISPHERE))
    sun = sky.stokes(a[-1:])[0] - light[-1] * (len(_HEMISPHERE) / (2.0 * np.pi))
    light[-1] = sun * 2.0 * np.pi * (1.0 - np.cos(sky.sun_radius))
    cos_a = np.maximum(a @ UP, 0.01)
    w = a / n
    w[:, 2] = -np.sqrt(1.0 - (w[:, :2] ** 2).sum(axis=1))
    cos_w = -w[:, 2]
    narrowed = cos_a / (n**2 * cos_w)  # solid angle in water over that in air
    return Downwelling.of(w, transmitted(light, cos_a, cos_w, n) * narrowed[:, None])


def _disc(scene: Scene, shot: Shot) -> float:
    """Radius of the sun's disc [rad], widened so that enough rays meet it.

    Waves break the sun into more images, each smaller, than there are rays; without this the light would flicker.
    """
    rough = shot.depth is not None and max(scene.wind, scene.swell_height) > 0.0
    pixels = (4.0 if rough else 1.5) / np.sqrt(scene.samples)
    return float(max(SUN_RADIUS, pixels / min(shot.camera.f)))


def _offsets(samples: int) -> list[tuple[float, float]]:
    """Places in the pixel, evenly spread (Roberts's R2 sequence) about its centre."""
    places = np.mod(np.arange(samples)[:, None] * np.array([0.7548776662, 0.5698402910]), 1.0)
    return [(float(u), float(v)) for u, v in places - places.mean(axis=0)]


def _vignette(camera: Camera, loss: float) -> FloatArray:
    """Share of the light that reaches each pixel, shape (N,): quadratic in the distance from the image's middle."""
    middle = (np.array(camera.size) - 1.0) / 2.0
    off = camera.pixels() - middle
    return np.asarray(1.0 - loss * (off * off).sum(axis=1) / (middle * middle).sum())
