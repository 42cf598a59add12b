"""How much of a column is noise: of a vehicle that does not move, all of it.

A clock's column is how the velocity changes, a lever arm's how the attitude turns, both as the IMU saw them. On a
straight run what it saw is its own noise. Noise squared and added up looks like information: half an hour would tell a
clock to 30 ms, and be wrong by half a second (errors in variables).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import gtsam
import numpy as np

from uwgraph.calibrate.columns import RATE_OVER_S, factor_places, seconds_later
from uwgraph.calibrate.parameters import Parameter
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
        mine = [
            i for i, p in enumerate(parameters) if p.sensor == sensor and (p.of_a_clock or p.field == "translation_m")
        ]
        if not mine or not place:
            continue
        of = _dvl if kind == "dvl" else _pose
        for i in mine:
            noise[i] += of(smoothed, linear, kind, place, parameters[i])
    motion = 1.0 - MARGIN * np.divide(noise, whole, out=np.zeros_like(noise), where=whole > 0.0)
    return np.clip(motion, 0.0, 1.0)


def _dvl(smoothed: Smoothed, linear: gtsam.GaussianFactorGraph, kind: str, place: range, p: Parameter) -> float:
    """Sum of squares of the noise in a column of the displacements.

    The velocity of an interval wanders by the accelerometer's density. The turn of a lever arm is that of the gyro over
    the interval, less that of its single samples at the pings.
    """
    prepared, t_ns = smoothed.prepared, smoothed.solution.t_ns
    assert prepared.dvl is not None
    imu = prepared.dive.rig.imu
    start = np.array([gtsam.symbolIndex(linear.at(i).keys()[0]) for i in place])
    weight = np.array([np.sum(linear.at(i).jacobian()[0][:, 9:12] ** 2) for i in place])
    dt = (t_ns[start + 1] - t_ns[start]) * 1e-9
    if p.of_a_clock:
        per_axis = imu.accel_noise_density**2 * dt * seconds_later(p, t_ns[start]) ** 2
        return float(weight @ per_axis)
    ping, sample = (float(np.median(np.diff(t))) for t in (prepared.dvl.t_ns, prepared.imu.t_ns))
    per_axis = imu.gyro_noise_density**2 * dt * (1.0 + ping / (2.0 * sample))
    return float(weight @ per_axis) * 2.0 / 3.0


def _pose(smoothed: Smoothed, linear: gtsam.GaussianFactorGraph, kind: str, place: range, p: Parameter) -> float:
    """Sum of squares of the noise in a clock's column: that of the turn rate. A lever arm's has none."""
    if not p.of_a_clock:
        return 0.0
    weight = np.array([np.sum(linear.at(i).jacobian()[0][:, :3] ** 2) for i in place])
    rate = smoothed.prepared.dive.rig.imu.gyro_noise_density**2 / (2.0 * RATE_OVER_S)
    return float(weight @ seconds_later(p, smoothed.problem.measured_ns[kind]) ** 2) * rate
