"""Filters over whole simulated dives: honest covariance, late, lost and wrong measurements, places seen again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_dives import FAST, MISSION, Run, run, task_for, until
from scipy.spatial.transform import Rotation

import factors
from uwgraph.dive import Dive
from uwgraph.evaluate import metrics, nees_bounds
from uwgraph.evaluate.people import people
from uwgraph.evaluate.reference import reference_at
from uwgraph.filters import ESTIMATORS, EstimatorSettings
from uwgraph.filters.estimate import first_belief, ins_of, solution_of
from uwgraph.filters.sensors import rememberable
from uwgraph.graph import SmoothSettings
from uwgraph.graph.observed import Observed
from uwgraph.simulate import (
    ClosureModel,
    DvlModel,
    SimulationSettings,
    add_closures,
    add_odometry,
    simulate,
)

FILTERS = ("eskf", "ukf", "aukf")
REFERENCE = SmoothSettings(initial="reference")


def mission(**update: object) -> SimulationSettings:
    return MISSION.model_copy(update=update)


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate(MISSION, 0)


@pytest.fixture(scope="module")
def plain(dive: Dive) -> dict[str, Run]:
    return {name: run(name, dive) for name in (*FILTERS, "dr", "rts")}


# Honest


NEES = {"nees_position": 3, "nees_heading": 1, "nees_attitude": 3}


def nees_at_the_end(name: str, seed: int) -> list[float]:
    """At the last stamp alone: along a dive errors hang together, between seeds they do not."""
    dive = simulate(MISSION, seed)
    task = task_for(dive)
    task = replace(task, t_ns=task.t_ns[-1:])
    solution = ESTIMATORS[name].run(task, EstimatorSettings(filter=FAST), lambda what, share: None).solution
    figures = metrics(solution, dive.reference)
    return [figures[key] for key in NEES]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eskf", "ukf"])
def test_errors_are_as_large_as_the_covariance_says(name: str) -> None:
    """Averaged over dives, in their chi-square interval (99.9 %)."""
    found = np.array([nees_at_the_end(name, seed) for seed in range(12)])
    for nees, (key, dof) in zip(found.T, NEES.items(), strict=True):
        low, high = nees_bounds(dof, len(found), confidence=0.999)
        assert low < nees.mean() < high, (key, nees)


def test_innovations_are_as_large_as_the_filter_says(plain: dict[str, Run]) -> None:
    for name in ("eskf", "ukf"):
        seen = plain[name].innovations
        assert seen is not None
        assert set(seen.kind.tolist()) == {"dvl", "depth", "fixes", "sun"}
        assert seen.accepted.mean() > 0.995
        for kind in np.unique(seen.kind).tolist():
            of_kind = seen.select(seen.kind == kind)
            low, high = nees_bounds(1, int(of_kind.dof.sum()), confidence=0.999)
            assert low < of_kind.nis @ of_kind.dof / of_kind.dof.sum() < high, (name, kind)


def test_sigma_points_and_derivatives_agree(plain: dict[str, Run]) -> None:
    """The model is nearly linear once the heading is known: centimetres and hundredths of a degree."""
    a, b = plain["eskf"].solution, plain["ukf"].solution
    late = a.t_ns > a.t_ns[0] + 30_000_000_000
    assert np.linalg.norm(a.p_n - b.p_n, axis=1)[late].max() < 0.03
    turned = Rotation.from_matrix(np.swapaxes(a.R_nb, 1, 2) @ b.R_nb).magnitude()
    assert np.degrees(turned[late]).max() < 0.1
    sigmas = [np.sqrt(np.diagonal(s.cov_pose, axis1=1, axis2=2)[late]) for s in (a, b)]
    np.testing.assert_allclose(sigmas[0][-20:], sigmas[1][-20:], rtol=0.05)


def test_filters_beat_dead_reckoning_and_the_backward_pass_beats_the_filter(plain: dict[str, Run]) -> None:
    for name in FILTERS:
        assert plain[name]["horizontal_rmse_m"] < 0.5 * plain["dr"]["horizontal_rmse_m"]
    for figure in ("heading_rmse_deg", "horizontal_rmse_m", "depth_rmse_m"):
        assert plain["rts"][figure] < 0.8 * plain["eskf"][figure], figure
    ours, theirs = plain["rts"].solution, plain["eskf"].solution
    np.testing.assert_allclose(ours.p_n[-1], theirs.p_n[-1], atol=1e-6)
    np.testing.assert_allclose(ours.cov_pose[-1], theirs.cov_pose[-1], rtol=1e-5, atol=1e-12)


def test_what_is_learnt_is_what_is_stated_where_that_is_true(plain: dict[str, Run]) -> None:
    """Also while the heading is unknown by 20 degrees, as at the start of this dive."""
    seen = plain["aukf"].innovations
    assert seen is not None
    for kind in ("dvl", "depth", "sun"):
        of_kind = seen.select(seen.kind == kind)
        noise = np.sqrt(np.nanmean(of_kind.noise[-1] ** 2))
        assert 0.75 < noise < 1.3, (kind, noise)


def test_covariances_are_covariances(plain: dict[str, Run]) -> None:
    for name in (*FILTERS, "rts"):
        solution = plain[name].solution
        for cov in (solution.cov_pose, solution.cov_v, solution.cov_bias):
            assert np.linalg.eigvalsh(cov).min() > 0.0
            np.testing.assert_allclose(cov, np.swapaxes(cov, 1, 2), atol=1e-12 * np.abs(cov).max())


def test_the_smoother_and_the_backward_pass_nearly_agree(dive: Dive, plain: dict[str, Run]) -> None:
    graph = run("smooth", dive)
    apart = np.linalg.norm(graph.solution.p_n - plain["rts"].solution.p_n, axis=1)
    sigma = np.sqrt(np.trace(graph.solution.cov_pose[:, 3:, 3:], axis1=1, axis2=2))
    assert (apart < sigma).all()


@pytest.mark.parametrize("name", ["eskf", "ukf"])
def test_a_gyro_drift_of_two_parts(dive: Dive, plain: dict[str, Run], name: str) -> None:
    """With correlation times of hours a drift is a walk: the same dive in another model."""
    markov = FAST.model_copy(
        update={"gyro_drift": "constant and Markov", "gyro_tau_s": 36_000.0, "accel_tau_s": 36_000.0}
    )
    found = run(name, dive, markov)
    assert np.linalg.norm(found.solution.p_n - plain[name].solution.p_n, axis=1).max() < 0.1
    assert found["heading_rmse_deg"] < 1.5 * plain[name]["heading_rmse_deg"]


# Late


def test_no_delay_is_no_difference(dive: Dive, plain: dict[str, Run]) -> None:
    for delays in ({}, {"sun": 0.0}):
        other = run("aukf", dive, FAST.model_copy(update={"delays_s": delays})).solution
        for column in ("R_nb", "p_n", "v_n", "cov_pose", "cov_bias"):
            np.testing.assert_array_equal(getattr(other, column), getattr(plain["aukf"].solution, column))


@pytest.mark.parametrize("name", ["eskf", "ukf"])
def test_a_late_sun_is_used_at_its_own_time(dive: Dive, plain: dict[str, Run], name: str) -> None:
    """Two seconds late: worse while the heading is being found, and at the end as without delay."""
    late = run(name, dive, FAST.model_copy(update={"delays_s": {"sun": 2.0}}))
    soon = plain[name]
    sigma = np.sqrt(np.trace(soon.solution.cov_pose[-1, 3:, 3:]))
    assert np.linalg.norm(late.solution.p_n[-1] - soon.solution.p_n[-1]) < 0.2 * sigma
    turned = Rotation.from_matrix(late.solution.R_nb[-1].T @ soon.solution.R_nb[-1]).magnitude()
    assert np.degrees(turned) < 0.03
    start = late.solution.t_ns < late.solution.t_ns[0] + 2_000_000_000
    heading = np.sqrt(late.solution.cov_pose[start, 2, 2])
    assert np.degrees(heading).min() > 10.0, "nothing of the sun is there in the first two seconds"


def beacons(dive: Dive, wrong_from_s: float = np.inf) -> list[Observed]:
    """Positions every five seconds, as a kind of its own; from some time on five metres off."""
    assert dive.reference is not None
    t_ns = dive.reference.t_ns[10::10]
    p_n = reference_at(dive.reference, dive.origin, t_ns).p_n
    wrong = t_ns >= dive.reference.t_ns[0] + round(min(wrong_from_s, 1e6) * 1e9)
    return [
        Observed(t, "beacon", factors.PositionFix(p + 5.0 * off, 4.0 * np.eye(3)))
        for t, p, off in zip(t_ns.tolist(), p_n, wrong.tolist(), strict=True)
    ]


@pytest.mark.parametrize("delay_s", [0.0, 4.0])
def test_nothing_is_used_before_it_is_there(dive: Dive, delay_s: float) -> None:
    """Measurements that are wrong from 60 s on: what was said before they came must not know, to the last bit."""
    settings = FAST.model_copy(update={"delays_s": {"beacon": delay_s, "sun": 1.0}})
    right, wrong = (run("ukf", dive, settings, more=beacons(dive, at)).solution for at in (np.inf, 60.0))
    seconds = (right.t_ns - right.t_ns[0]) * 1e-9
    apart = np.linalg.norm(right.p_n - wrong.p_n, axis=1)
    came = 60.0 + delay_s
    np.testing.assert_array_equal(apart[seconds < came], 0.0)
    assert apart[(seconds >= came) & (seconds < came + 1.0)].max() > 0.001
    assert apart[-1] > 0.1


@pytest.mark.parametrize("name", ["eskf", "ukf", "rts"])
def test_what_is_measured_at_the_first_instant_counts(dive: Dive, name: str) -> None:
    """A position of a millimetre at the moment of the first state: known from the first answer on."""
    task = task_for(dive)
    t_ns, p_n = task.initial.t_ns, task.initial.p_n
    first = Observed(t_ns, "first", factors.PositionFix(p_n, 1e-6 * np.eye(3)))
    task = until(replace(task, t_ns=np.concatenate([[t_ns], task.t_ns[task.t_ns > t_ns]]), more=[first]), 5.0)
    estimate = ESTIMATORS[name].run(task, EstimatorSettings(filter=FAST), lambda what, share: None)
    assert np.diagonal(estimate.solution.cov_pose[0])[3:].max() < 1.1e-6
    assert estimate.innovations is not None
    assert estimate.innovations.kind.tolist().count("first") == 1


def test_what_comes_after_the_end_is_not_used(dive: Dive) -> None:
    """A filter stopped at 60 s says what the filter of the whole dive says there."""
    task = task_for(dive)
    settings = EstimatorSettings(filter=FAST)
    whole = ESTIMATORS["ukf"].run(task, settings, lambda what, share: None).solution
    half = ESTIMATORS["ukf"].run(until(task, 60.0), settings, lambda what, share: None).solution
    n = len(half)
    assert n == np.searchsorted(whole.t_ns, half.t_ns[-1]) + 1
    np.testing.assert_array_equal(half.p_n, whole.p_n[:n])
    np.testing.assert_array_equal(half.cov_pose, whole.cov_pose[:n])


# Lost, wrong, missing


@pytest.mark.slow
@pytest.mark.parametrize("name", FILTERS)
def test_a_dvl_that_is_lost_for_a_minute(name: str) -> None:
    lost = simulate(mission(duration_s=180.0, dvl=DvlModel(rate_hz=2.0, lost_s=((60.0, 120.0),))), 1)
    found = run(name, lost)
    seconds = (found.solution.t_ns - found.solution.t_ns[0]) * 1e-9
    sigma_v = np.sqrt(np.trace(found.solution.cov_v, axis1=1, axis2=2))
    before, at_the_end, back = (sigma_v[np.searchsorted(seconds, t)] for t in (59.0, 119.0, 125.0))
    assert at_the_end > 10.0 * before, "nobody measures the velocity"
    assert back < 2.0 * before
    assert found.solution.cov_pose[np.searchsorted(seconds, 119.0), 3, 3] > found.solution.cov_pose[100, 3, 3]
    low, high = nees_bounds(3, 1, confidence=0.999)
    assert low < found["nees_position"] < high
    assert found["horizontal_rmse_m"] < 15.0
    whole = run(name, simulate(mission(duration_s=180.0), 1))
    assert found["horizontal_rmse_m"] > 1.2 * whole["horizontal_rmse_m"]
    assert found["heading_rmse_deg"] < 1.5 * whole["heading_rmse_deg"]


@pytest.mark.parametrize("name", FILTERS)
def test_a_fifth_of_the_pings_is_wrong(plain: dict[str, Run], name: str) -> None:
    """By a metre a second, a hundred sigmas, and called valid."""
    wrong = run(name, simulate(mission(dvl=DvlModel(rate_hz=2.0, outlier_fraction=0.2)), 0))
    assert wrong["horizontal_rmse_m"] < 1.5 * plain[name]["horizontal_rmse_m"]
    assert wrong["nees_position"] < nees_bounds(3, 1, confidence=0.999)[1]


def test_without_depth_the_height_is_what_the_fixes_knew(plain: dict[str, Run]) -> None:
    blind = run("ukf", simulate(mission(depth_sensor=None), 0))
    assert blind["horizontal_rmse_m"] < 1.2 * plain["ukf"]["horizontal_rmse_m"]
    assert plain["ukf"]["depth_rmse_m"] < 0.05 < blind["depth_rmse_m"]
    assert blind.solution.cov_pose[-1, 5, 5] > 25.0 * plain["ukf"].solution.cov_pose[-1, 5, 5]
    assert blind["nees_position"] < nees_bounds(3, 1, confidence=0.999)[1]


def test_without_a_dvl_it_says_that_it_knows_little() -> None:
    """An inertial sensor alone for two minutes: far off, and it knows."""
    blind = run("ukf", simulate(mission(dvl=None), 0), smooth=REFERENCE)
    assert blind["horizontal_rmse_m"] > 2.0
    assert blind["nees_position"] < nees_bounds(3, 1, confidence=0.999)[1]
    assert blind["depth_rmse_m"] < 0.1


@pytest.mark.parametrize("name", ["eskf", "aukf"])
def test_visual_odometry_alone(name: str, plain: dict[str, Run]) -> None:
    found = run(name, add_odometry(simulate(mission(dvl=None), 0)))
    assert found.innovations is not None
    seen = found.innovations.select(found.innovations.kind == "odometry")
    assert len(seen) > 190
    assert seen.accepted.mean() > 0.99
    assert found["horizontal_rmse_m"] < 1.5 * plain[name]["horizontal_rmse_m"]
    assert found["nees_position"] < nees_bounds(3, 1, confidence=0.999)[1]


# Places seen again


@pytest.fixture(scope="module")
def patrol() -> Dive:
    return simulate(mission(pattern="patrol", duration_s=240.0, sun=None), 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eskf", "ukf"])
def test_closures_help_and_false_ones_do_not_harm(patrol: Dive, name: str) -> None:
    without = run(name, patrol, smooth=REFERENCE)
    true = run(name, add_closures(patrol, ClosureModel(apart_s=40.0), 1), smooth=REFERENCE)
    assert true.innovations is not None
    used = true.innovations.select(true.innovations.kind == "closures")
    assert len(used) >= 5
    assert used.accepted.all()
    assert true["horizontal_rmse_m"] < 0.8 * without["horizontal_rmse_m"]
    low, high = nees_bounds(6, len(used), confidence=0.999)
    assert low < used.nis.mean() < high

    model = ClosureModel(apart_s=40.0, false_share=0.4, shift_m=(5.0, 30.0))
    wrong = add_closures(patrol, model, 1)
    found = run(name, wrong, smooth=REFERENCE)
    assert found.innovations is not None
    assert wrong.closures is not None
    judged = found.innovations.select(found.innovations.kind == "closures")
    false = np.isin(judged.t_ns, wrong.closures.t_ns[wrong.closures.reason != "simulated"])
    assert false.sum() >= 2
    assert not judged.accepted[false].any()
    assert judged.accepted[~false].all()
    assert found["horizontal_rmse_m"] < 1.05 * without["horizontal_rmse_m"], "the few true ones may move it by chance"


def test_closures_can_be_left_alone(patrol: Dive) -> None:
    closed = add_closures(patrol, ClosureModel(apart_s=40.0), 1)
    alone = FAST.model_copy(update={"max_nodes": 0})
    np.testing.assert_array_equal(
        run("eskf", closed, alone, REFERENCE).solution.p_n, run("eskf", patrol, FAST, REFERENCE).solution.p_n
    )


@pytest.mark.parametrize("most", [1, 3])
def test_no_more_poses_are_remembered_than_allowed(patrol: Dive, most: int) -> None:
    closed = add_closures(patrol, ClosureModel(apart_s=40.0, period_s=5.0), 1)
    assert closed.closures is not None
    kept = rememberable(closed.closures, most)
    assert 0 < len(kept) < len(closed.closures)
    at = np.sort(np.concatenate([kept.from_ns, kept.t_ns - 1]))
    assert max(int(np.sum((kept.from_ns <= t) & (kept.t_ns > t))) for t in at.tolist()) <= most
    assert len(rememberable(closed.closures, 200)) == len(closed.closures)


# The solution


def test_the_covariance_that_people_read_is_the_filters(dive: Dive) -> None:
    """Position along north, east, down; in the file it stands in body axes."""
    task = task_for(dive)
    ins = ins_of(task.prepared, FAST)
    belief = first_belief(task, ins)
    S = belief.S.copy()
    S[:9, :9] = np.tril(np.random.default_rng(0).normal(size=(9, 9)))
    belief = replace(belief, S=S)
    solution = solution_of(task.prepared, [belief])
    P, R = belief.P, belief.x.R[0]
    np.testing.assert_allclose(people(solution).cov_p_n[0], P[3:6, 3:6], atol=1e-9)
    np.testing.assert_allclose(solution.cov_pose[0, :3, :3], P[:3, :3], atol=1e-12)
    np.testing.assert_allclose(solution.cov_pose[0, :3, 3:] @ R.T, P[:3, 3:6], atol=1e-12)
    np.testing.assert_allclose(solution.cov_v[0], P[6:9, 6:9])
    np.testing.assert_allclose(solution.cov_bias[0], np.roll(P[9:15, 9:15], 3, axis=(0, 1)))
    np.testing.assert_allclose(solution.p_n[0], task.initial.p_n)
