"""From a dive to a filter's solution: the same first state, epochs and measurements for every filter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from uwgraph.dive import Dive
from uwgraph.filters.ins import BA, BG, CORE, GyroDrift, Ins, P, V, start_root
from uwgraph.filters.kalman import Kalman
from uwgraph.filters.monitor import Policy
from uwgraph.filters.run import Epochs, Filtering, Runner
from uwgraph.filters.sensors import observations, relative, rememberable
from uwgraph.filters.settings import FilterSettings
from uwgraph.filters.state import Belief
from uwgraph.graph.builder import VELOCITY_SIGMA
from uwgraph.graph.initial import Initial, initial_state
from uwgraph.graph.keyframes import schedule
from uwgraph.graph.observed import Observed
from uwgraph.graph.prepare import Prepared, prepare
from uwgraph.graph.settings import SmoothSettings
from uwgraph.graph.track import Track, dead_reckon
from uwgraph.types import FloatArray, Innovations, Solution, TimeArray


@dataclass(frozen=True, eq=False)
class Task:
    """What every estimator is given: a prepared dive, its first state, and the times to answer for."""

    prepared: Prepared
    initial: Initial
    track: Track
    """Dead reckoning from the first state: where things were measured, roughly."""
    t_ns: TimeArray
    """Increasing, not before the first state, shape (K,)."""
    settings: SmoothSettings
    """Where the first state comes from, and which of the dive's streams are used."""
    more: Sequence[Observed] = ()
    """Measurements beside the dive's streams."""


def task_of(
    dive: Dive, settings: SmoothSettings | None = None, t_ns: TimeArray | None = None, more: Sequence[Observed] = ()
) -> Task:
    """The task of a dive, with the same first state and, where no times are given, the same keyframes as the graph.

    Raises
    ------
    DataError, InitialisationError
        As :func:`uwgraph.graph.smooth` does.
    """
    settings = settings or SmoothSettings()
    prepared = prepare(dive)
    initial = initial_state(prepared, settings)
    track = dead_reckon(prepared, initial.t_ns, initial.R_nb, initial.p_n, initial.cov_rotation_b)
    if t_ns is None:
        t_ns = schedule(prepared, settings, initial.t_ns, int(prepared.imu.t_ns[-1]))
    return Task(prepared, initial, track, t_ns[t_ns >= initial.t_ns], settings, more)


@dataclass(frozen=True, eq=False)
class Filtered:
    """What a filter makes of a dive."""

    beliefs: Sequence[Belief]
    """At the task's times, each with what had reached the filter by then."""
    innovations: Innovations | None


def filter_dive(
    task: Task,
    kalman: Kalman,
    policy: Policy,
    settings: FilterSettings,
    progress: Callable[[float], None] = lambda share: None,
) -> Filtered:
    """Run a filter over a dive from its first state."""
    measured, last_use = _measured(task, settings)
    stamps = np.array([o.t_ns for o in measured], dtype=np.int64)
    start = task.initial.t_ns
    remembered = np.array([start, *last_use], dtype=np.int64)
    grid = np.unique(np.concatenate([remembered, stamps, task.t_ns]))
    by_epoch: dict[int, list[Observed]] = {}
    for epoch, observed in zip(np.searchsorted(grid, stamps).tolist(), measured, strict=True):
        by_epoch.setdefault(epoch, []).append(observed)
    epochs = Epochs.of(task.prepared, task.track, grid, settings.samples_per_step)
    delays = {kind: round(delay * 1e9) for kind, delay in settings.delays_s.items()}
    runner = Runner(kalman, policy, epochs, by_epoch, delays, last_use)
    begin = Filtering(first_belief(task, kalman.ins))
    return Filtered(*runner.run(begin, np.searchsorted(grid, task.t_ns), progress))


