"""Every estimator behind one protocol: a task in, a solution at the task's times out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Protocol

import numpy as np

from uwgraph.dive.rig import Settings
from uwgraph.filters.estimate import Task, filter_dive, ins_of, solution_of
from uwgraph.filters.kalman import Extended, Kalman, Unscented
from uwgraph.filters.kinematic_estimate import kinematic_estimate
from uwgraph.filters.monitor import Policy
from uwgraph.filters.rts import Remembering, smoothed
from uwgraph.filters.settings import FilterSettings
from uwgraph.filters.unscented import Spread
from uwgraph.graph import SmoothSettings, resample, smooth
from uwgraph.graph.track import dead_reckon
from uwgraph.types import Innovations, Solution

Progress = Callable[[str, float], None]


class EstimatorSettings(Settings):
    """What can be chosen about a contest's estimators; the first state is ``smooth``'s for all of them."""

    smooth: SmoothSettings = SmoothSettings()
    filter: FilterSettings = FilterSettings()


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimator's answer."""

    solution: Solution
    """At the task's times; NaN covariances where the estimator has none."""
    innovations: Innovations | None = None
    """What a filter made of its measurements."""


class Estimator(Protocol):
    """Anything that answers a task."""

    def __call__(self, task: Task, settings: EstimatorSettings, progress: Progress) -> Estimate:
        """The answer to a task; raises what :func:`uwgraph.graph.smooth` does."""
        ...


@dataclass(frozen=True)
class Named:
    """An estimator as people know it."""

    title: str
    causal: bool
    """Whether an estimate rests on nothing that came after it."""
    run: Estimator


def dead_reckoning(task: Task, settings: EstimatorSettings, progress: Progress) -> Estimate:
    """Gyro and Doppler log from the first state on, without sun, compass and fixes; no covariance."""
    start, K = task.initial, len(task.t_ns)
    track = dead_reckon(task.prepared, start.t_ns, start.R_nb, start.p_n, start.cov_rotation_b, heading_aids=False)
    grid = np.searchsorted(track.t_ns, task.t_ns, side="right") - 1
    solution = Solution(
        origin=task.prepared.origin,
        t_ns=task.t_ns,
        R_nb=track.rotation_at(task.t_ns),
        p_n=track.position_at(task.t_ns),
        v_n=track.velocity_at(task.t_ns),
        bias_gyro=np.broadcast_to(track.bias_gyro, (len(track.t_ns), 3))[grid] + task.prepared.rest.bias_gyro,
        bias_accel=np.zeros((K, 3)),
        cov_pose=np.full((K, 6, 6), np.nan),
        cov_v=np.full((K, 3, 3), np.nan),
        cov_bias=np.full((K, 6, 6), np.nan),
    )
    return Estimate(solution)


def error_state(task: Task, settings: EstimatorSettings, progress: Progress, *, adaptive: bool = False) -> Estimate:
    """The error-state extended Kalman filter."""
    return _filtered(task, Extended(ins_of(task.prepared, settings.filter)), settings, progress, adaptive)


def unscented(task: Task, settings: EstimatorSettings, progress: Progress, *, adaptive: bool = False) -> Estimate:
    """The unscented Kalman filter, with the noise that is stated or with that which it learns."""
    points = settings.filter.sigma_points
    spread = Spread(points.alpha, points.beta, points.kappa)
    return _filtered(task, Unscented(ins_of(task.prepared, settings.filter), spread), settings, progress, adaptive)


def kinematic(task: Task, settings: EstimatorSettings, progress: Progress) -> Estimate:
    """The adaptive unscented filter of the kinematic model: position and heading, driven by Doppler log and gyro."""
    progress("filtering", 0.0)
    return Estimate(*kinematic_estimate(task, settings.filter))


def rauch_tung_striebel(task: Task, settings: EstimatorSettings, progress: Progress) -> Estimate:
    """The error-state Kalman filter and its backward pass, without late measurements and places seen again."""
    kalman = Remembering(ins_of(task.prepared, settings.filter))
    alone = settings.filter.model_copy(update={"max_nodes": 0, "delays_s": {}})
    task = replace(task, settings=task.settings.model_copy(update={"odometry": False}))
    filtered = filter_dive(task, kalman, Policy(alone.gate), alone, lambda share: progress("filtering", share))
    progress("smoothing", 0.0)
    beliefs = smoothed(kalman.passages, filtered.beliefs[-1])
    at = np.searchsorted([b.t_ns for b in beliefs], task.t_ns)
    return Estimate(solution_of(task.prepared, [beliefs[k] for k in at.tolist()]), filtered.innovations)


def graph_smoother(task: Task, settings: EstimatorSettings, progress: Progress) -> Estimate:
    """The factor graph of the whole dive."""
    dive = task.prepared.dive
    solution = smooth(dive, task.settings, progress, more=task.more)
    return Estimate(resample(dive, solution, task.t_ns))


def _filtered(task: Task, kalman: Kalman, settings: EstimatorSettings, progress: Progress, adaptive: bool) -> Estimate:
    policy = Policy(settings.filter.gate, settings.filter.adaptation if adaptive else None)
    filtered = filter_dive(task, kalman, policy, settings.filter, lambda share: progress("filtering", share))
    return Estimate(solution_of(task.prepared, filtered.beliefs), filtered.innovations)


ESTIMATORS: Final[Mapping[str, Named]] = {
    "dr": Named("dead reckoning", True, dead_reckoning),
    "eskf": Named("error-state Kalman filter", True, error_state),
    "aeskf": Named("adaptive error-state Kalman filter", True, partial(error_state, adaptive=True)),
    "rts": Named("Kalman filter with a Rauch-Tung-Striebel pass", False, rauch_tung_striebel),
    "ukf": Named("unscented Kalman filter", True, unscented),
    "aukf": Named("adaptive unscented Kalman filter", True, partial(unscented, adaptive=True)),
    "kinematic": Named("adaptive unscented filter of the kinematic model", True, kinematic),
    "smooth": Named("graph smoother", False, graph_smoother),
}
"""By their names on the command line."""
