"""From a dive to a filter's solution: the same first state, epochs and measurements for every filter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from uwgraph.filters.ins import BA, BG, GyroDrift, Ins, P, V, start_root
from uwgraph.filters.monitor import Policy
from uwgraph.filters.run import Epochs, Filtering, Kalman, Runner
from uwgraph.filters.sensors import observations
from uwgraph.filters.settings import FilterSettings
from uwgraph.filters.state import Belief
from uwgraph.graph.builder import VELOCITY_SIGMA
from uwgraph.graph.initial import Initial
from uwgraph.graph.observed import Observed
from uwgraph.graph.prepare import Prepared
from uwgraph.graph.track import Track
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
    more: Sequence[Observed] = ()
    """Measurements beside the dive's streams."""


def filter_dive(
    task: Task, kalman: Kalman, policy: Policy, settings: FilterSettings, progress: Callable[[float], None]
) -> tuple[Solution, Innovations | None]:
    """The filter's answer at the task's times, with what was known at each, and its innovations."""
    start = int(task.initial.t_ns)
    every = [*observations(task.prepared, task.track), *task.more]
    every = sorted((o for o in every if start < o.t_ns <= task.prepared.imu.t_ns[-1]), key=lambda o: o.t_ns)
    stamps = np.array([o.t_ns for o in every], dtype=np.int64)
    grid = np.unique(np.concatenate([[start], stamps, task.t_ns]))
    epochs = Epochs.of(task.prepared, task.track, grid, settings.samples_per_step)
    measured: dict[int, list[Observed]] = {}
    for epoch, observed in zip(np.searchsorted(grid, stamps).tolist(), every, strict=True):
        measured.setdefault(epoch, []).append(observed)
    delays = {kind: round(delay * 1e9) for kind, delay in settings.delays_s.items()}
    runner = Runner(kalman, policy, epochs, measured, delays)
    beliefs, innovations = runner.run(
        Filtering(first_belief(task, kalman.ins)), np.searchsorted(grid, task.t_ns), progress
    )
    return solution_of(task.prepared, beliefs), innovations


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
    y = np.array([b.x.y for b in beliefs])
    cov = np.array([b.P for b in beliefs])
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