def _measured(task: Task, settings: FilterSettings) -> tuple[list[Observed], dict[int, int]]:
    """Everything measured from the first state on, and the poses to be remembered with their last use, ns."""
    prepared, start, end = task.prepared, task.initial.t_ns, int(task.t_ns[-1])
    streams = {"odometry": prepared.odometry if task.settings.odometry else None}
    if task.settings.closures and prepared.closures is not None and settings.max_nodes:
        streams["closures"] = prepared.closures.select(prepared.closures.accepted)
    measured = [*observations(prepared, task.track), *task.more]
    last_use: dict[int, int] = {}
    for kind, stream in streams.items():
        if stream is None:
            continue
        seen = stream.select((stream.from_ns >= start) & (stream.t_ns <= end))
        if kind == "closures":
            seen = rememberable(seen, settings.max_nodes)
        measured += relative(kind, seen)
        for before, after in zip(seen.from_ns.tolist(), seen.t_ns.tolist(), strict=True):
            last_use[before] = max(last_use.get(before, 0), after)
    return sorted((o for o in measured if start <= o.t_ns <= end), key=lambda o: o.t_ns), last_use


def ins_of(prepared: Prepared, settings: FilterSettings) -> Ins:
    """The inertial model that the settings and the rig ask for."""
    markov = settings.gyro_drift != "walk"
    rig = prepared.dive.rig
    calibrated = prepared.dvl is not None and (rig.dvl.scale_sigma > 0.0 or rig.dvl.misalignment_sigma_deg > 0.0)
    drift = GyroDrift(settings.gyro_tau_s, settings.accel_tau_s) if markov else None
    return Ins(rig.imu, drift, calibrated)


def first_belief(task: Task, ins: Ins) -> Belief:
    """The first state with the graph's own prior; of the gyro bias what a rest at the start told."""
    initial, rig = task.initial, task.prepared.dive.rig
    velocity = task.track.velocity_at(np.array([initial.t_ns]))[0]
    blocks: list[FloatArray] = [
        np.asarray(np.linalg.cholesky(initial.cov_rotation_b)),
        np.diag(initial.sigma_p),
        VELOCITY_SIGMA * np.eye(3),
        task.prepared.rest.sigma * np.eye(3),
        rig.imu.accel_bias_sigma * np.eye(3),
    ]
    if ins.drift is not None:
        blocks.append(rig.imu.gyro_bias_walk * np.sqrt(ins.drift.gyro_tau_s / 2.0) * np.eye(3))
    if ins.calibrated:
        angle = np.radians(rig.dvl.misalignment_sigma_deg)
        blocks.append(np.diag(np.maximum([rig.dvl.scale_sigma, angle, angle, angle], 1e-9)))
    return Belief(initial.t_ns, ins.state(initial.R_nb, initial.p_n, velocity), start_root(blocks))


def solution_of(prepared: Prepared, beliefs: Sequence[Belief]) -> Solution:
    """Beliefs as states with the covariances that people know."""
    R = np.array([b.x.R[0] for b in beliefs])
    y = np.array([b.x.y[:CORE] for b in beliefs])
    root = np.array([b.S[:CORE, :CORE] for b in beliefs])
    cov = root @ np.swapaxes(root, 1, 2)
    to_body = np.zeros((len(R), 6, 6))
    to_body[:, :3, :3] = np.eye(3)
    to_body[:, 3:, 3:] = np.swapaxes(R, 1, 2)
    bias = np.r_[BA, BG]
    return Solution(
        origin=prepared.origin,
        t_ns=np.array([b.t_ns for b in beliefs], dtype=np.int64),
        R_nb=R,
        p_n=y[:, P],
        v_n=y[:, V],
        bias_gyro=y[:, BG] + prepared.rest.bias_gyro,
        bias_accel=y[:, BA],
        cov_pose=to_body @ cov[:, :6, :6] @ np.swapaxes(to_body, 1, 2),
        cov_v=cov[:, V, V],
        cov_bias=cov[:, bias[:, None], bias],
    )
