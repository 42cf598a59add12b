"""A keyframe's images into its patch of the floor: by the plane of the soundings, or by a stereo pair."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.errors import DataError
from uwgraph.seafloor.colour import Light, as_colours, bands, light_of
from uwgraph.seafloor.disparity import blocks, match
from uwgraph.seafloor.patch import Colours, Patch
from uwgraph.seafloor.plane import meet, plane_at
from uwgraph.seafloor.settings import MapSettings
from uwgraph.seafloor.stereo import block_points, stereo_of
from uwgraph.seafloor.survey import Survey, voxel_of
from uwgraph.types import BoolArray, FloatArray

LIGHT_IMAGES: Final = 60
"""The light at a distance is estimated on so many images, spread over the dive."""
_NODE_PX: Final = (2, 40)
_ENOUGH: Final = 0.3
"""A keyframe that knows less than this share of its points is left out."""

Progress = Callable[[float], None]


def patches(survey: Survey, settings: MapSettings, progress: Progress | None = None) -> Iterator[Patch | DataError]:
    """The patch of every keyframe in order of time, or why it has none; one is in memory at a time."""
    lights = _lights(survey)
    maker = _StereoMaker(survey, settings) if survey.eyes.second is not None else _PlaneMaker(survey, settings)
    for k in range(len(survey.t_ns)):
        try:
            yield maker.patch(k, _read(survey, k), lights[k])
        except DataError as error:
            yield error
        if progress is not None:
            progress((k + 1) / len(survey.t_ns))


def _lights(survey: Survey) -> list[Light | None]:
    """For each keyframe the light of the first camera at its distance; images that cannot be read tell nothing."""
    band = bands(survey.altitude)

    def sample(members: NDArray[np.intp]) -> Iterator[Colours]:
        for k in members[np.unique(np.linspace(0, len(members) - 1, LIGHT_IMAGES).round().astype(int))]:
            try:
                yield as_colours(survey.eyes.first.read(int(survey.index[k])))
            except DataError:
                continue

    lights = {name: light_of(sample(np.flatnonzero(band == name))) for name in np.unique(band).tolist()}
    return [lights[name] for name in band.tolist()]


def _read(survey: Survey, k: int) -> tuple[Colours, ...]:
    """The images of a keyframe."""
    return tuple(as_colours(image) for image in survey.eyes.read(int(survey.index[k])))


def _reduced(texture: Colours, size: tuple[int, int]) -> Colours:
    if (texture.shape[1], texture.shape[0]) == size:
        return texture
    return np.asarray(cv2.resize(texture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


class _PlaneMaker:
    """Patches of one camera: its rays meet the plane of the soundings."""

    def __init__(self, survey: Survey, settings: MapSettings) -> None:
        assert survey.soundings is not None
        self.survey, self.settings, self.soundings = survey, settings, survey.soundings
        camera = survey.eyes.first.camera
        width, height = camera.size
        share = min(1.0, float(np.sqrt(settings.texture_pixels / (width * height))))
        self.size = (max(round(width * share), 2), max(round(height * share), 2))
        self.step = _node_step(settings, survey.usual, float(np.mean(camera.f)) * share, self.size)
        columns, rows = (extent // self.step for extent in self.size)
        u = ((np.arange(columns) + 0.5) * self.step) * width / self.size[0] - 0.5
        v = ((np.arange(rows) + 0.5) * self.step) * height / self.size[1] - 0.5
        uv = np.stack(np.meshgrid(u, v), axis=-1)
        self.rays_b = camera.outside(uv.reshape(-1, 2), settings.n)[0].reshape(*uv.shape[:2], 3)
        self.l_b = camera.l_b

    def patch(self, k: int, images: tuple[Colours, ...], light: Light | None) -> Patch:
        t_ns = int(self.survey.t_ns[k])
        R_nb, p_n = self.survey.poses.R_nb[k], self.survey.poses.p_n[k]
        plane = plane_at(self.soundings, t_ns, p_n, self.settings.slope_sigma)
        if plane is None:
            raise DataError("no sounding near it", where=_named(self.survey, k))
        points, sigma = meet(plane, self.rays_b, self.l_b, R_nb, self.survey.far)
        if np.isfinite(sigma).mean() < _ENOUGH:
            raise DataError("the floor is not in sight", where=_named(self.survey, k))
        image = images[0] if light is None else light.corrected(images[0])
        return _patch(t_ns, points, sigma, plane.roughness, np.isfinite(sigma), _reduced(image, self.size), self.step)


class _StereoMaker:
    """Patches of a pair: disparities, and a plane through them to carry the texture over their gaps."""

    def __init__(self, survey: Survey, settings: MapSettings) -> None:
        assert survey.eyes.second is not None
        self.survey, self.settings = survey, settings
        first, second = survey.eyes.first.camera, survey.eyes.second.camera
        self.stereo = stereo_of(first, second, settings.n, settings.texture_pixels)
        self.range = self.stereo.disparity_range(survey.near, survey.far)
        self.step = _node_step(settings, survey.usual, self.stereo.f, self.stereo.size)

    def patch(self, k: int, images: tuple[Colours, ...], light: Light | None) -> Patch:
        stereo, step = self.stereo, self.step
        left, right = (stereo.rectified(image, side) for side, image in enumerate(images))
        middle, sigma_d = blocks(*match(left, right, *self.range), step)
        measured = np.isfinite(middle)
        if measured.mean() < _ENOUGH:
            raise DataError("hardly anything agrees in the two images", where=_named(self.survey, k))
        filled = np.where(measured, middle, _plane_through(middle))
        filled[filled < stereo.f * stereo.baseline / self.survey.far] = np.nan
        sigma_d = np.hypot(np.where(measured, sigma_d, np.nanmax(sigma_d)), self.settings.disparity_sigma)
        points, sigma = block_points(stereo, filled, sigma_d, step)
        texture = stereo.rectified(images[0] if light is None else light.corrected(images[0]), 0)
        t_ns = int(self.survey.t_ns[k])
        return _patch(t_ns, points, sigma, 0.0, measured, texture, step)


def _plane_through(disparity: FloatArray) -> FloatArray:
    """The disparities of a plane in space are linear in the pixel: its least-squares values at every block."""
    rows, columns = np.indices(disparity.shape)
    A = np.column_stack([np.ones(disparity.size), columns.ravel(), rows.ravel()])
    known = np.isfinite(disparity.ravel())
    coefficients = np.linalg.lstsq(A[known], disparity.ravel()[known], rcond=None)[0]
    return np.asarray((A @ coefficients).reshape(disparity.shape))


def _node_step(settings: MapSettings, usual: float, f: float, size: tuple[int, int]) -> int:
    """Pixels between the points of a patch: as far apart as the cells of the cloud."""
    step = int(np.clip(round(voxel_of(settings, usual) * f / usual), *_NODE_PX))
    return max(min(step, min(size) // 2), 1)


def _named(survey: Survey, k: int) -> str:
    return str(survey.eyes.first.files[int(survey.index[k])])


def _patch(
    t_ns: int, points: FloatArray, sigma: FloatArray, common: float, measured: BoolArray, texture: Colours, step: int
) -> Patch:
    """The patch, its texture cut to whole blocks."""
    seen = np.isfinite(points).all(axis=2) & np.isfinite(sigma)
    rows, columns = sigma.shape
    return Patch(
        t_ns,
        np.where(seen[..., None], points, np.nan).astype(np.float32),
        np.where(seen, sigma, np.nan).astype(np.float32),
        common,
        measured & seen,
        texture[: rows * step, : columns * step],
    )
