"""Measurements between keyframes, moved to their nearest keyframe along the dead-reckoned track and joined there.

At 5 deg/s half a second is 2.5 degrees and at 2 m/s a metre: nothing is attached where it was not measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwgraph.frames import R_n_local, ned_from_geodetic
from uwgraph.graph.keyframes import inside, nearest_keyframe
from uwgraph.graph.track import Track
from uwgraph.types import Depth, Fixes, FloatArray, Heading, Origin, Sun, TimeArray

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class AtKeyframes:
    """One measurement per keyframe that has any."""

    keyframe: IndexArray
    """Which keyframe, shape (M,)."""
    value: FloatArray
    """Shape (M, ...)."""
    spread: FloatArray
    """1-sigma, covariance or information, as the sensor has it, shape (M, ...)."""
    t_ns: TimeArray
    """When it was measured, on average, shape (M,)."""


def depths(stream: Depth, keyframes: TimeArray, track: Track, lever_b: FloatArray) -> AtKeyframes:
    """Depth of the sensor at the keyframes, with 1-sigma."""
    stream, k = _near(stream, keyframes)
    moved = (track.point_at(keyframes[k], lever_b) - track.point_at(stream.t_ns, lever_b))[:, 2]
    weight = stream.sigma**-2.0
    keyframe, value, total = _weighted_mean(k, stream.depth + moved, weight)
    return AtKeyframes(keyframe, value, total**-0.5, _mean_time(k, stream.t_ns, keyframes, weight))


def headings(stream: Heading, keyframes: TimeArray, track: Track) -> AtKeyframes:
    """Heading at the keyframes, with 1-sigma."""
    stream, k = _near(stream, keyframes)
    value = stream.heading + track.heading_at(keyframes[k]) - track.heading_at(stream.t_ns)
    weight = stream.sigma**-2.0
    keyframe, cosine, total = _weighted_mean(k, np.cos(value), weight)
    _, sine, _ = _weighted_mean(k, np.sin(value), weight)
    t_ns = _mean_time(k, stream.t_ns, keyframes, weight)
    return AtKeyframes(keyframe, np.arctan2(sine, cosine), total**-0.5, t_ns)


def suns(stream: Sun, keyframes: TimeArray, track: Track) -> AtKeyframes:
    """Rank-2 information in the keyframes' body axes, dR^T Lambda dR.

    Observations are not summed: the sun moves 15 degrees an hour, and each keeps its own instant.
    """
    stream, k = _near(stream.select(stream.flags == 0), keyframes)
    dR = np.swapaxes(track.rotation_at(keyframes[k]), 1, 2) @ track.rotation_at(stream.t_ns)
    information = dR @ stream.information_b @ np.swapaxes(dR, 1, 2)
    return AtKeyframes(k, np.einsum("kij,kj->ki", dR, stream.s_b), information, stream.t_ns)


def fixes(
    stream: Fixes, origin: Origin, keyframes: TimeArray, track: Track, lever_b: FloatArray
) -> tuple[AtKeyframes, FloatArray]:
    """Position of the antenna in n at the keyframes with its covariance (local NED), and the axes of the local NED."""
    stream, k = _near(stream, keyframes)
    cov = stream.cov_n.copy()
    cov[~np.isfinite(stream.height), 2, 2] = np.inf
    p = ned_from_geodetic(origin, stream.lat, stream.lon, np.nan_to_num(stream.height))
    moved = track.point_at(keyframes[k], lever_b) - track.point_at(stream.t_ns, lever_b)
    return AtKeyframes(k, p + moved, cov, stream.t_ns), R_n_local(origin, stream.lat, stream.lon)


def _near(stream: Any, keyframes: TimeArray) -> tuple[Any, IndexArray]:
    """The samples that the keyframes span and the index of each one's keyframe."""
    kept = stream.select(inside(keyframes, stream.t_ns))
    return kept, nearest_keyframe(keyframes, kept.t_ns)


def _weighted_mean(k: IndexArray, value: FloatArray, weight: FloatArray) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Keyframes that have samples, their weighted mean and summed weight."""
    keyframe, group = np.unique(k, return_inverse=True)
    total = np.bincount(group, weight).astype(np.float64)
    return keyframe, np.bincount(group, weight * value) / total, total


def _mean_time(k: IndexArray, t_ns: TimeArray, keyframes: TimeArray, weight: FloatArray) -> TimeArray:
    """Weighted mean stamp of the samples of each keyframe that has any."""
    keyframe, since, _ = _weighted_mean(k, (t_ns - keyframes[k]).astype(np.float64), weight)
    mean: TimeArray = keyframes[keyframe] + np.rint(since).astype(np.int64)
    return mean
