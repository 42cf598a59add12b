from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hand_made import ORIGIN, START, as_reference, disturbed, shifted, truth, turned
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.dive.body_reference import body_reference
from uwgraph.dive.model import Dive
from uwgraph.dive.rig import ReferenceRig, Rig
from uwgraph.errors import ConfigError
from uwgraph.evaluate.metrics import compare, metrics, nees_bounds
from uwgraph.evaluate.people import people, rph_jacobian
from uwgraph.evaluate.reference import reference_at
from uwgraph.frames import matrix_from_rph, rph_from_matrix, wrap_pi
from uwgraph.types import Reference


def test_a_perfect_solution_has_no_error() -> None:
    m = metrics(truth(), as_reference(truth()))
    assert m["matched"] == m["total"] == 400
    assert m["horizontal_rmse_m"] < 1e-6
    assert m["depth_rmse_m"] < 1e-6
    assert max(m["roll_rmse_deg"], m["pitch_rmse_deg"], m["heading_rmse_deg"]) < 1e-9
    assert m["runtime_s"] == 1.5
    json.dumps(m, allow_nan=False)


def test_a_planted_offset_is_read_back() -> None:
    m = metrics(shifted(truth(), np.array([3.0, 4.0, 0.5])), as_reference(truth()))
    assert m["horizontal_rmse_m"] == pytest.approx(5.0, abs=1e-6)
    assert m["final_error_m"] == pytest.approx(5.0, abs=1e-6)
    assert m["depth_rmse_m"] == pytest.approx(0.5, abs=1e-3)
    assert m["final_error_percent"] == pytest.approx(100 * 5.0 / m["distance_m"])


def test_distance_is_the_length_of_the_track() -> None:
    fine = truth(n=40_000, period_s=0.01)
    length = np.trapezoid(np.linalg.norm(fine.v_n, axis=1), dx=0.01)
    assert metrics(truth(), as_reference(truth()))["distance_m"] == pytest.approx(length, rel=3e-3)


def test_origin_alignment_removes_the_offset_only() -> None:
    m = metrics(shifted(truth(), np.array([3.0, 4.0, 0.5])), as_reference(truth()), "origin")
    assert m["horizontal_rmse_m"] < 1e-6
    assert "nees_position" not in m


@settings(max_examples=25, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-50, 50), st.floats(-50, 50))
def test_yaw_alignment_removes_a_planted_turn_and_shift(angle: float, north: float, east: float) -> None:
    moved = shifted(turned(truth(n=200), angle), np.array([north, east, 0.0]))
    m = metrics(moved, as_reference(truth(n=200)), "yaw")
    assert m["horizontal_rmse_m"] < 1e-6
    assert m["heading_rmse_deg"] < 1e-3


def test_yaw_alignment_keeps_errors_of_shape() -> None:
    bent = truth()
    wave = np.stack([0 * bent.p_n[:, 0], 2.0 * np.sin(np.arange(400) / 5.0), 0 * bent.p_n[:, 0]], axis=1)
    m = metrics(turned(shifted(bent, wave), 0.3), as_reference(truth()), "yaw")
    assert m["horizontal_rmse_m"] == pytest.approx(np.sqrt(2.0), rel=0.05)


def test_without_alignment_a_turn_is_seen_in_the_heading() -> None:
    m = metrics(turned(truth(), np.radians(2.0)), as_reference(truth()))
    assert m["heading_rmse_deg"] == pytest.approx(2.0, abs=2e-3)
    assert m["horizontal_rmse_m"] > 5.0


def test_unknown_alignment_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"'sim3'.*\n.*se3"):
        metrics(truth(), as_reference(truth()), "sim3")  # type: ignore[arg-type]


def test_nees_is_one_when_errors_are_drawn_from_the_covariance() -> None:
    rng = np.random.default_rng(1)
    many = [metrics(disturbed(truth(), rng), as_reference(truth())) for _ in range(10)]
    for name, dof in (("nees_position", 3), ("nees_heading", 1), ("nees_attitude", 3)):
        low, high = nees_bounds(dof, runs=4000, confidence=0.9999)
        assert low < np.mean([m[name] for m in many]) < high, name


def test_nees_grows_when_the_covariance_is_too_small() -> None:
    solution = disturbed(truth(), np.random.default_rng(2))
    bold = replace(solution, cov_pose=solution.cov_pose / 9.0)
    assert metrics(bold, as_reference(truth()))["nees_position"] == pytest.approx(9.0, rel=0.2)


def test_nees_bounds_close_on_one() -> None:
    assert nees_bounds(1)[1] == pytest.approx(5.0239, abs=1e-3)
    low, high = nees_bounds(3, runs=20)
    assert low == pytest.approx(0.675, abs=1e-3)
    assert high == pytest.approx(1.388, abs=1e-3)


