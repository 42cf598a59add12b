"""Relative and absolute errors and alignments: what they must not see, what they must, and evo as the oracle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PoseTrajectory3D
from hand_made import as_reference, disturbed, shifted, truth, turned
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.errors import ConfigError
from uwgraph.evaluate.matching import compare_trajectories
from uwgraph.evaluate.metrics import error_metrics, metrics, nees, nees_bounds
from uwgraph.evaluate.relative import pairs_apart, relative_errors, usual_distances
from uwgraph.evaluate.trajectory import Trajectory, trajectory_of
from uwgraph.types import FloatArray, TimeArray

angles = st.floats(-3.0, 3.0)
metres = st.floats(-1e4, 1e4)


def walk(seed: int, n: int = 300) -> Trajectory:
    """A track in space that turns about every axis, with a stop in the middle."""
    rng = np.random.default_rng(seed)
    step = rng.normal([1.0, 0.3, 0.05], 0.5, (n, 3))
    step[n // 3 : n // 2] = 0.0
    R = Rotation.from_rotvec(np.cumsum(rng.normal(scale=0.1, size=(n, 3)), axis=0)).as_matrix()
    return trajectory_of(np.arange(n) * 1_000_000_000, np.cumsum(step, axis=0), R_nb=R)


def wrong(trajectory: Trajectory, seed: int = 7) -> Trajectory:
    """Its estimate: noise, a scale, and a drifting attitude."""
    rng = np.random.default_rng(seed)
    n = len(trajectory)
    drift = Rotation.from_rotvec(np.cumsum(rng.normal(scale=2e-3, size=(n, 3)), axis=0)).as_matrix()
    p_n = 1.01 * trajectory.p_n + rng.normal(scale=0.1, size=(n, 3))
    return trajectory_of(trajectory.t_ns, p_n, R_nb=drift @ trajectory.R_nb)


def moved(trajectory: Trajectory, rotvec: FloatArray, shift: FloatArray) -> Trajectory:
    R = Rotation.from_rotvec(rotvec).as_matrix()
    return trajectory_of(trajectory.t_ns, trajectory.p_n @ R.T + shift, R_nb=R @ trajectory.R_nb)


def rpe(estimate: Trajectory, reference: Trajectory, *distances: float) -> list[dict[str, float]]:
    return error_metrics(compare_trajectories(estimate, reference), distances)["rpe"]


@settings(max_examples=25, deadline=None)
@given(st.tuples(angles, angles, angles), st.tuples(metres, metres, metres))
def test_ate_does_not_see_a_common_rigid_motion(rotvec: FloatArray, shift: FloatArray) -> None:
    reference, estimate = walk(1), wrong(walk(1))
    before = error_metrics(compare_trajectories(estimate, reference))
    after = error_metrics(compare_trajectories(moved(estimate, rotvec, shift), moved(reference, rotvec, shift)))
    for name in ("ate_rmse_m", "ate_mean_m", "ate_median_m", "ate_max_m", "attitude_rmse_deg", "distance_m"):
        assert after[name] == pytest.approx(before[name], rel=1e-7), name


@settings(max_examples=25, deadline=None)
@given(st.tuples(angles, angles, angles), st.tuples(metres, metres, metres))
def test_rpe_does_not_see_a_rigid_motion_of_the_estimate(rotvec: FloatArray, shift: FloatArray) -> None:
    reference, estimate = walk(2), wrong(walk(2))
    before = rpe(estimate, reference, 10.0, 50.0)
    after = rpe(moved(estimate, rotvec, shift), reference, 10.0, 50.0)
    assert [row["pairs"] for row in after] == [row["pairs"] for row in before]
    for one, other in zip(after, before, strict=True):
        for name in ("translation_rmse_m", "heading_rmse_deg", "rotation_rmse_deg"):
            assert one[name] == pytest.approx(other[name], rel=1e-6), name


@settings(max_examples=25, deadline=None)
@given(st.tuples(angles, angles, angles), st.tuples(metres, metres, metres))
def test_se3_recovers_any_rigid_motion(rotvec: FloatArray, shift: FloatArray) -> None:
    reference = walk(3)
    m = error_metrics(compare_trajectories(moved(reference, rotvec, shift), reference, "se3"))
    assert m["ate_max_m"] < 1e-7
    assert m["attitude_rmse_deg"] < 1e-6


@settings(max_examples=25, deadline=None)
@given(angles, st.tuples(metres, metres, metres))
def test_yaw_recovers_a_turn_about_the_vertical_and_a_shift(angle: float, shift: FloatArray) -> None:
    reference = walk(4)
    m = error_metrics(compare_trajectories(moved(reference, np.array([0, 0, angle]), shift), reference, "yaw"))
    assert m["ate_max_m"] < 1e-7
    assert m["attitude_rmse_deg"] < 1e-6


def test_yaw_does_not_hide_a_tilt_and_se3_does() -> None:
    reference = walk(5)
    tilted = moved(reference, np.radians([3.0, 0.0, 0.0]), np.zeros(3))
    by_yaw, by_se3 = (error_metrics(compare_trajectories(tilted, reference, how)) for how in ("yaw", "se3"))
    assert by_yaw["attitude_rmse_deg"] == pytest.approx(3.0, abs=0.1)
    assert by_yaw["ate_rmse_m"] > 0.1
    assert by_se3["attitude_rmse_deg"] < 1e-6


def test_origin_shifts_by_the_first_pose_alone() -> None:
    reference = walk(6)
    estimate = moved(wrong(reference), np.zeros(3), np.array([50.0, -20.0, 3.0]))
    c = compare_trajectories(estimate, reference, "origin")
    np.testing.assert_allclose(c.e_n[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(c.solution.R_nb, estimate.R_nb)


def test_se3_of_a_straight_track_is_refused() -> None:
    along = np.linspace(0.0, 100.0, 50)[:, None] * [1.0, 0.5, 0.1]
    track = trajectory_of(np.arange(50), along, R_nb=np.tile(np.eye(3), (50, 1, 1)))
    with pytest.raises(ConfigError, match="straight"):
        compare_trajectories(track, track, "se3")


def test_se3_needs_heights() -> None:
    reference = walk(8)
    flat = replace(reference, p_n=reference.p_n * [1.0, 1.0, np.nan])
    with pytest.raises(ConfigError, match="heights"):
        compare_trajectories(reference, flat, "se3")


def test_se3_of_a_dive_goes_through_the_same_door() -> None:
    moved_dive = shifted(turned(truth(), 0.4), np.array([30.0, -10.0, 2.0]))
    m = metrics(moved_dive, as_reference(truth()), "se3")
    assert m["ate_rmse_m"] < 1e-5
    assert "nees_position" not in m


@pytest.mark.parametrize("scale", [0.98, 1.003])
def test_a_scale_error_costs_its_share_of_the_distance(scale: float) -> None:
    """On a straight way: of every pair's own distance, which near the end is up to a tenth shorter."""
    n = 400
    track = trajectory_of(
        np.arange(n),
        np.arange(n)[:, None] * [0.8, 0.6, 0.0],
        R_nb=np.tile(Rotation.from_rotvec([0.1, 0.2, 1]).as_matrix(), (n, 1, 1)),
    )
    rows = rpe(replace(track, p_n=track.p_n * scale), track, 10.0, 50.0, 100.0)
    assert [row["distance_m"] for row in rows] == [10.0, 50.0, 100.0]
    for row in rows:
        assert row["translation_rmse_m"] == pytest.approx(abs(scale - 1.0) * row["distance_m"], rel=5e-3)
        assert row["translation_rmse_percent"] == pytest.approx(100.0 * abs(scale - 1.0), rel=1e-9)
        assert row["heading_rmse_deg"] == pytest.approx(0.0, abs=1e-9)
        assert row["pairs"] == n - row["distance_m"] + row["distance_m"] // 10


