"""When the states are: a keyframe at least every period and every turn, on DVL pings where there are any.

A displacement between two pings needs no velocity that nobody measured, so keyframes are moved to the nearest ping, or
where there is no DVL to the nearest image of visual odometry.
"""

from __future__ import annotations

import numpy as np

from uwgraph.graph.prepare import Prepared
from uwgraph.graph.settings import SmoothSettings
from uwgraph.types import BoolArray, TimeArray


def schedule(prepared: Prepared, settings: SmoothSettings, start_ns: int, end_ns: int) -> TimeArray:
    """Keyframe stamps from ``start_ns`` to ``end_ns``, both included, shape (K,)."""
    period = round(settings.keyframe_period_s * 1e9)
    grid = _regular(start_ns, end_ns, period)
    grid = _split_turns(prepared, grid, np.radians(settings.keyframe_turn_deg))
    if prepared.dvl is not None:
        grid = _snap(grid, prepared.dvl.t_ns)
    elif settings.odometry and prepared.odometry is not None:
        grid = _snap(grid, np.unique(prepared.odometry.t_ns))
    return grid


def _regular(start_ns: int, end_ns: int, period: int) -> TimeArray:
    count = max(-(-(end_ns - start_ns) // period), 1)
    grid = start_ns + period * np.arange(count + 1, dtype=np.int64)
    grid[-1] = end_ns
    return grid


def _split_turns(prepared: Prepared, grid: TimeArray, limit: float) -> TimeArray:
    """Split every interval in which the gyro turned by more than ``limit`` [rad] into parts of equal turn."""
    imu = prepared.imu
    t, edges = (imu.t_ns - grid[0]) * 1e-9, (grid - grid[0]) * 1e-9
    steps = np.linalg.norm(imu.w_b, axis=1) * np.diff(t)
    so_far = np.concatenate([[0.0], np.cumsum(steps)])
    turned = np.interp(edges, t, so_far)
    parts = np.ceil(np.diff(turned) / limit - 1e-9).astype(np.int64)
    angles = [np.linspace(a, b, n + 1)[1:-1] for a, b, n in zip(turned, turned[1:], parts, strict=False) if n > 1]
    cuts = np.interp(np.concatenate([[], *angles]), so_far, t)
    stamps: TimeArray = np.unique(np.concatenate([grid, grid[0] + np.rint(cuts * 1e9).astype(np.int64)]))
    return stamps


def _snap(grid: TimeArray, pings: TimeArray) -> TimeArray:
    """Move inner grid points to the nearest ping within half their spacing; ends stay, nobody is counted twice."""
    inner, spacing = grid[1:-1], np.diff(grid)
    reach = np.minimum(spacing[:-1], spacing[1:]) // 2
    right = np.clip(np.searchsorted(pings, inner), 1, max(len(pings) - 1, 1))
    left = pings[right - 1]
    after = pings[np.minimum(right, len(pings) - 1)]
    nearest = np.where(inner - left <= after - inner, left, after)
    snapped = np.where(np.abs(nearest - inner) <= reach, nearest, inner)
    stamps = np.unique(np.concatenate([grid[:1], snapped, grid[-1:]]))
    within: TimeArray = stamps[(stamps >= grid[0]) & (stamps <= grid[-1])]
    return within


def nearest_keyframe(keyframes: TimeArray, t_ns: TimeArray) -> TimeArray:
    """Index of the nearest keyframe to each stamp, shape (N,)."""
    right = np.clip(np.searchsorted(keyframes, t_ns), 1, len(keyframes) - 1)
    return np.where(t_ns - keyframes[right - 1] <= keyframes[right] - t_ns, right - 1, right)


def inside(keyframes: TimeArray, t_ns: TimeArray) -> BoolArray:
    """Mask of the stamps that the keyframes span."""
    mask: BoolArray = (t_ns >= keyframes[0]) & (t_ns <= keyframes[-1])
    return mask
