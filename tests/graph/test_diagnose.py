"""Freedoms planted into graphs are found and named; a graph that only Cholesky stumbles over is called healthy."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from graph_dives import SHORT, START_NS, Truth
from gtsam.symbol_shorthand import V, X

from uwgraph.graph import SmoothSettings
from uwgraph.graph.builder import DVL_CALIBRATION, Problem
from uwgraph.graph.diagnose import diagnose
from uwgraph.time import isoformat

COUNT = 5
SETTINGS = SmoothSettings(dvl_calibration=False)


def poses(*aids: gtsam.NonlinearFactor, rotation: bool = True) -> Problem:
    """A level chain of poses one metre apart, a second each; ``rotation``: whether anything ties their attitudes."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    step = gtsam.Pose3(gtsam.Rot3(), [1.0, 0.0, 0.0])
    between = gtsam.noiseModel.Diagonal.Precisions(np.array([*[1e4 * rotation] * 3, 1e2, 1e2, 1e2]))
    for k in range(COUNT):
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3(), [float(k), 0.0, 0.0]))
        if k:
            graph.push_back(gtsam.BetweenFactorPose3(X(k - 1), X(k), step, between))
    for aid in aids:
        graph.push_back(aid)
    return Problem(START_NS + np.arange(COUNT) * 10**9, graph, (), values, {})


def pose_prior(precisions: list[float]) -> gtsam.NonlinearFactor:
    return gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), gtsam.noiseModel.Diagonal.Precisions(np.array(precisions)))


LEVEL = pose_prior([1e4, 1e4, 0.0, 0.0, 0.0, 0.0])
POINTED = pose_prior([1e4, 1e4, 1e4, 0.0, 0.0, 0.0])
PLACED = gtsam.GPSFactor(X(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
PLACED_LAST = gtsam.GPSFactor(X(COUNT - 1), [COUNT - 1.0, 0.0, 0.0], gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
AT_DEPTH = gtsam.GPSFactor(X(0), np.zeros(3), gtsam.noiseModel.Diagonal.Precisions(np.array([0.0, 0.0, 1e2])))


@pytest.mark.parametrize(
    ("aids", "directions"),
    [
        ((POINTED,), {"x", "y", "z"}),
        ((POINTED, AT_DEPTH), {"x", "y"}),
        ((LEVEL, PLACED_LAST), {"rotation about body z"}),
        ((LEVEL, PLACED), {"y"}),  # seen from the last pose: the chain swings about the first one
    ],
    ids=["no position", "no horizontal position", "no heading", "no heading, far from the fix"],
)
def test_what_nothing_measures_is_named(aids: tuple[gtsam.NonlinearFactor, ...], directions: set[str]) -> None:
    found = diagnose(poses(*aids))
    assert not found.false_alarm
    assert {f.direction for f in found.freedoms} == directions
    assert len(found.freedoms) == len(directions)
    assert found.condition < 1e-12
    first = found.freedoms[0]
    k = int(first.variable.removeprefix("pose "))
    assert first.time == isoformat(START_NS + k * 10**9)
    assert found.where == f"pose {k} at {first.time}"
    assert first.direction in found.remedy
    assert "BetweenFactorPose3" in first.factors
    assert "BetweenFactorPose3" in found.remedy


def test_every_attitude_that_nothing_holds_is_named() -> None:
    """The way fixes two of three rotations of each pose but the last, which is free to turn at will."""
    found = diagnose(poses(PLACED, POINTED, rotation=False))
    last = {f.direction for f in found.freedoms if f.variable == f"pose {COUNT - 1}"}
    assert {"rotation about body x", "rotation about body y", "rotation about body z"} <= last


def test_a_held_graph_is_healthy() -> None:
    found = diagnose(poses(POINTED, PLACED))
    assert found.false_alarm
    assert found.freedoms == ()
    assert found.condition > 1e-3
    assert found.where == "the graph"
    assert "uwgraph check" in found.remedy


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth.of(SHORT)


def without(problem: Problem, *kinds: type) -> Problem:
    graph = gtsam.NonlinearFactorGraph()
    for i in range(problem.graph.size()):
        if not isinstance(problem.graph.at(i), kinds):
            graph.push_back(problem.graph.at(i))
    return replace(problem, graph=graph)


def test_a_dive_without_its_first_pose_is_a_thousand_times_weaker(truth: Truth) -> None:
    """Not quite free: over the curved Earth depths tell the place to some 1000 km."""
    problem = replace(truth, dive=replace(truth.dive, fixes=None)).problem(SETTINGS)
    held, loose = diagnose(problem), diagnose(without(problem, gtsam.PriorFactorPose3))
    assert not held.freedoms
    assert loose.condition < 1e-3 * held.condition


def test_a_calibration_that_nothing_measures_is_named(truth: Truth) -> None:
    """The prior holds all but one component, and no ping got through."""
    problem = truth.problem(SmoothSettings())
    precisions = np.array([1e4, 0.0, 1e4, 1e4])
    prior = gtsam.PriorFactorVector(DVL_CALIBRATION, np.zeros(4), gtsam.noiseModel.Diagonal.Precisions(precisions))
    bare = without(problem, gtsam.PriorFactorVector)
    bare.graph.push_back(prior)
    bare.graph.push_back(gtsam.PriorFactorVector(V(0), np.zeros(3), gtsam.noiseModel.Unit.Create(3)))
    (freedom,) = diagnose(replace(bare, bulk=())).freedoms
    assert (freedom.variable, freedom.time) == ("DVL calibration", "all times")
    assert freedom.direction == "DVL misalignment x"
    assert freedom.factors == ("PriorFactorVector",)


def test_tight_bias_walks_are_a_false_alarm() -> None:
    """Cholesky gives up on a graph that QR solves to twelve digits."""
    settings = SHORT.model_copy(update={"grade": "fog"})
    truth = Truth.of(settings)
    tight = truth.dive.rig.imu.model_copy(update={"gyro_bias_walk": 1e-12, "accel_bias_walk": 1e-11})
    dive = replace(truth.dive, rig=truth.dive.rig.model_copy(update={"imu": tight}))
    problem = replace(truth, dive=dive).problem(SETTINGS)
    linear = problem.linearize(problem.values)
    with pytest.raises(RuntimeError, match="Indeterminate linear system"):
        linear.optimize(problem.ordering(linear))
    found = diagnose(problem)
    assert found.false_alarm
    assert found.freedoms == ()
