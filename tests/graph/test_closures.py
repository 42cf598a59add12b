"""Smoothing with places seen again: believed where they agree, and never on a word alone."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from graph_dives import Truth
from scipy.spatial.transform import Rotation

from uwgraph.dive import Dive
from uwgraph.dive.importing import read_recording
from uwgraph.dive.rig import VisualRig
from uwgraph.evaluate import judge
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.graph.smooth import solve_dive
from uwgraph.simulate import ClosureModel, OdometryModel, SimulationSettings, add_closures, add_odometry
from uwgraph.simulate.closures import TRUE
from uwgraph.types import NOT_MEASURED, FloatArray, RelativePoses, Solution

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
PATROL = SimulationSettings(
    pattern="patrol", duration_s=400.0, leg_length_m=40.0, line_spacing_m=20.0, depth=2.0, surface_time_s=5.0, sun=None
)
SETTINGS = SmoothSettings(initial="reference")
QUICK = SETTINGS.model_copy(update={"covariances": False})


@pytest.fixture(scope="module")
def truth() -> Truth:
    """Seven minutes without sun or compass: the heading drifts."""
    return Truth.of(PATROL, seed=4)


@pytest.fixture(scope="module")
def open_loops(truth: Truth) -> Solution:
    return smooth(truth.dive, SETTINGS)


@pytest.fixture(scope="module")
def closures(truth: Truth) -> RelativePoses:
    found = add_closures(truth.dive, ClosureModel(period_s=5.0, sigma=0.05), seed=1).closures
    assert found is not None
    return found


def real(name: str) -> Dive:
    if not (DATA / name).is_dir():
        pytest.skip(f"no {DATA / name}: set UWGRAPH_DATA to the folder of the recordings")
    return read_recording(DATA / name).dive


def rmse(truth: Truth, solution: Solution) -> float:
    error = solution.p_n - truth.p_n(solution.t_ns)
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def with_closures(dive: Dive, closures: RelativePoses) -> Dive:
    return replace(dive, closures=closures)


def shifted(closures: RelativePoses, rows: list[int], by: FloatArray) -> RelativePoses:
    p = closures.p.copy()
    p[rows] += by
    return replace(closures, p=p)


def test_false_ones_are_found_and_the_position_is_better(truth: Truth, open_loops: Solution) -> None:
    dive = add_closures(truth.dive, ClosureModel(period_s=5.0, sigma=0.05, false_share=0.3), seed=2)
    assert dive.closures is not None
    solution = smooth(dive, SETTINGS)
    verdicts = solution.closures
    assert verdicts is not None
    true = dive.closures.reason == TRUE
    assert not verdicts.accepted[~true].any()
    assert verdicts.accepted[true].mean() > 0.9
    np.testing.assert_array_equal(verdicts.accepted, verdicts.weight == 1.0)
    assert rmse(truth, solution) < 0.4 * rmse(truth, open_loops)
    assert 0.2 < judge(dive, solution).metrics["nees_position"] < 3.0
    assert solution.info["factors"]["closures"] == verdicts.accepted.sum()
    assert sum(solution.info["closures"].values()) == len(dive.closures)
    assert all("contradicts" in why or "does not fit" in why or "speak" in why for why in verdicts.reason[~true])
    assert (verdicts.chi2[~true] > 22.0).all()


def test_not_asked_for_they_change_nothing(truth: Truth, open_loops: Solution, closures: RelativePoses) -> None:
    off = SETTINGS.model_copy(update={"closures": False, "odometry": False})
    solution = smooth(with_closures(add_odometry(truth.dive), closures), off)
    np.testing.assert_array_equal(solution.p_n, open_loops.p_n)
    assert solution.closures is None


def test_every_factor_stays_native(truth: Truth, closures: RelativePoses) -> None:
    smoothed = solve_dive(with_closures(add_odometry(truth.dive), closures), QUICK, lambda stage, done: None)
    graph = smoothed.problem.graph
    kinds = {type(graph.at(n)) for n in range(graph.size())}
    assert gtsam.BetweenFactorPose3 in kinds
    assert gtsam.CustomFactor not in kinds
    assert {"odometry", "closures"} <= set(smoothed.problem.counts)


def test_a_lone_closure_must_agree_with_the_odometry(truth: Truth, closures: RelativePoses) -> None:
    lone = closures.select([len(closures) - 1])
    good = smooth(with_closures(truth.dive, lone), QUICK).closures
    bad = smooth(with_closures(truth.dive, shifted(lone, [0], np.array([0.0, 25.0, 0.0]))), QUICK).closures
    assert good is not None
    assert bad is not None
    assert good.accepted.tolist() == [True]
    assert "no other closure" in good.reason[0]
    assert bad.accepted.tolist() == [False]
    assert "without closures" in bad.reason[0]
    assert bad.chi2_odometry[0] > 100.0


def test_two_that_contradict_each_other_are_both_left_out(truth: Truth, closures: RelativePoses) -> None:
    """Both within what the odometry leaves open: nothing tells which one lies."""
    last = len(closures) - 1
    pair = shifted(closures.select([last, last]), [1], np.array([0.0, 0.45, 0.0]))
    verdicts = smooth(with_closures(truth.dive, pair), QUICK).closures
    assert verdicts is not None
    assert (verdicts.chi2_odometry < 20.0).all()
    assert not verdicts.accepted.any()
    assert any("as many" in why for why in verdicts.reason)


def test_what_cannot_be_judged_is_said(truth: Truth, closures: RelativePoses) -> None:
    few = closures.select(slice(0, 12))
    accepted = few.accepted.copy()
    accepted[3] = False
    reason = np.array([*few.reason[:3], "too few matches", *few.reason[4:]])
    from_ns, t_ns = few.from_ns.copy(), few.t_ns.copy()
    from_ns[0] -= 10**12
    t_ns[-1] += 10**12
    odd = replace(few, accepted=accepted, reason=reason, from_ns=from_ns, t_ns=t_ns)
    verdicts = smooth(with_closures(truth.dive, odd), QUICK.model_copy(update={"max_closures": 5})).closures
    assert verdicts is not None
    assert "keyframes" in verdicts.reason[0]
    assert "keyframes" in verdicts.reason[-1]
    assert verdicts.reason[3] == "its geometry was not verified: too few matches"
    assert verdicts.accepted.sum() == 5
    assert sum("evenly spaced" in why for why in verdicts.reason) == 4
    np.testing.assert_array_equal(verdicts.from_ns, odd.from_ns)


def test_none_left_is_the_solution_without(truth: Truth, open_loops: Solution, closures: RelativePoses) -> None:
    wrong = shifted(closures, list(range(len(closures))), np.array([0.0, 30.0, 0.0]))
    solution = smooth(with_closures(truth.dive, wrong), SETTINGS)
    assert solution.closures is not None
    assert not solution.closures.accepted.any()
    np.testing.assert_array_equal(solution.p_n, open_loops.p_n)


def test_closures_without_scale_help_all_the_same(truth: Truth, open_loops: Solution, closures: RelativePoses) -> None:
    """A camera that knows the direction but not the distance: 100 times the noise along it changes nothing."""
    direction = np.einsum("nji,nj->ni", Rotation.from_rotvec(closures.rotvec).as_matrix(), closures.p)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    cov = closures.cov.copy()
    cov[:, 3:, 3:] += NOT_MEASURED * np.einsum("ni,nj->nij", direction, direction)
    p = closures.p * np.linspace(0.5, 1.5, len(closures))[:, None]
    solution = smooth(with_closures(truth.dive, replace(closures, p=p, cov=cov)), SETTINGS)
    assert solution.closures is not None
    assert solution.closures.accepted.mean() > 0.9
    assert solution.info["converged"]
    assert rmse(truth, solution) < 0.6 * rmse(truth, open_loops)


def test_the_camera_clock_counts(truth: Truth, closures: RelativePoses) -> None:
    late = replace(closures, t_ns=closures.t_ns + 10**9, from_ns=closures.from_ns + 10**9)
    rig = truth.dive.rig.model_copy(update={"visual": VisualRig(time_offset_s=-1.0)})
    shifted_clock = smooth(replace(truth.dive, rig=rig, closures=late), QUICK)
    right = smooth(with_closures(truth.dive, closures), QUICK)
    np.testing.assert_allclose(shifted_clock.p_n, right.p_n, atol=1e-9)


def test_visual_odometry_stands_in_for_a_dvl(truth: Truth) -> None:
    dive = replace(add_odometry(truth.dive, OdometryModel(period_s=0.25)), dvl=None)
    solution = smooth(dive, SETTINGS)
    assert solution.info["factors"]["odometry"] > 0.9 * len(solution)
    assert judge(dive, solution).metrics["horizontal_rmse_m"] < 2.0
    assert 0.1 < judge(dive, solution).metrics["nees_position"] < 3.0


def test_unverified_steps_are_not_used(truth: Truth) -> None:
    dive = add_odometry(truth.dive)
    assert dive.odometry is not None
    wrong = replace(dive.odometry, accepted=np.zeros(len(dive.odometry), dtype=np.bool_))
    solution = smooth(replace(dive, odometry=wrong), QUICK)
    assert "odometry" not in solution.info["factors"]


@pytest.mark.data
def test_a_real_imu_with_a_simulated_camera() -> None:
    """EuRoC's drone without anything but its IMU: a bias of 4.5 deg/s, odometry and places from its reference."""
    dive = add_odometry(real("euroc"), OdometryModel(period_s=0.1, sigma=0.003), seed=3)
    places = ClosureModel(period_s=1.0, reach_m=1.0, apart_s=15.0, false_share=0.3, sigma=0.03, shift_m=(0.5, 5.0))
    seen = add_closures(dive, places, seed=3)
    assert seen.closures is not None
    without, solution = smooth(dive, QUICK), smooth(seen, QUICK)
    assert solution.closures is not None
    true = seen.closures.reason == TRUE
    assert not solution.closures.accepted[~true].any()
    assert solution.closures.accepted[true].mean() > 0.9
    before, after = (judge(seen, s).metrics for s in (without, solution))
    assert before["horizontal_rmse_m"] < 0.3
    assert after["horizontal_rmse_m"] < 0.1
    assert after["heading_rmse_deg"] < 0.4
