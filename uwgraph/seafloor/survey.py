"""Which images of a dive map its floor, where they were taken, and how far the floor is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.eyes import Eyes
from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.export.track import Track
from uwgraph.seafloor.colour import as_colours
from uwgraph.seafloor.disparity import match
from uwgraph.seafloor.plane import Soundings, sounded
from uwgraph.seafloor.poses import Poses, poses_at
from uwgraph.seafloor.settings import MapSettings
from uwgraph.seafloor.stereo import stereo_of
from uwgraph.types import BoolArray, FloatArray, TimeArray

_TURN: Final = np.radians(20.0)
"""A turn of so much makes a keyframe as well."""
_UNKNOWN_M: Final = (0.7, 10.0)
"""m: a stereo pair looks for the floor between these where no sounder tells the altitude,"""
_LOOKS: Final = 9
"""in so many of its images."""


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
    if soundings is not None:
        usual, high = np.quantile(soundings.altitude, [0.5, 0.75]).tolist()
    else:
        usual, high = _looked(eyes, np.flatnonzero(covered), settings)
    far = settings.farthest * high
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
        settings.nearest * usual,
        usual,
        far,
        {reason: number for reason, number in left_out.items() if number},
    )


def _altitude_at(soundings: Soundings | None, t_ns: TimeArray) -> FloatArray:
    if soundings is None:
        return np.full(len(t_ns), np.nan)
    first = int(t_ns[0])
    altitude: FloatArray = np.interp((t_ns - first) * 1e-9, (soundings.t_ns - first) * 1e-9, soundings.altitude)
    return altitude


def _looked(eyes: Eyes, rows: NDArray[np.intp], settings: MapSettings) -> tuple[float, float]:
    """Median and upper quartile of the distances that a stereo pair sees by itself, m."""
    assert eyes.second is not None
    stereo = stereo_of(eyes.first.camera, eyes.second.camera, settings.n, settings.texture_pixels)
    depths = []
    for row in rows[np.unique(np.linspace(0, len(rows) - 1, _LOOKS).round().astype(int))].tolist():
        try:
            left, right = (stereo.rectified(as_colours(image), side) for side, image in enumerate(eyes.read(row)))
        except DataError:
            continue
        found, _ = match(left, right, *stereo.disparity_range(*_UNKNOWN_M))
        depths.append(stereo.f * stereo.baseline / found[np.isfinite(found)])
    seen = np.concatenate([np.zeros(0), *depths])
    if not len(seen):
        raise DataError(
            f"the floor is nowhere between {_UNKNOWN_M[0]:g} and {_UNKNOWN_M[1]:g} m, as far as the images tell",
            where=f"images/{eyes.first.name}",
            remedy="look at the images and the camera files, or add an altitude stream",
        )
    usual, high = np.quantile(seen, [0.5, 0.75]).tolist()
    return usual, high


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


def voxel_of(settings: MapSettings, usual: float) -> float:
    """The size of a cell, m, at the usual distance to the floor."""
    return settings.voxel_m or usual / 100.0
