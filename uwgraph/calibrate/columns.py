"""How every measurement moves when a number of the rig does: the Jacobian's columns of the rig.

A sensor that is elsewhere, turned, or late sees the vehicle as if the vehicle itself were moved, turned or a little
further on its way. So the columns of the rig are the columns of the poses, times that small motion: there is nothing
to differentiate anew, and weights of robust losses are the graph's own.

The motion is the estimated one, never the measured one. The noise of a measurement in its own column would pull the
estimate (errors in variables): a DVL's scale by 0.1 to 0.4 % on a MEMS dive.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from factors.lie import skew
from uwgraph.calibrate.parameters import RATE, Parameter
from uwgraph.dive.rig import Sensor
from uwgraph.graph.builder import bend_between_pings
from uwgraph.graph.smooth import Smoothed
from uwgraph.types import FloatArray, TimeArray

IndexArray = NDArray[np.intp]

KINDS: Mapping[str, Sequence[str]] = {
    "translation_m": ("depth", "fixes"),
    "rotation_deg": ("heading", "sun"),
    "time_offset_s": ("depth", "fixes", "heading", "sun"),
    RATE: ("depth", "fixes", "heading", "sun"),
}
RATE_OVER_S = 0.1
"""The turn rate is the mean over this long on either side."""


def rig_columns(
    smoothed: Smoothed,
    linear: gtsam.GaussianFactorGraph,
    parameters: Sequence[Parameter],
    from_reference: Collection[str] = (),
) -> dict[int, FloatArray]:
    """Whitened columns of the parameters, shape (rows, parameters), for every factor of the linear graph that has any.

    ``linear`` is the smoothed problem, linearised at its solution: factors in the graph's order. ``from_reference``
    names the streams that were made from the reference.
    """
    columns: dict[int, FloatArray] = {}
    for kind, place in factor_places(smoothed).items():
        sensor = "reference" if kind in from_reference else kind
        mine = [i for i, p in enumerate(parameters) if p.sensor == sensor and (kind == "dvl" or kind in KINDS[p.field])]
        if not mine or not place:
            continue
        rows = (
            _dvl(smoothed, linear, place, [parameters[i] for i in mine])
            if kind == "dvl"
            else _pose(smoothed, linear, kind, place, [parameters[i] for i in mine])
        )
        for factor, block in zip(place, rows, strict=True):
            columns[factor] = np.zeros((len(block), len(parameters)))
            columns[factor][:, mine] = block
    return columns


def euler_axes(rph_deg: Sequence[float]) -> FloatArray:
    """Turns of the body frame [rad] that a degree of roll, pitch and yaw makes, columns of shape (3, 3)."""
    _, pitch, yaw = np.radians(rph_deg)
    Rz = Rotation.from_euler("z", yaw)
    Ry = Rotation.from_euler("y", pitch)
    axes = [(Rz * Ry).apply([1.0, 0.0, 0.0]), Rz.apply([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])]
    turns: FloatArray = np.radians(np.stack(axes, axis=-1))
    return turns


def factor_places(smoothed: Smoothed) -> dict[str, range]:
    """Where the factors of each kind stand in the graph."""
    ends = np.cumsum([0, *smoothed.problem.counts.values()]).tolist()
    kinds = dict(zip(smoothed.problem.counts, map(range, ends[:-1], ends[1:]), strict=True))
    return {kind: place for kind, place in kinds.items() if kind == "dvl" or kind in smoothed.problem.measured_ns}


def _pose(
    smoothed: Smoothed, linear: gtsam.GaussianFactorGraph, kind: str, place: range, parameters: Sequence[Parameter]
) -> FloatArray:
    """Columns of factors on one pose each, shape (factors, rows, parameters)."""
    jacobians = np.array([linear.at(i).jacobian()[0] for i in place])
    k = np.array([gtsam.symbolIndex(linear.at(i).keys()[0]) for i in place])
    t_ns = smoothed.problem.measured_ns[kind]
    track = smoothed.track
    R_kt = np.swapaxes(smoothed.solution.R_nb[k], 1, 2) @ track.rotation_at(t_ns)
    R_kn = np.swapaxes(smoothed.solution.R_nb[k], 1, 2)
    moved = np.concatenate(
        [
            R_kt @ _turn_rate(smoothed, t_ns)[:, :, None],
            R_kn @ track.velocity_at(t_ns)[:, :, None],
        ],
        axis=1,
    )
    rig = smoothed.prepared.dive.rig
    motions = np.zeros((len(place), 6, len(parameters)))
    for j, p in enumerate(parameters):
        if p.field == "translation_m":
            motions[:, 3:, j] = R_kt[:, :, p.index]
        elif p.field == "rotation_deg":
            sensor: Sensor = getattr(rig, p.sensor)
            turn = [0.0, 0.0, np.radians(1.0)] if kind == "heading" else euler_axes(sensor.rotation_deg)[:, p.index]
            motions[:, :3, j] = R_kt @ turn
        else:
            motions[:, :, j] = moved[..., 0] * seconds_later(p, t_ns)[:, None]
    columns: FloatArray = jacobians @ motions
    return columns


def _dvl(
    smoothed: Smoothed, linear: gtsam.GaussianFactorGraph, place: range, parameters: Sequence[Parameter]
) -> FloatArray:
    """Columns of the displacement factors, shape (factors, rows, parameters).

    What the DVL should have measured changes by dq, in the axes of the interval's start; moving the end pose by as
    much does the same.
    """
    keys, to_end, R_ij = intervals(smoothed, linear, place)
    i, j = keys.T
    solution, track, rig = smoothed.solution, smoothed.track, smoothed.prepared.dive.rig.dvl
    R_in = np.swapaxes(solution.R_nb[i], 1, 2)
    middle = (solution.t_ns[i] + solution.t_ns[j]) // 2
    R_mid = R_in @ track.rotation_at(middle)
    bend, bend_of_lever = _bend(smoothed, i, j)
    lever = R_ij - np.eye(3)
    way = (R_in @ (solution.p_n[j] - solution.p_n[i])[:, :, None])[..., 0] + lever @ rig.l_b
    q = way - bend
    velocity = np.einsum("kji,kj->ki", solution.R_nb, solution.v_n) + np.cross(
        _turn_rate(smoothed, solution.t_ns), rig.l_b
    )
    later = (R_mid @ (velocity[j] - velocity[i])[:, :, None])[..., 0]
    turned = skew(q) @ R_mid @ euler_axes(rig.rotation_deg)
    dq = np.zeros((len(place), 3, len(parameters)))
    for n, p in enumerate(parameters):
        if p.field == "scale":
            dq[..., n] = -q / rig.scale
        elif p.field == "rotation_deg":
            dq[..., n] = turned[..., p.index]
        elif p.field == "translation_m":
            dq[..., n] = (lever - bend_of_lever)[..., p.index]
        else:
            dq[..., n] = later * seconds_later(p, middle)[:, None]
    columns: FloatArray = to_end @ np.swapaxes(R_ij, 1, 2) @ dq
    return columns


def intervals(
    smoothed: Smoothed, linear: gtsam.GaussianFactorGraph, place: range
) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Of the displacement factors: keyframes, shape (N, 2), whitened rows of the end's position, and R_ij."""
    keys = np.array([[gtsam.symbolIndex(key) for key in linear.at(i).keys()] for i in place])  # noqa: SIM118
    to_end = np.array([linear.at(i).jacobian()[0][:, 9:12] for i in place])
    R_nb = smoothed.solution.R_nb
    return keys, to_end, np.swapaxes(R_nb[keys[:, 0]], 1, 2) @ R_nb[keys[:, 1]]