def test_reference_between_its_samples_follows_the_velocity() -> None:
    fine, coarse = truth(n=399, offset_s=0.37), as_reference(truth(n=100, period_s=4.0))
    with_velocity = reference_at(coarse, ORIGIN, fine.t_ns)
    assert int(with_velocity.has_position.sum()) == 396
    error = np.nanmax(np.abs(with_velocity.p_n - fine.p_n))
    straight = reference_at(replace(coarse, v_n=np.full_like(coarse.v_n, np.nan)), ORIGIN, fine.t_ns)
    assert error < 1e-3 < 0.05 < np.nanmax(np.abs(straight.p_n - fine.p_n))


def test_only_the_span_of_the_reference_is_matched() -> None:
    reference = as_reference(truth()).select(slice(100, 201))
    m = metrics(truth(), reference)
    assert (m["matched"], m["total"]) == (101, 400)


def test_nothing_is_interpolated_across_a_long_gap() -> None:
    keep = np.ones(400, dtype=bool)
    keep[100:150] = False
    c = compare(truth(), as_reference(truth()).select(keep))
    assert not c.matched[100:150].any()
    assert c.matched.sum() == 350


def test_no_overlap_gives_no_numbers() -> None:
    reference = as_reference(truth())
    m = metrics(truth(), replace(reference, t_ns=reference.t_ns + 10**15))
    assert m["matched"] == 0
    assert m["horizontal_rmse_m"] is None
    assert m["nees_position"] is None
    json.dumps(m, allow_nan=False)


def test_a_reference_of_heading_alone() -> None:
    full = as_reference(truth())
    nothing = np.full(400, np.nan)
    rph = np.stack([nothing, nothing, full.rph[:, 2]], axis=1)
    bare = Reference(full.t_ns, nothing, nothing, nothing, rph, np.full((400, 3), np.nan))
    later = truth(n=300, offset_s=0.5)
    m = metrics(later, bare)
    assert m["matched"] == 300
    assert m["heading_rmse_deg"] < 0.01
    assert m["roll_rmse_deg"] is None
    assert m["horizontal_rmse_m"] is None


def test_a_reference_without_heights() -> None:
    flat = replace(as_reference(truth()), height=np.full(400, np.nan))
    m = metrics(shifted(truth(), np.array([3.0, 4.0, 0.0])), flat)
    assert m["horizontal_rmse_m"] == pytest.approx(5.0, abs=2e-3)
    assert m["depth_rmse_m"] is None
    assert m["distance_m"] > 100.0


def test_without_covariances_there_is_no_nees() -> None:
    solution = replace(truth(), cov_pose=np.full((400, 6, 6), np.nan))
    m = metrics(solution, as_reference(truth()))
    assert m["nees_position"] is None
    assert m["sigma"] == {}


def test_sigma_along_north_follows_the_body() -> None:
    """Sigma is 0.1 forward and 0.2 to starboard: on an easterly heading they change places."""
    solution = truth(n=2)
    R = matrix_from_rph(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2]]))
    cov = people(replace(solution, R_nb=R)).cov_p_n
    np.testing.assert_allclose(np.sqrt(cov[:, 0, 0]), [0.1, 0.2])
    np.testing.assert_allclose(np.sqrt(cov[:, 1, 1]), [0.2, 0.1])


@settings(max_examples=50, deadline=None)
@given(st.floats(-3, 3), st.floats(-1.3, 1.3), st.floats(-3, 3))
def test_rph_jacobian_against_differences(roll: float, pitch: float, heading: float) -> None:
    rph = np.array([roll, pitch, heading])
    step = 1e-6
    turns = Rotation.from_rotvec(np.vstack([np.eye(3), -np.eye(3)]) * step).as_matrix()
    moved = rph_from_matrix(turns @ matrix_from_rph(rph))
    numeric = wrap_pi(moved[:3] - moved[3:]).T / (2 * step)
    np.testing.assert_allclose(rph_jacobian(rph[None])[0], numeric, atol=1e-6)


def test_stamps_keep_their_nanoseconds() -> None:
    assert int(truth().t_ns[0]) == START


def test_the_reference_is_moved_to_the_body_and_its_clock() -> None:
    body = truth()
    arm, turn = (1.0, -0.5, 0.2), (2.0, -3.0, 15.0)
    rig = Rig(reference=ReferenceRig(translation_m=arm, rotation_deg=turn, time_offset_s=0.25))
    mast = replace(body, p_n=body.p_n + body.R_nb @ np.array(arm), R_nb=body.R_nb @ matrix_from_rph(np.radians(turn)))
    late = as_reference(mast)
    dive = Dive(ORIGIN, rig, reference=replace(late, t_ns=late.t_ns - 250_000_000))
    m = metrics(body, body_reference(dive))
    assert m["matched"] == 400
    assert m["horizontal_rmse_m"] < 1e-6
    assert max(m["roll_rmse_deg"], m["pitch_rmse_deg"], m["heading_rmse_deg"]) < 1e-5


def test_a_dive_without_reference_has_none() -> None:
    assert body_reference(Dive(ORIGIN)) is None
