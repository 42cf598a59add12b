"""Doppler pings that contradict their neighbours: fish, bubbles, a second echo.

In axes that the gyro holds still the Doppler velocity less the integrated specific force is a straight line, whatever
the vehicle does: what is left of the acceleration is gravity. A ping far from the line through its neighbours is wrong.
It has to be found before pings become displacements: of five pings a second with one in five wrong, two out of three
displacements would be.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from uwgraph.types import BoolArray, FloatArray, TimeArray

NEIGHBOURS = 21
"""Pings whose line tells; odd."""
SIGMAS = 6.0
"""Distance from the line beyond which a ping is wrong."""
MAD = 1.4826
"""Standard deviations in a median absolute deviation of a normal distribution."""
CHUNK = 1024
LONGEST_S = 30.0
"""Over a longer time the line is no line: biases and the Earth bend it."""


def contradicted(t_ns: TimeArray, u_g: FloatArray, sigma: FloatArray) -> BoolArray:
    """Which pings contradict their neighbours, shape (N,).

    Parameters
    ----------
    t_ns
        Stamps, increasing, shape (N,).
    u_g
        Velocity of the body less the integrated specific force, in axes that do not turn, shape (N, 3), m/s.
    sigma
        Stated 1-sigma of the pings' velocity, the largest of the axes, shape (N,), m/s. Where the pings scatter more
        about their lines than is stated, that scatter is the measure.
    """
    N = len(t_ns)
    if N < NEIGHBOURS:
        return np.zeros(N, dtype=np.bool_)
    t = (t_ns - t_ns[0]) * 1e-9
    first = np.clip(np.arange(N) - NEIGHBOURS // 2, 0, N - NEIGHBOURS)
    times = sliding_window_view(t, NEIGHBOURS)[first]
    velocities = sliding_window_view(u_g, NEIGHBOURS, axis=0)[first]
    distance = u_g - _mean_line(times - t[:, None], velocities)
    # lines by least squares are quick, and where no ping is far from one there is none that bends it
    doubtful = np.convolve(_far(distance, sigma, 0.5 * SIGMAS), np.ones(2 * NEIGHBOURS - 1), "same") > 0
    k = np.flatnonzero(doubtful)
    for part in np.array_split(k, max(1, len(k) // CHUNK)):
        distance[part] = u_g[part] - _median_line(times[part] - t[part, None], velocities[part])
    return np.asarray(_far(distance, sigma, SIGMAS) & (times[:, -1] - times[:, 0] <= LONGEST_S))


def _far(distance: FloatArray, sigma: FloatArray, sigmas: float) -> BoolArray:
    """Where a distance, shape (N, 3), is larger than so many of the stated or of the usual deviations, shape (N,)."""
    scatter = MAD * np.median(np.abs(distance), axis=0)
    return np.asarray(np.any(np.abs(distance) > sigmas * np.maximum(sigma[:, None], scatter), axis=1))


def _mean_line(t: FloatArray, v: FloatArray) -> FloatArray:
    """The line through each window by least squares at time zero, shape (N, 3); ``t`` (N, w), ``v`` (N, 3, w)."""
    centre = t.mean(axis=1, keepdims=True)
    weight = 1.0 / t.shape[1] - centre * (t - centre) / np.sum((t - centre) ** 2, axis=1, keepdims=True)
    return np.asarray(np.einsum("nw,niw->ni", weight, v))


def _median_line(t: FloatArray, v: FloatArray) -> FloatArray:
    """The line through each window by repeated medians at time zero, shape (N, 3): nearly half of it may be wrong.

    ``t`` has shape (N, w), ``v`` (N, 3, w). Siegel, "Robust regression using repeated medians", 1982.
    """
    off = ~np.eye(t.shape[1], dtype=np.bool_)
    w = t.shape[1]
    dt = (t[:, None, :] - t[:, :, None])[:, off].reshape(len(t), 1, w, w - 1)
    dv = (v[:, :, None, :] - v[:, :, :, None])[:, :, off].reshape(len(t), 3, w, w - 1)
    slope = np.median(np.median(dv / dt, axis=3), axis=2)
    return np.asarray(np.median(v - slope[:, :, None] * t[:, None, :], axis=2))
