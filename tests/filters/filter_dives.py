"""Short simulated dives, and what an estimator makes of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from uwgraph.dive import Dive
from uwgraph.evaluate import judge
from uwgraph.evaluate.judge import judging_stamps
from uwgraph.filters import ESTIMATORS, EstimatorSettings, FilterSettings, task_of
from uwgraph.filters.estimate import Task
from uwgraph.graph import SmoothSettings
from uwgraph.simulate import DepthModel, DvlModel, SimulationSettings, SunModel
from uwgraph.types import Innovations, Solution

FAST = FilterSettings(samples_per_step=8)
MISSION = SimulationSettings(
    duration_s=100.0,
    leg_length_m=25.0,
    line_spacing_m=15.0,
    depth=8.0,
    surface_time_s=10.0,
    imu_rate_hz=50.0,
    truth_rate_hz=2.0,
    dvl=DvlModel(rate_hz=2.0),
    depth_sensor=DepthModel(rate_hz=1.0),
    sun=SunModel(rate_hz=1.0),
)


@dataclass(frozen=True, eq=False)
class Run:
    """An estimate, judged."""

    solution: Solution
    innovations: Innovations | None
    metrics: dict[str, Any]

    def __getitem__(self, name: str) -> float:
        return float(self.metrics[name])


def task_for(dive: Dive, smooth: SmoothSettings | None = None, more: Any = ()) -> Task:
    """At the reference's samples near the keyframes, as in a contest."""
    task = task_of(dive, smooth, more=more)
    assert dive.reference is not None
    return replace(task, t_ns=judging_stamps(task.t_ns, dive.reference.t_ns))


def run(
    name: str,
    dive: Dive,
    settings: FilterSettings = FAST,
    smooth: SmoothSettings | None = None,
    more: Any = (),
) -> Run:
    chosen = EstimatorSettings(smooth=smooth or SmoothSettings(), filter=settings)
    estimate = ESTIMATORS[name].run(task_for(dive, smooth, more), chosen, lambda what, share: None)
    return Run(estimate.solution, estimate.innovations, judge(dive, estimate.solution).metrics)


def until(task: Task, seconds: float) -> Task:
    """The task of the times up to one."""
    return replace(task, t_ns=task.t_ns[task.t_ns <= task.t_ns[0] + round(seconds * 1e9)])
