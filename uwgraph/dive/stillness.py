"""Which part of an inertial recording is still: the vehicle on deck or at the quay, or a sensor on the bench."""

from __future__ import annotations

from typing import Final

import numpy as np

from uwgraph.types import BoolArray, FloatArray, Imu

WINDOW_S: Final = 1.0
"""s; the recording is judged in windows of this length, or of ``BLOCKS`` samples where that is longer."""
BLOCKS: Final = 16
"""Parts of a window whose scatter tells how much its mean may err."""
JUMP: Final = 12.0
"""Sigmas of the quietest stretch by which the means of neighbouring windows may differ."""
MOST_RATE: Final = 5e-3
"""rad/s; no gyro at rest differs more from window to window, however much noise it seems to have."""
MOST_FORCE: Final = 0.1
"""m/s^2; the same for accelerometers: half a degree of tilt."""
SHAKE: Final = 5.0
"""How many times the quietest stretch's standard deviation a window may have."""
SHORTEST: Final = 3
"""Windows that make a stretch."""


def longest_still(imu: Imu, rate_hz: float) -> slice:
    """The longest stretch of equally spaced samples without motion; empty where there is none.

    Still is what differs from window to window no more than its own noise, as the quietest ``SHORTEST`` windows in a
    row show it, explains. A steady turn or a steady speed look the same as rest, but nothing keeps them that steady.
    """
    length = max(round(WINDOW_S * rate_hz), BLOCKS)
    count = len(imu) // length
    if count < SHORTEST:
        return slice(0, 0)
    joined, calm = np.ones(count - 1, dtype=np.bool_), np.ones(count, dtype=np.bool_)
    for signals, most in ((imu.f_s, MOST_FORCE), (imu.w_s, MOST_RATE)):
        for column in signals.T:
            _judge(column[: count * length].reshape(count, length), most, joined, calm)
    joined &= calm[1:] & calm[:-1]
    first, stop = _longest_run(joined)
    return slice(first * length, (stop + 1) * length) if stop - first + 1 >= SHORTEST else slice(0, 0)


def _judge(windows: FloatArray, most: float, joined: BoolArray, calm: BoolArray) -> None:
    """Clear ``joined`` where the mean jumps to the next window, and ``calm`` where one shakes, in windows (K, L)."""
    steps = np.abs(np.diff(windows.ravel()))
    resolution = float(steps[steps > 0.0].min(initial=np.inf))
    floor = resolution**2 / 12.0 if np.isfinite(resolution) else 0.0
    per_block = windows.shape[1] // BLOCKS
    means = windows[:, : per_block * BLOCKS].reshape(len(windows), BLOCKS, per_block).mean(axis=2)
    white = 0.5 * (np.diff(means, axis=1) ** 2).mean(axis=1)
    allowed = JUMP * np.sqrt(2.0 / BLOCKS * max(_quietest(white), floor))
    joined &= np.abs(np.diff(means.mean(axis=1))) <= min(allowed, most)
    variance = windows.var(axis=1)
    calm &= variance <= SHAKE**2 * max(_quietest(variance), floor)


def _quietest(variance: FloatArray) -> float:
    """The least mean of ``SHORTEST`` values in a row."""
    return float(np.convolve(variance, np.ones(SHORTEST) / SHORTEST, mode="valid").min())


def _longest_run(yes: BoolArray) -> tuple[int, int]:
    """First index, and the one after the last, of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.r_[False, yes, False].astype(np.int8)))
    if not len(edges):
        return 0, 0
    starts, stops = edges[::2], edges[1::2]
    longest = int(np.argmax(stops - starts))
    return int(starts[longest]), int(stops[longest])
