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

NEIGHBOURS = 15
"""Pings whose line tells; odd."""
SIGMAS = 6.0
"""Distance from the line beyond which a ping is wrong."""
MAD = 1.4826
"""Standard deviations in a median absolute deviation of a normal distribution."""
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
    velocities = np.swapaxes(sliding_window_view(u_g, NEIGHBOURS, axis=0)[first], 1, 2)
    distance = u_g - _median_line(times, velocities, t)
    scatter = MAD * np.median(np.abs(distance), axis=0)
    far = np.any(np.abs(distance) > SIGMAS * np.maximum(sigma[:, None], scatter), axis=1)
    return np.asarray(far & (times[:, -1] - times[:, 0] <= LONGEST_S))


def _median_line(t: FloatArray, v: FloatArray, at: FloatArray) -> FloatArray:
    """The line through each window by Theil and Sen, shape (N, 3), at the times ``at``: half of it may be wrong.

    ``t`` has shape (N, w), ``v`` (N, w, 3).
    """
    i, j = np.triu_indices(t.shape[1], k=t.shape[1] // 2)
    slope = np.median((v[:, j] - v[:, i]) / (t[:, j] - t[:, i])[..., None], axis=1)
    return np.asarray(np.median(v - slope[:, None] * (t - at[:, None])[..., None], axis=1))
