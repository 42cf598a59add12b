"""Anchored patches and a solution into what people look at: the fused cloud and the picture from above."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.export.track import Track
from uwgraph.seafloor.clean import cleaned
from uwgraph.seafloor.fuse import Cloud, Fusion
from uwgraph.seafloor.ortho import Canvas, Raster, lay
from uwgraph.seafloor.patch import Patch, read_patch
from uwgraph.seafloor.poses import Poses, poses_at
from uwgraph.types import FloatArray, Origin, TimeArray

_FARTHER: Final = 1.3
"""Images from so many times the distance lie beneath nearer ones, whatever their time."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class SeafloorMap:
    """The floor with its keyframes at the poses of one solution."""

    origin: Origin
    t_ns: TimeArray
    """Keyframes, shape (K,)."""
    poses: Poses
    """Of the keyframes."""
    voxel: float
    """Size of the cloud's cells, m."""
    cloud: Cloud
    normals_n: FloatArray
    """Unit normals that point up, shape (M, 3)."""
    removed: int
    """Points that were taken away as outliers."""
    raster: Raster
    canvas: Canvas
    """The picture from above."""


def render_map(
    dive: Dive,
    track: Track,
    files: Sequence[Path],
    *,
    voxel: float,
    pixel: float | None,
    max_pixels: int,
    progress: Progress | None = None,
) -> SeafloorMap:
    """Pose every patch by the track, fuse, clean and draw: the same for a new map and for one that is re-deformed.

    One patch is in memory at a time, beside the cloud (88 bytes a cell, three times that while it merges) and the
    picture (4 bytes a pixel).

    Parameters
    ----------
    files : sequence of paths
        The patches' files in order of time.
    pixel : float, optional
        Of the picture, m; what a pixel of the textures covers where not given.

    Raises
    ------
    DataError
        When the track covers no keyframe, a patch is damaged, or Open3D cannot be loaded.
    """
    tell = progress or (lambda doing, share: None)
    stamps = np.array([int(file.stem) for file in files], dtype=np.int64)
    poses, covered = poses_at(dive, track, stamps)
    if not covered.any():
        raise DataError(
            "the solution covers none of the map's keyframes", where=track.name, remedy="is it of this dive?"
        )
    posed = [file for file, used in zip(files, covered, strict=True) if used]
    fusion, bounds, footprints, distances = Fusion(voxel), [], [], []
    for k, file in enumerate(posed):
        patch = read_patch(file)
        points = patch.points_n(poses.R_nb[k], poses.p_n[k])
        _fuse(fusion, patch, points)
        bounds.append(_bounds(points))
        footprints.append(_footprint(patch))
        distances.append(_distance(patch))
        tell("fusing", (k + 1) / len(posed))
    low, high = np.nanmin([b[0] for b in bounds], axis=0), np.nanmax([b[1] for b in bounds], axis=0)
    tell("cleaning", 0.0)
    fused = fusion.cloud()
    cloud, normals = cleaned(fused, voxel)
    raster = Raster.around(low, high, pixel or float(np.median(footprints)), max_pixels)
    canvas = raster.blank()
    for done, k in enumerate(_far_to_near(distances), start=1):
        lay(canvas, raster, read_patch(posed[k]), poses.R_nb[k], poses.p_n[k])
        tell("laying the picture", done / len(posed))
    return SeafloorMap(
        track.origin, stamps[covered], poses, voxel, cloud, normals, len(fused) - len(cloud), raster, canvas
    )


def _fuse(fusion: Fusion, patch: Patch, points_n: FloatArray) -> None:
    used: NDArray[np.bool_] = patch.measured
    fusion.add(points_n[used], patch.node_colours()[used], patch.sigma[used].astype(np.float64), patch.common)


def _bounds(points_n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Southwest and northeast corner of a patch, shapes (2,)."""
    ne = points_n[..., :2].reshape(-1, 2)
    seen = ne[np.isfinite(ne).all(axis=1)]
    if not len(seen):
        return np.full(2, np.nan), np.full(2, np.nan)
    return seen.min(axis=0), seen.max(axis=0)


def _far_to_near(distances: list[float]) -> list[int]:
    """Keyframes in the order in which they are laid: clearly farther ones first, else as time goes."""
    far = np.round(np.log(distances) / np.log(_FARTHER))
    return [int(k) for k in np.lexsort((np.arange(len(far)), -far))]


def _distance(patch: Patch) -> float:
    """From the vehicle to the floor, m."""
    return float(np.nanmedian(np.linalg.norm(patch.points_b, axis=2)))


def _footprint(patch: Patch) -> float:
    """What a pixel of the texture covers, m."""
    step = patch.texture.shape[0] / patch.sigma.shape[0]
    apart = np.linalg.norm(np.diff(patch.points_b.astype(np.float64), axis=1), axis=2)
    return float(np.nanmedian(apart) / step)
