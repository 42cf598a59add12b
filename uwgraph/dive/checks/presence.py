"""What smoothing misses in a dive, and what that costs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from uwgraph.dive.checks.finding import Finding, Level
from uwgraph.dive.model import Dive
from uwgraph.types import Imu

MIN_IMU_HZ: Final = 10.0
"""A vehicle turns and shakes at some hertz: samples further apart do not add up to its motion."""
DRIFT_M: Final = 10.0
"""More is worth a warning."""


def check_presence(dive: Dive) -> Iterator[Finding]:
    """Streams that are missing or too sparse to be of use."""
    if dive.imu is None or len(dive.imu) < 2:
        remedy = "nothing can be smoothed without them"
        yield Finding("error", "imu", "presence", "there are no inertial samples", remedy)
    elif (slow := too_slow(dive.imu)) is not None:
        yield slow
    if dive.dvl is None:
        yield _without_dvl(dive)
    if dive.depth is None:
        yield Finding("info", "depth", "presence", "missing: depth is known from fixes at best")
    if dive.heading is not None and dive.heading.reference == "magnetic" and dive.rig.heading.declination_deg is None:
        message = "magnetic, and rig.heading.declination_deg is not set: smoothing refuses it"
        remedy = "set the declination of place and year in dive.yaml, or take heading off the list of streams"
        yield Finding("error", "heading", "presence", message, remedy)
    if dive.reference is not None and len(dive.reference) < 2:
        message = "a single pose: nothing is judged by it"
        yield Finding("warning", "reference", "presence", message, "export the whole of it, or leave it out")
    if dive.sun is None and dive.heading is None and dive.fixes is None:
        message = "missing, like sun and fixes: heading drifts with the gyro, and its start must be given"
        yield Finding("info", "heading", "presence", message)


def missing_in_words(dive: Dive) -> tuple[str, ...]:
    """What stands in the way of a good solution, a line each."""
    return tuple(f"{f.stream} {f.message}" for f in check_presence(dive) if f.level in ("error", "warning"))


def too_slow(imu: Imu) -> Finding | None:
    """The error of an IMU that was not logged often enough to be integrated; None where it was."""
    rate = 1e9 / float(np.median(np.diff(imu.t_ns)))
    if not 0.0 < rate < MIN_IMU_HZ:
        return None
    message = f"logged at {rate:.3g} Hz, which does not carry the attitude from one sample to the next"
    remedy = (
        f"log the IMU at {MIN_IMU_HZ:g} Hz at least, better 100 (ArduSub: SR0_RAW_SENS for a .tlog, the IMU bit of "
        "LOG_BITMASK for a .BIN, which usually has more)"
    )
    return Finding("error", "imu", "presence", message, remedy, rate, MIN_IMU_HZ)


def _without_dvl(dive: Dive) -> Finding:
    """How far the IMU alone may go astray in the longest time without a fix."""
    if dive.imu is None or len(dive.imu) < 2:
        return Finding("info" if dive.fixes is not None else "warning", "dvl", "presence", "missing")
    fixed = dive.fixes.t_ns if dive.fixes is not None else dive.imu.t_ns[:0]
    known = np.concatenate([dive.imu.t_ns[:1], np.sort(fixed), dive.imu.t_ns[-1:]])
    alone_s = float(np.diff(known).max()) * 1e-9
    bias = dive.rig.imu.accel_bias_sigma
    drift = 0.5 * bias * alone_s**2
    message = (
        f"missing: for {alone_s:.0f} s the IMU alone carries the position, which is then unsure by {drift:.1f} m "
        f"or more (accelerometer bias {bias:g} m/s^2)"
    )
    level: Level = "warning" if drift > DRIFT_M else "info"
    remedy = "add a DVL, or position fixes" if level == "warning" else ""
    return Finding(level, "dvl", "presence", message, remedy, drift, DRIFT_M)
