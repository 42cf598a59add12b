"""The own loop against GTSAM's optimisers, and its promises about when it stops."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from graph_dives import SHORT, Truth
from gtsam.symbol_shorthand import X

from uwgraph.errors import SolveError
from uwgraph.graph import SmoothSettings, solver
from uwgraph.graph.builder import Problem
from uwgraph.graph.solver import Solved, solve

NATIVE = SmoothSettings(dvl_calibration=False, tolerance=1e-12)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth.of(SHORT, seed=3)


def quietly(problem: Problem, settings: SmoothSettings) -> Solved:
    return solve(problem, settings, lambda done: None)


def poses(values: gtsam.Values, count: int) -> np.ndarray:
    return np.array([values.atPose3(X(k)).matrix() for k in range(count)])


def gauss_newton(problem: Problem) -> gtsam.Values:
    params = gtsam.GaussNewtonParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")
    params.setRelativeErrorTol(0.0)
    params.setAbsoluteErrorTol(0.0)
    params.setMaxIterations(15)
    return gtsam.GaussNewtonOptimizer(problem.graph, problem.values, params).optimize()


def levenberg_marquardt(problem: Problem) -> gtsam.Values:
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")
    params.setRelativeErrorTol(0.0)
    params.setAbsoluteErrorTol(0.0)
    params.setMaxIterations(30)
    return gtsam.LevenbergMarquardtOptimizer(problem.graph, problem.values, params).optimize()


@pytest.mark.parametrize("optimise", [gauss_newton, levenberg_marquardt])
@pytest.mark.parametrize("loss", ["none", "huber"])
def test_ends_where_gtsam_ends(truth: Truth, optimise: object, loss: str) -> None:
    settings = NATIVE.model_copy(update={"loss": loss})
    problem = truth.problem(settings)
    assert not problem.bulk
    ours, theirs = quietly(problem, settings), optimise(problem)  # type: ignore[operator]
    assert ours.converged
    assert problem.graph.error(ours.values) == pytest.approx(problem.graph.error(theirs), rel=1e-9)
    count = len(problem.keyframes)
    np.testing.assert_allclose(poses(ours.values, count), poses(theirs, count), atol=1e-6)


@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize("look_ahead", [0, 3])
def test_a_bad_first_guess_comes_home(
    truth: Truth, calibrated: bool, look_ahead: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(solver, "LOOK_AHEAD", look_ahead)
    settings = NATIVE.model_copy(update={"dvl_calibration": calibrated, "max_iterations": 100})
    good = truth.problem(settings)
    rng = np.random.default_rng(1)
    lost = gtsam.Values(good.values)
    for k in range(len(good.keyframes)):
        away = np.concatenate([rng.normal(size=3) * 0.5, rng.normal(size=3) * 20.0])
        lost.update(X(k), good.values.atPose3(X(k)).retract(away))
    home, back = quietly(good, settings), quietly(replace(good, values=lost), settings)
    assert home.converged
    assert back.converged, back.why
    if not look_ahead:
        assert any(i.damping > 0.0 for i in back.trace)
    assert back.trace[-1].error == pytest.approx(home.trace[-1].error, rel=1e-6)
    count = len(good.keyframes)
    np.testing.assert_allclose(poses(back.values, count), poses(home.values, count), atol=1e-3)


def test_a_way_that_turns_as_a_whole_does_not_crawl() -> None:
    """A first guess turned by 17 degrees: the first step stretches the way, and that is no reason to damp."""
    settings = SmoothSettings()
    truth = Truth.of(SHORT.model_copy(update={"duration_s": 200.0, "leg_length_m": 100.0}), seed=3)
    good, turned = (quietly(truth.problem(settings, yaw), settings) for yaw in (0.0, 0.3))
    assert turned.converged
    assert len(turned.trace) <= 7
    assert turned.trace[-1].error == pytest.approx(good.trace[-1].error, rel=1e-3)


def test_the_trace_never_rises_and_counts_its_steps(truth: Truth) -> None:
    problem = truth.problem(NATIVE, yaw=0.7)
    trace = quietly(problem, NATIVE).trace
    errors = np.array([i.error for i in trace])
    assert (np.diff(errors) <= 1e-9 + 1e-12 * errors[:-1]).all()
    assert [i.number for i in trace] == list(range(len(trace)))
    assert errors[0] == problem.error(problem.values)
    assert (np.diff([i.seconds for i in trace]) >= 0.0).all()


def test_the_problem_is_left_as_it_was(truth: Truth) -> None:
    problem = truth.problem(NATIVE, yaw=0.1)
    before, size = poses(problem.values, len(problem.keyframes)), problem.graph.size()
    quietly(problem, NATIVE)
    np.testing.assert_array_equal(poses(problem.values, len(problem.keyframes)), before)
    assert problem.graph.size() == size


def test_too_few_iterations_are_said(truth: Truth) -> None:
    settings = NATIVE.model_copy(update={"max_iterations": 1})
    solved = quietly(truth.problem(settings, yaw=0.7), settings)
    assert not solved.converged
    assert solved.why == "1 iterations were not enough"
    assert len(solved.trace) == 2


def test_the_time_limit_is_kept(truth: Truth) -> None:
    settings = NATIVE.model_copy(update={"time_limit_s": 1e-6})
    solved = quietly(truth.problem(settings, yaw=0.7), settings)
    assert not solved.converged
    assert "time limit of 1e-06 s" in solved.why
    assert solved.trace[-1].error < solved.trace[0].error


def test_progress_is_told_from_zero_to_one(truth: Truth) -> None:
    told: list[float] = []
    solved = solve(truth.problem(NATIVE), NATIVE, told.append)
    assert len(told) == len(solved.trace) - 1
    assert np.all(np.diff([0.0, *told]) > 0.0)
    assert told[-1] <= 1.0


def test_a_first_guess_that_is_not_finite_is_refused(truth: Truth) -> None:
    problem = truth.problem(NATIVE)
    problem.values.update(X(3), gtsam.Pose3(gtsam.Rot3(), np.full(3, np.nan)))
    with pytest.raises(SolveError, match="not finite"):
        quietly(problem, NATIVE)


def test_a_graph_without_a_unique_solution_is_refused() -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(2):
        values.insert(X(k), gtsam.Pose3())
    graph.push_back(gtsam.BetweenFactorPose3(X(0), X(1), gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6)))
    with pytest.raises(SolveError, match="unique"):
        quietly(Problem(np.array([0, 1]), graph, (), values, {}), SmoothSettings())
