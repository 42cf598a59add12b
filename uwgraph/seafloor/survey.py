"""From a dive's images and its solution to patches of the floor, one per keyframe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.eyes import Eyes
from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.export.track import Track
from uwgraph.seafloor.colour import Light, as_colours, bands, light_of
from uwgraph.seafloor.disparity import blocks, match
from uwgraph.seafloor.patch import Colours, Patch
from uwgraph.seafloor.plane import Soundings, meet, plane_at, sounded
from uwgraph.seafloor.poses import Poses, poses_at
from uwgraph.seafloor.settings import MapSettings
from uwgraph.seafloor.stereo import Stereo, block_points, stereo_of
from uwgraph.types import BoolArray, FloatArray, TimeArray

LIGHT_IMAGES: Final = 60
"""The light at a distance is estimated on so many images, spread over the dive."""
_TURN: Final = np.radians(20.0)
"""A turn of so much makes a keyframe as well."""
_NODE_PX: Final = (2, 40)
_UNKNOWN_M: Final = (0.7, 10.0)
"""m: nearest and farthest point of a stereo pair where no sounder tells the altitude."""
_ENOUGH: Final = 0.3
"""A stereo keyframe that knows less than this share of its points is left out."""

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Survey:
    """What the patches are made from: which keyframes, with which poses, at which distances."""

    eyes: Eyes
    index: NDArray[np.intp]
    """Of each keyframe among the images, shape (K,)."""
    t_ns: TimeArray
    """Of the keyframes on the dive's clock, shape (K,)."""
    poses: Poses
    """At the keyframes."""
    soundings: Soundings | None
    altitude: FloatArray
    """At the keyframes, shape (K,), m; NaN where no sounder tells it."""
    near: float
    """m, the nearest floor."""
    usual: float
    """m, the median distance to the floor."""
    far: float
    """m, the farthest floor."""
    left_out: dict[str, int]
    """Images that are no keyframes, by reason."""


def plan_survey(dive: Dive, eyes: Eyes, track: Track, settings: MapSettings) -> Survey:
    """Choose the keyframes, and find the distances to the floor.

    Raises
    ------
    DataError
        When the solution covers no image, or nothing tells how far the floor is.
    """
    stamps = eyes.t_ns + dive.rig.visual.time_offset_ns
    echoes = dive.altitude.t_ns + dive.rig.altitude.time_offset_ns if dive.altitude is not None else stamps[:0]
    poses, within = poses_at(dive, track, np.concatenate([stamps, echoes]))
    covered, used = within[: len(stamps)], within[len(stamps) :]
    if not covered.any():
        raise DataError(
            "the solution covers none of the images",
            where=f"images/{eyes.first.name}",
            remedy="name the solution of this dive, and check the camera's clock (rig.visual.time_offset_s)",
        )
    count = int(covered.sum())
    soundings = sounded(dive, poses.select(slice(count, None)), echoes[used], used) if used.any() else None
    if soundings is not None and not len(soundings.t_ns):
        soundings = None
    if soundings is None and eyes.second is None:
        raise DataError(
            "nothing tells how far the floor is",
            where="altitude",
            remedy="add an altitude stream (echo sounder, DVL) to the dive, or map with a stereo pair",
        )
    near, usual, far = _distances(soundings, settings)
    seen = poses.select(slice(count))
    altitude = _altitude_at(soundings, stamps[covered])
    low = ~(altitude > far)
    if not low.any():
        raise DataError("every image was taken far above the floor", where="altitude", remedy="check the altitudes")
    spaced = _spaced(seen.select(low), settings.keyframe_step * usual)
    chosen = low.copy()
    chosen[low] = spaced
    left_out = {
        "outside the solution": len(stamps) - count,
        "far above the floor": count - int(low.sum()),
        "close to the last keyframe": int(low.sum() - spaced.sum()),
    }
    return Survey(
        eyes,
        np.flatnonzero(covered)[chosen],
        stamps[covered][chosen],
        seen.select(chosen),
        soundings,
        altitude[chosen],
        near,
        usual,
        far,
        {reason: number for reason, number in left_out.items() if number},
    )


def patches(survey: Survey, settings: MapSettings, progress: Progress | None = None) -> Iterator[Patch | str]:
    """The patch of every keyframe in order of time, or in words why it has none; one is in memory at a time."""
    lights = _lights(survey)
    maker = _StereoMaker(survey, settings) if survey.eyes.second is not None else _PlaneMaker(survey, settings)
    for k in range(len(survey.t_ns)):
        try:
            yield maker.patch(k, _read(survey, k), lights[k])
        except DataError as error:
            yield f"{error.where}: {error.problem}"
        if progress is not None:
            progress((k + 1) / len(survey.t_ns))


def _altitude_at(soundings: Soundings | None, t_ns: TimeArray) -> FloatArray:
    if soundings is None:
        return np.full(len(t_ns), np.nan)
    first = int(t_ns[0])
    altitude: FloatArray = np.interp((t_ns - first) * 1e-9, (soundings.t_ns - first) * 1e-9, soundings.altitude)
    return altitude


def _distances(soundings: Soundings | None, settings: MapSettings) -> tuple[float, float, float]:
    if soundings is None:
        return _UNKNOWN_M[0], float(np.sqrt(_UNKNOWN_M[0] * _UNKNOWN_M[1])), _UNKNOWN_M[1]
    usual, high = np.quantile(soundings.altitude, [0.5, 0.75]).tolist()
    return settings.nearest * usual, usual, settings.farthest * high


def _spaced(poses: Poses, step: float) -> BoolArray:
    """The first pose, and each that is a step or a turn from the last one taken, shape (N,)."""
    chosen = np.zeros(len(poses.p_n), dtype=np.bool_)
    last = 0
    chosen[0] = True
    for k in range(1, len(chosen)):
        cosine = (np.trace(poses.R_nb[last].T @ poses.R_nb[k]) - 1.0) / 2.0
        if np.linalg.norm(poses.p_n[k] - poses.p_n[last]) >= step or cosine < np.cos(_TURN):
            chosen[k], last = True, k
    return chosen


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
        self.step = _node_step(settings, survey.usual, float(np.mean(camera.f)) * share)
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
        self.stereo: Stereo = stereo_of(first, second, settings.n, settings.texture_pixels)
        self.range = self.stereo.disparity_range(survey.near, survey.far)
        self.step = _node_step(settings, survey.usual, self.stereo.f)

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


def _node_step(settings: MapSettings, usual: float, f: float) -> int:
    """Pixels between the points of a patch: as far apart as the cells of the cloud."""
    return int(np.clip(round(voxel_of(settings, usual) * f / usual), *_NODE_PX))


def voxel_of(settings: MapSettings, usual: float) -> float:
    """The size of a cell, m, at the usual distance to the floor."""
    return settings.voxel_m or usual / 100.0


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
