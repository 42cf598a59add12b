"""A sensor that nobody foresaw: a residual and a noise, for the smoother and for every filter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest

import factors
from uwgraph.dive import Dive
from uwgraph.errors import ConfigError
from uwgraph.evaluate import judge
from uwgraph.evaluate.reference import reference_at
from uwgraph.filters import ESTIMATORS, EstimatorSettings, FilterSettings, task_of
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.graph.observed import Observed, Role
from uwgraph.simulate import DepthModel, DvlModel, SimulationSettings, SunModel, simulate
from uwgraph.types import FloatArray

MISSION = SimulationSettings(
    duration_s=120.0,
    leg_length_m=30.0,
    line_spacing_m=15.0,
    depth=8.0,
    surface_time_s=5.0,
    imu_rate_hz=50.0,
    dvl=DvlModel(rate_hz=2.0),
    depth_sensor=DepthModel(rate_hz=1.0),
    sun=SunModel(rate_hz=1.0),
)
BEACONS = np.array([[40.0, 0.0, 30.0], [-10.0, 40.0, 25.0]])
SIGMA = 0.1


@dataclass(frozen=True, eq=False)
class Range(factors.Measurement):
    """Distance to a beacon at a known place."""

    variables = ("Pose3",)
    beacon_n: FloatArray
    distance: float

    def residual(self, pose: gtsam.Pose3) -> FloatArray:
        return np.array([np.linalg.norm(pose.translation() - self.beacon_n) - self.distance])

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Isotropic.Sigma(1, SIGMA)


@dataclass(frozen=True, eq=False)
class Current(factors.Measurement):
    """Speed over ground along a direction of n: a model of a variable that is no pose."""

    variables = ("Vector",)
    along_n: FloatArray
    speed: float

    def residual(self, v_n: FloatArray) -> FloatArray:
        return np.array([self.along_n @ v_n - self.speed])

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Isotropic.Sigma(1, 0.02)


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate(MISSION, 2)


@pytest.fixture(scope="module")
def ranges(dive: Dive) -> list[Observed]:
    """To two beacons in turn, every 3 s and a little, at moments at which nothing else is measured."""
    assert dive.reference is not None
    t_ns = dive.reference.t_ns[0] + 1_234_567 + np.arange(5, 118, 3, dtype=np.int64) * 1_000_000_000
    p_n, rng = reference_at(dive.reference, dive.origin, t_ns).p_n, np.random.default_rng(0)
    place = BEACONS[np.arange(len(t_ns)) % 2]
    distance = np.linalg.norm(p_n - place, axis=1) + SIGMA * rng.normal(size=len(t_ns))
    return [Observed(t, "range", Range(b, float(d))) for t, b, d in zip(t_ns.tolist(), place, distance, strict=True)]


def test_each_gets_a_keyframe_of_its_own_and_lowers_the_error(dive: Dive, ranges: list[Observed]) -> None:
    plain, aided = smooth(dive), smooth(dive, more=ranges)
    moments = [o.t_ns for o in ranges]
    assert not np.isin(moments, plain.t_ns).any()
    assert np.isin(moments, aided.t_ns).all()
    assert len(aided) == len(plain) + len(ranges)
    assert aided.info["factors"]["range"] == len(ranges)
    before, after = judge(dive, plain).metrics, judge(dive, aided).metrics
    assert after["horizontal_rmse_m"] < 0.5 * before["horizontal_rmse_m"]
    assert after["horizontal_rmse_m"] < 0.15
    assert after["sigma"]["north_m"]["median"] < 0.5 * before["sigma"]["north_m"]["median"]
    assert 0.1 < after["nees_position"] < 4.0


@pytest.mark.parametrize("name", ["eskf", "ukf", "aukf", "rts"])
def test_filters_take_the_same_measurements(dive: Dive, ranges: list[Observed], name: str) -> None:
    settings, figures = EstimatorSettings(filter=FilterSettings(samples_per_step=8)), []
    for more in ((), ranges):
        task = task_of(dive, more=more)
        both_spoke = task.t_ns > task.t_ns[0] + 10 * 10**9
        estimate = ESTIMATORS[name].run(replace(task, t_ns=task.t_ns[both_spoke]), settings, lambda what, share: None)
        figures.append(judge(dive, estimate.solution).metrics)
    assert figures[1]["horizontal_rmse_m"] < 0.5 * figures[0]["horizontal_rmse_m"]
    assert figures[1]["nees_position"] < 4.0
    assert estimate.innovations is not None
    seen = estimate.innovations.select(estimate.innovations.kind == "range")
    assert len(seen) == len(ranges)
    assert seen.nis.mean() == pytest.approx(1.0, abs=0.6)


def test_the_contests_smoother_takes_them_too(dive: Dive, ranges: list[Observed]) -> None:
    task = task_of(dive, more=ranges)
    estimate = ESTIMATORS["smooth"].run(task, EstimatorSettings(), lambda what, share: None)
    assert judge(dive, estimate.solution).metrics["horizontal_rmse_m"] < 0.15


def test_other_parts_of_the_state(dive: Dive) -> None:
    """Velocity along north without a DVL: known where it is measured, and in the filter as well as in the graph."""
    blind = replace(dive, dvl=None)
    assert dive.reference is not None
    at = dive.reference.select(slice(20, None, 10))
    assert at.v_n is not None
    north = np.array([1.0, 0.0, 0.0])
    more = [
        Observed(t, "log", Current(north, float(v[0])), ("velocity",))
        for t, v in zip(at.t_ns.tolist(), at.v_n, strict=True)
    ]
    start = SmoothSettings(initial="reference")
    graph = smooth(blind, start, more=more)
    chosen = EstimatorSettings(smooth=start, filter=FilterSettings(samples_per_step=8))
    filtered = ESTIMATORS["ukf"].run(task_of(blind, start, more=more), chosen, lambda what, share: None).solution
    for solution in (graph, filtered):
        sigma = np.sqrt(np.median(np.diagonal(solution.cov_v, axis1=1, axis2=2), axis=0))
        assert sigma[0] < 0.1
        assert sigma[0] < 0.5 * sigma[1]


def test_what_lies_outside_the_dive_is_left_out(dive: Dive, ranges: list[Observed]) -> None:
    early, late = replace(ranges[0], t_ns=ranges[0].t_ns - 10**12), replace(ranges[0], t_ns=ranges[-1].t_ns + 10**12)
    plain, asked = smooth(dive), smooth(dive, more=[early, late])
    np.testing.assert_array_equal(asked.t_ns, plain.t_ns)
    np.testing.assert_array_equal(asked.p_n, plain.p_n)
    assert "range" not in asked.info["factors"]


def test_a_wild_one_is_outvoted(dive: Dive, ranges: list[Observed]) -> None:
    """The robust loss holds for one's own sensors as well, and the gate of a filter."""
    model = ranges[10].model
    assert isinstance(model, Range)
    wild = [*ranges[:10], replace(ranges[10], model=Range(model.beacon_n, model.distance + 50.0)), *ranges[11:]]
    assert judge(dive, smooth(dive, more=wild)).metrics["horizontal_rmse_m"] < 0.3
    settings = EstimatorSettings(filter=FilterSettings(samples_per_step=8))
    estimate = ESTIMATORS["ukf"].run(task_of(dive, more=wild), settings, lambda what, share: None)
    assert estimate.innovations is not None
    seen = estimate.innovations.select(estimate.innovations.kind == "range")
    np.testing.assert_array_equal(np.flatnonzero(~seen.accepted), [10])


@pytest.mark.parametrize("role", ["node", "dvl"])
def test_a_part_of_the_state_that_the_graph_does_not_have_is_named(role: Role) -> None:
    dive = simulate(MISSION)
    assert dive.imu is not None
    strange = Observed(int(dive.imu.t_ns[3000]), "strange", Current(np.array([1.0, 0.0, 0.0]), 1.0), (role,))
    with pytest.raises(ConfigError, match=role):
        smooth(dive, SmoothSettings(dvl_calibration=False), more=[strange])
