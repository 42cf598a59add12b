from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uwgraph.dive import Dive
from uwgraph.dive.body_reference import body_reference
from uwgraph.evaluate import judge, metrics
from uwgraph.evaluate.judge import judging_stamps
from uwgraph.frames import matrix_from_rph
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import SimulationSettings, simulate
from uwgraph.types import Reference, Solution


@pytest.fixture(scope="module")
def dive() -> Dive:
    """Legs of 20 m, so that it turns, and a truth at 10 Hz."""
    return simulate(SimulationSettings(duration_s=180.0, grade="fog", leg_length_m=20.0, line_spacing_m=20.0), seed=2)


@pytest.fixture(scope="module")
def solution(dive: Dive) -> Solution:
    return smooth(dive, SmoothSettings(initial="reference"))


def between_keyframes(dive: Dive) -> Dive:
    """The same truth at 0.5 Hz, half way between two keyframes."""
    assert dive.reference is not None
    return replace(dive, reference=dive.reference.select(slice(5, None, 20)))


def test_a_coarse_reference_gives_the_errors_of_a_fine_one(dive: Dive, solution: Solution) -> None:
    fine = judge(dive, solution).metrics
    coarse = judge(between_keyframes(dive), solution).metrics
    interpolated = metrics(solution, body_reference(between_keyframes(dive)))
    for figure in ("heading_rmse_deg", "horizontal_rmse_m"):
        assert coarse[figure] == pytest.approx(fine[figure], rel=0.3), figure
    assert interpolated["heading_rmse_deg"] > 5.0 * fine["heading_rmse_deg"]


def test_a_planted_turn_is_not_hidden(dive: Dive, solution: Solution) -> None:
    R = matrix_from_rph(np.radians([0.0, 0.0, 0.7]))
    m = judge(between_keyframes(dive), replace(solution, R_nb=R @ solution.R_nb)).metrics
    assert m["heading_rmse_deg"] == pytest.approx(0.7, abs=0.1)


def test_a_wrong_reference_is_not_hidden(dive: Dive, solution: Solution) -> None:
    """The judged solution takes its stamps from the reference and nothing else."""
    coarse = between_keyframes(dive)
    assert coarse.reference is not None
    wrong: Reference = replace(coarse.reference, rph=coarse.reference.rph + np.radians([0.0, 0.0, 20.0]))
    m = judge(replace(coarse, reference=wrong), solution).metrics
    assert m["heading_rmse_deg"] == pytest.approx(20.0, abs=0.5)


def test_without_a_reference_the_sigmas_are_told(dive: Dive, solution: Solution) -> None:
    judged = judge(replace(dive, reference=None), solution)
    assert judged.reference is None
    assert judged.solution is solution
    assert "horizontal_rmse_m" not in judged.metrics
    assert judged.metrics["sigma"]["heading_deg"]["final"] > 0.0


def test_stamps_stay_inside_and_come_once() -> None:
    keyframes = np.arange(0, 100, 10)
    stamps = judging_stamps(keyframes, np.arange(-25, 70, 20))
    assert stamps.tolist() == [15, 35, 55, 80, 90]
    assert (np.diff(judging_stamps(keyframes, np.arange(3, 95))) > 0).all()
    assert judging_stamps(keyframes, np.array([50])).tolist() == keyframes.tolist()
