"""Graduated non-convexity on a small pose graph with closures that lie."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from graph_dives import SHORT, Truth

from uwgraph.graph import SmoothSettings
from uwgraph.graph.builder import Problem
from uwgraph.graph.gnc import graduate, poses_of, squared_residuals, truncated_weight
from uwgraph.graph.relative import BetweenKeyframes
from uwgraph.graph.se3 import Poses
from uwgraph.graph.solver import Solved, solve

SETTINGS = SmoothSettings()


def silent(problem: Problem) -> Solved:
    return solve(problem, SETTINGS, lambda done: None)


@pytest.fixture(scope="module")
def solved() -> tuple[Problem, gtsam.Values]:
    problem = Truth.of(SHORT).problem(SETTINGS)
    return problem, silent(problem).values


def closures(values: gtsam.Values, count: int, sigma: float, lies: dict[int, float]) -> BetweenKeyframes:
    """Between keyframes n and n + 25, with noise, and some shifted sideways by so many metres."""
    rng = np.random.default_rng(2)
    i = np.arange(count)
    between = BetweenKeyframes(
        i, i + 25, Poses(np.zeros((count, 3, 3)), np.zeros((count, 3))),
        np.tile(np.diag(np.repeat([1e-6, sigma**2], 3)), (count, 1, 1)), i,
    )  # fmt: skip
    T = poses_of(values, between.i).to(poses_of(values, between.j))
    p = T.p + sigma * rng.normal(size=(count, 3))
    for n, shift in lies.items():
        p[n] += shift * np.array([0.6, 0.8, 0.0])
    return BetweenKeyframes(between.i, between.j, Poses(T.R, p), between.cov, i)


def test_true_ones_are_all_kept_after_one_solution(solved: tuple[Problem, gtsam.Values]) -> None:
    problem, values = solved
    solutions: list[Solved] = []

    def counted(weighted: Problem) -> Solved:
        solutions.append(silent(weighted))
        return solutions[-1]

    found = graduate(problem, values, closures(values, 20, 0.05, {}), 0.999, counted)
    assert len(solutions) == 1
    assert found.weight.tolist() == [1.0] * 20
    assert found.problem.counts["closures"] == 20


@pytest.mark.parametrize("lies", [{7: 0.6}, {3: 3.0, 4: 3.0, 5: 3.0, 11: -8.0}])
def test_those_that_lie_are_left_out(solved: tuple[Problem, gtsam.Values], lies: dict[int, float]) -> None:
    problem, values = solved
    told = closures(values, 20, 0.05, lies)
    found = graduate(problem, values, told, 0.999, silent)
    assert set(np.flatnonzero(found.weight == 0.0).tolist()) == set(lies)
    assert set(found.weight.tolist()) == {0.0, 1.0}
    assert found.problem.counts["closures"] == 20 - len(lies)
    alone = graduate(problem, values, told.select(np.setdiff1d(np.arange(20), list(lies))), 0.999, silent)
    np.testing.assert_allclose(found.solved.values.atPose3(gtsam.symbol("x", 30)).translation(),
                               alone.solved.values.atPose3(gtsam.symbol("x", 30)).translation(), atol=1e-4)  # fmt: skip
    d2 = squared_residuals(found.solved.values, told)
    assert (d2[list(lies)] > 22.46).all()
    assert np.delete(d2, list(lies)).max() < 22.46
    assert found.problem.graph.size() == problem.graph.size() + 20 - len(lies)


def test_weights_go_from_one_to_zero_between_the_bounds() -> None:
    misfit = np.linspace(0.0, 4.0, 4001)
    for mu in (0.01, 0.5, 3.0, 1e4):
        weight = truncated_weight(misfit, mu)
        assert (np.diff(weight) <= 1e-12).all()
        assert (weight[misfit <= mu / (mu + 1.0)] == 1.0).all()
        assert (weight[misfit >= (mu + 1.0) / mu] == 0.0).all()
        bounds = np.array([mu / (mu + 1.0) * (1.0 + 1e-9), (mu + 1.0) / mu * (1.0 - 1e-9)])
        np.testing.assert_allclose(truncated_weight(bounds, mu), [1.0, 0.0], atol=1e-4)