def _bend(smoothed: Smoothed, i: IndexArray, j: IndexArray) -> tuple[FloatArray, FloatArray]:
    """The inertial part of the displacements, shape (N, 3), and how it grows with the lever arm, shape (N, 3, 3)."""
    prepared, t_ns = smoothed.prepared, smoothed.solution.t_ns
    assert prepared.dvl is not None
    assert (j == i + 1).all()
    still, here, *axes = (
        bend_between_pings(prepared.imu, lever, prepared.dvl.t_ns, t_ns)[i]
        for lever in (np.zeros(3), prepared.dive.rig.dvl.l_b, *np.eye(3))
    )
    return here, np.stack(axes, axis=-1) - still[..., None]


def seconds_later(p: Parameter, t_ns: TimeArray) -> FloatArray:
    """Seconds that a measurement is later, per unit of the parameter; a rate turns about the middle of the stream."""
    if p.field == "time_offset_s":
        return np.ones(len(t_ns))
    return np.asarray((t_ns - (t_ns[0] + (t_ns[-1] - t_ns[0]) // 2)) * 1e-9 * 1e-6)


def _turn_rate(smoothed: Smoothed, t_ns: TimeArray) -> FloatArray:
    """Angular rate of the body against n in body axes, shape (N, 3), rad/s."""
    grid = smoothed.solution.t_ns
    step = round(RATE_OVER_S * 1e9)
    before, after = (np.clip(t_ns + d, grid[0], grid[-1]) for d in (-step, step))
    R, S = smoothed.track.rotation_at(before), smoothed.track.rotation_at(after)
    turn = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ S).as_rotvec()
    rate: FloatArray = turn / ((after - before) * 1e-9)[:, None]
    return rate