def test_a_heading_rate_error_grows_with_the_distance() -> None:
    n, rate = 400, np.radians(0.01)
    still = np.tile(np.eye(3), (n, 1, 1))
    way = np.arange(n)[:, None] * [1.0, 0.0, 0.0]
    turning = Rotation.from_rotvec(np.arange(n)[:, None] * [0.0, 0.0, rate]).as_matrix()
    rows = rpe(
        trajectory_of(np.arange(n), way, R_nb=turning), trajectory_of(np.arange(n), way, R_nb=still), 10.0, 100.0
    )
    for row in rows:
        assert row["heading_rmse_deg"] == pytest.approx(0.01 * row["distance_m"], rel=5e-3)
        assert row["rotation_rmse_deg"] == pytest.approx(row["heading_rmse_deg"], rel=1e-6)


def test_without_attitudes_displacements_are_compared_in_the_frame() -> None:
    reference, estimate = walk(9), wrong(walk(9))
    bare = replace(reference, R_nb=np.full_like(reference.R_nb, np.nan), rph=np.full_like(reference.rph, np.nan))
    row = rpe(estimate, bare, 20.0)[0]
    assert row["axes"] == "navigation"
    assert row["rotation_rmse_deg"] is None
    assert row["heading_rmse_deg"] is None
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(reference.p_n, axis=0), axis=1))])
    i, j = pairs_apart(travelled, 20.0)
    error = (estimate.p_n[j] - estimate.p_n[i]) - (reference.p_n[j] - reference.p_n[i])
    assert row["translation_rmse_m"] == pytest.approx(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def test_ate_is_horizontal_where_there_are_no_heights() -> None:
    reference = walk(10)
    flat = replace(reference, p_n=reference.p_n * [1.0, 1.0, np.nan])
    m = error_metrics(compare_trajectories(moved(reference, np.zeros(3), np.array([3.0, 4.0, 12.0])), flat))
    assert m["ate_dimensions"] == 2
    assert m["ate_rmse_m"] == pytest.approx(5.0)
    deep = error_metrics(compare_trajectories(moved(reference, np.zeros(3), np.array([3.0, 4.0, 12.0])), reference))
    assert deep["ate_dimensions"] == 3
    assert deep["ate_rmse_m"] == pytest.approx(13.0)
    assert deep["ate_rmse_percent"] == pytest.approx(100.0 * 13.0 / deep["distance_m"])


@pytest.mark.parametrize("seed", range(4))
def test_evo_says_the_same_of_random_walks(seed: int) -> None:
    reference, estimate = walk(seed), wrong(walk(seed), seed + 50)
    pair = as_evo(reference), as_evo(estimate)
    ours = error_metrics(compare_trajectories(estimate, reference), [3.0, 10.0, 50.0, 100.0])
    for name, figure in evo_statistics(evo_metrics.APE(evo_metrics.PoseRelation.translation_part), pair).items():
        assert ours[f"ate_{name}_m"] == pytest.approx(figure, abs=1e-9)
    rotation = evo_statistics(evo_metrics.APE(evo_metrics.PoseRelation.rotation_angle_deg), pair)
    assert ours["attitude_rmse_deg"] == pytest.approx(rotation["rmse"], abs=1e-9)
    assert len(ours["rpe"]) == 4
    for row in ours["rpe"]:
        for relation, name in (
            (evo_metrics.PoseRelation.translation_part, "translation_rmse_m"),
            (evo_metrics.PoseRelation.rotation_angle_deg, "rotation_rmse_deg"),
        ):
            theirs = evo_metrics.RPE(
                relation, row["distance_m"], evo_metrics.Unit.meters, all_pairs=True, pairs_from_reference=True
            )
            theirs.process_data(pair)
            assert len(theirs.error) == row["pairs"]
            assert row[name] == pytest.approx(np.sqrt(np.mean(theirs.error**2)), abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_evo_aligns_alike(seed: int) -> None:
    reference = walk(seed)
    estimate = moved(wrong(reference, seed), np.array([0.3, -0.2, 2.0]), np.array([100.0, 50.0, -20.0]))
    aligned = as_evo(estimate)
    aligned.align(as_evo(reference))
    c = compare_trajectories(estimate, reference, "se3")
    np.testing.assert_allclose(c.solution.p_n, aligned.positions_xyz, atol=1e-8)
    np.testing.assert_allclose(c.solution.R_nb, np.array(aligned.poses_se3)[:, :3, :3], atol=1e-9)


def as_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    wxyz = Rotation.from_matrix(trajectory.R_nb).as_quat(scalar_first=True)
    return PoseTrajectory3D(trajectory.p_n, wxyz, trajectory.t_ns * 1e-9)


def evo_statistics(metric: evo_metrics.PE, pair: tuple[PoseTrajectory3D, PoseTrajectory3D]) -> dict[str, float]:
    metric.process_data(pair)
    every = metric.get_all_statistics()
    return {name: float(every[name]) for name in ("rmse", "mean", "median", "max")}


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.sampled_from([0.0, 0.4, 1.0, 7.0, 30.0]), min_size=1, max_size=60), st.sampled_from([1.0, 5.0, 20.0])
)
def test_pairs_are_those_of_a_search_through_all(steps: list[float], distance: float) -> None:
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    expected = []
    for i in range(len(travelled) - 1):
        off = np.abs(travelled[i + 1 :] - travelled[i] - distance)
        if off.min() <= 0.1 * distance:
            expected.append((i, i + 1 + int(off.argmin())))
    i, j = pairs_apart(travelled, distance)
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == expected


