"""How much of a column is noise: of a vehicle that does not move, all of it.

A clock's column is how the velocity changes, a lever arm's how the attitude turns, both as the IMU saw them. On a
straight run what it saw is its own noise. Noise squared and added up looks like information: half an hour would tell a
clock to 30 ms, and be wrong by half a second (errors in variables).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import gtsam
import numpy as np

from uwgraph.calibrate.columns import RATE_OVER_S, factor_places, intervals, seconds_later
from uwgraph.calibrate.parameters import RATE, Parameter
from uwgraph.graph.smooth import Smoothed
from uwgraph.types import FloatArray

MARGIN = 2.0
"""The IMU's variance may be this much more than the rig states."""


def reliability(
    smoothed: Smoothed,
    linear: gtsam.GaussianFactorGraph,
    columns: Mapping[int, FloatArray],
    parameters: Sequence[Parameter],
    from_reference: Collection[str] = (),
) -> FloatArray:
    """Share of each parameter's columns that is motion, 0 to 1, shape (n,); arguments as of ``rig_columns``."""
    whole = np.zeros(len(parameters))
    for block in columns.values():
        whole += np.sum(block**2, axis=0)
    noise = np.zeros(len(parameters))
    for kind, place in factor_places(smoothed).items():
        sensor = "reference" if kind in from_reference else kind
        noisy = ("time_offset_s", RATE, "translation_m") if kind == "dvl" else ("time_offset_s", RATE)
        mine = [i for i, p in enumerate(parameters) if p.sensor == sensor and p.field in noisy]
        if mine and place:
            of = _dvl if kind == "dvl" else _pose
            noise[mine] += of(smoothed, linear, kind, place, [parameters[i] for i in mine])
    motion = 1.0 - MARGIN * np.divide(noise, whole, out=np.zeros_like(noise), where=whole > 0.0)
    return np.clip(motion, 0.0, 1.0)


def _dvl(
    smoothed: Smoothed, linear: gtsam.GaussianFactorGraph, kind: str, place: range, parameters: Sequence[Parameter]
) -> list[float]:
    """Sums of squares of the noise in columns of the displacements.

    The velocity of an interval wanders by the accelerometer's density. The turn of a lever arm is that of the gyro over
    the interval, less that of its single samples at the pings.
    """
    prepared, t_ns = smoothed.prepared, smoothed.solution.t_ns
    assert prepared.dvl is not None
    imu = prepared.dive.rig.imu
    keys, to_end, _ = intervals(smoothed, linear, place)
    start, end = keys.T
    weight = np.sum(to_end**2, axis=(1, 2))
    dt = (t_ns[end] - t_ns[start]) * 1e-9
    ping, sample = (float(np.median(np.diff(t))) for t in (prepared.dvl.t_ns, prepared.imu.t_ns))
    velocity = imu.accel_noise_density**2 * dt
    turn = imu.gyro_noise_density**2 * dt * (1.0 + ping / (2.0 * sample))
    squares = [velocity * seconds_later(p, t_ns[start]) ** 2 if p.of_a_clock else 2.0 / 3.0 * turn for p in parameters]
    return [float(weight @ square) for square in squares]


def _pose(
    smoothed: Smoothed, linear: gtsam.GaussianFactorGraph, kind: str, place: range, parameters: Sequence[Parameter]
) -> list[float]:
    """Sums of squares of the noise in columns of clocks: that of the turn rate. A lever arm's has none."""
    weight = np.array([np.sum(linear.at(i).jacobian()[0][:, :3] ** 2) for i in place])
    rate = smoothed.prepared.dive.rig.imu.gyro_noise_density**2 / (2.0 * RATE_OVER_S)
    t_ns = smoothed.problem.measured_ns[kind]
    return [float(weight @ seconds_later(p, t_ns) ** 2) * rate for p in parameters]