def test_many_poses_start_fewer_pairs_and_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uwgraph.evaluate.relative.MAX_STARTS", 100)
    reference, estimate = walk(11), wrong(walk(11))
    row = rpe(estimate, reference, 10.0)[0]
    assert row["pair_spacing"] == 3
    assert row["pairs"] <= 100


def test_usual_distances_scale_with_the_way() -> None:
    assert usual_distances(759.0) == (20.0, 50.0, 100.0, 200.0)
    assert usual_distances(20_000.0) == (1000.0, 2000.0, 5000.0, 10_000.0)
    assert usual_distances(5.0) == (0.2, 0.5, 1.0, 2.0)
    assert usual_distances(0.0) == usual_distances(np.nan) == ()


def test_no_poses_have_no_drift() -> None:
    nothing = np.full((5, 3), np.nan)
    assert (
        relative_errors(nothing, np.full((5, 3, 3), np.nan), nothing, np.full((5, 3, 3), np.nan), nothing[:, 0]) == []
    )


@pytest.mark.parametrize(("dof", "runs"), [(1, 1), (3, 1), (3, 50), (2, 400)])
def test_nees_bounds_hold_what_they_promise(dof: int, runs: int) -> None:
    """NEES and NIS are the same statistic; drawn from their own covariance, 95 % of the averages lie within."""
    rng = np.random.default_rng(dof * runs)
    cov = np.cov(rng.normal(size=(dof, 4 * dof + 4))).reshape(dof, dof) + np.eye(dof)
    draws = 4000
    error = rng.normal(size=(draws * runs, dof)) @ np.linalg.cholesky(cov).T
    average = nees(error, np.tile(cov, (len(error), 1, 1))).reshape(draws, runs).mean(axis=1)
    low, high = nees_bounds(dof, runs)
    inside = float(np.mean((low < average) & (average < high)))
    assert inside == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / draws))


def test_metrics_of_a_dive_have_the_new_figures() -> None:
    m = metrics(disturbed(truth(), np.random.default_rng(5)), as_reference(truth()))
    assert m["ate_dimensions"] == 3
    assert m["ate_median_m"] < m["ate_rmse_m"] < m["ate_max_m"]
    assert m["ate_rmse_m"] > m["horizontal_rmse_m"]
    assert m["attitude_rmse_deg"] > m["heading_rmse_deg"]
    assert [row["distance_m"] for row in m["rpe"]] == [50.0, 100.0, 200.0, 500.0]


def test_stamps_of_one_pose() -> None:
    stamps: TimeArray = np.array([5])
    one = trajectory_of(stamps, np.zeros((1, 3)))
    assert not compare_trajectories(one, replace(one, t_ns=stamps + 10**12)).matched.any()
