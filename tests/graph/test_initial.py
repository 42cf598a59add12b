"""The first state: level, heading from whoever knows it, position; and the refusal when nobody does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from graph_dives import SHORT, START_NS, Truth, hand_made
from hypothesis import given
from hypothesis import strategies as st

from uwgraph.dive import Dive
from uwgraph.dive.rig import DepthRig, FixesRig, HeadingRig
from uwgraph.errors import DataError, InitialisationError
from uwgraph.frames import matrix_from_rph, rph_from_matrix, wrap_pi
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.graph.initial import Initial, initial_state, level
from uwgraph.graph.prepare import BodyImu, prepare
from uwgraph.simulate import DepthModel, GnssModel, HeadingModel, SimulationSettings, SunModel

AUTO = SmoothSettings()
AT_SURFACE = SimulationSettings(
    duration_s=90.0, depth=0.3, leg_length_m=40.0, surface_time_s=2.0, compass=HeadingModel(), grade="fog"
)
"""The antenna is out of the water all the time, so that fixes tell a course."""


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth.of(AT_SURFACE, seed=1)


def only(dive: Dive, *names: str) -> Dive:
    gone = {name: None for name in ("heading", "sun", "fixes", "reference") if name not in names}
    return replace(dive, **gone)


def first(dive: Dive, settings: SmoothSettings = AUTO) -> Initial:
    return initial_state(prepare(dive), settings)


def heading_error_deg(truth: Truth, found: Initial) -> float:
    true = rph_from_matrix(truth.R_nb(np.array([found.t_ns])))[0, 2]
    return float(np.degrees(np.abs(wrap_pi(rph_from_matrix(found.R_nb)[2] - true))))


@given(roll=st.floats(-3.1, 3.1), pitch=st.floats(-1.5, 1.5), heading=st.floats(-3.1, 3.1))
def test_a_resting_accelerometer_tells_roll_and_pitch(roll: float, pitch: float, heading: float) -> None:
    R = matrix_from_rph([roll, pitch, heading])
    f_b = np.tile(R.T @ [0.0, 0.0, -9.81], (200, 1))
    imu = BodyImu(START_NS + 10**7 * np.arange(201), f_b, np.zeros((200, 3)))
    np.testing.assert_allclose(level(hand_made(imu), START_NS), [roll, pitch], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_level_on_the_waves(seed: int) -> None:
    """Sign and size on a simulated vehicle that rolls and pitches by degrees at the surface."""
    truth = Truth.of(SHORT.model_copy(update={"waves": 2.0, "surface_time_s": 20.0}), seed)
    prepared = prepare(truth.dive)
    t0 = prepared.imu.t_ns[:1]
    true = rph_from_matrix(truth.R_nb(t0))[0, :2]
    found = level(prepared, int(t0[0]))
    np.testing.assert_allclose(np.degrees(found), np.degrees(true), atol=1.0)


def test_level_uses_what_the_gyro_turned() -> None:
    """A vehicle that rolls 40 deg in ten seconds is still levelled at its first instant."""
    roll = np.radians(10.0 + 4.0 * np.arange(1001) * 0.01)
    R = matrix_from_rph(np.stack([roll, np.zeros(1001), np.zeros(1001)], axis=1))
    f_b = np.einsum("kji,j->ki", R[:-1], [0.0, 0.0, -9.81])
    w_b = np.tile([np.radians(4.0), 0.0, 0.0], (1000, 1))
    imu = BodyImu(START_NS + 10**7 * np.arange(1001), f_b, w_b)
    np.testing.assert_allclose(np.degrees(level(hand_made(imu), START_NS)), [10.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("streams", "source", "within_deg"),
    [
        (("heading",), "the compass", 2.0),
        (("sun",), "the sun", 2.0),
        (("fixes",), "the course over the fixes", 5.0),
        (("heading", "sun", "fixes"), "the compass", 2.0),
        (("sun", "fixes"), "the sun", 2.0),
    ],
)
def test_heading_from_whoever_knows_it(truth: Truth, streams: tuple[str, ...], source: str, within_deg: float) -> None:
    found = first(only(truth.dive, *streams))
    assert f"heading from {source}" in found.source
    assert heading_error_deg(truth, found) < within_deg


def test_the_users_word_goes_first(truth: Truth) -> None:
    found = first(truth.dive, SmoothSettings(heading_deg=123.0, heading_sigma_deg=4.0))
    assert "the user's word" in found.source
    assert np.degrees(rph_from_matrix(found.R_nb)[2]) == pytest.approx(123.0)
    cov_n = found.R_nb @ found.cov_rotation_b @ found.R_nb.T
    assert np.sqrt(cov_n[2, 2]) == pytest.approx(np.radians(4.0))


def test_the_reference_when_asked(truth: Truth) -> None:
    rig = truth.dive.rig
    arm = rig.model_copy(update={"reference": rig.reference.model_copy(update={"translation_m": (1.0, 2.0, 3.0)})})
    found = first(replace(truth.dive, rig=arm), SmoothSettings(initial="reference"))
    t = np.array([found.t_ns])
    assert truth.dive.reference is not None
    assert found.source == "the reference"
    assert heading_error_deg(truth, found) < 1e-6
    # the reference is of a point at the arm: the body origin is that much back
    np.testing.assert_allclose(found.p_n, truth.p_n(t)[0] - truth.R_nb(t)[0] @ [1.0, 2.0, 3.0], atol=1e-6)


def test_flagged_suns_tell_no_heading(truth: Truth) -> None:
    """Bad observations point 90 deg away; half of them are flagged, then all."""
    sun = truth.dive.sun
    assert sun is not None
    aside = sun.s_b @ matrix_from_rph([0.0, 0.0, np.pi / 2])
    bad = np.arange(len(sun)) % 2 == 0
    flagged = replace(sun, s_b=np.where(bad[:, None], aside, sun.s_b), flags=bad.astype(np.int64))
    found = first(replace(only(truth.dive), sun=flagged))
    assert heading_error_deg(truth, found) < 2.0
    with pytest.raises(InitialisationError, match="nothing in this dive tells the heading"):
        first(replace(only(truth.dive), sun=replace(sun, flags=np.ones(len(sun), dtype=np.int64))))


def test_without_any_source_it_says_what_would_do(truth: Truth) -> None:
    with pytest.raises(InitialisationError, match="nothing in this dive tells the heading") as caught:
        first(only(truth.dive))
    for way_out in ("--heading-deg", "sun", "fixes", "--initial reference"):
        assert way_out in caught.value.remedy
    with pytest.raises(InitialisationError):
        smooth(only(truth.dive))


def test_fixes_of_a_vehicle_that_hardly_moved_tell_no_course(truth: Truth) -> None:
    assert truth.dive.fixes is not None
    few = replace(only(truth.dive), fixes=truth.dive.fixes.select(slice(0, 6)))
    with pytest.raises(InitialisationError, match="nothing in this dive tells the heading"):
        first(few)


def test_fixes_without_dvl_tell_no_course(truth: Truth) -> None:
    with pytest.raises(InitialisationError):
        first(replace(only(truth.dive, "fixes"), dvl=None))


def test_a_reference_that_is_not_there_is_refused(truth: Truth) -> None:
    with pytest.raises(InitialisationError, match="reference"):
        first(only(truth.dive, "sun"), SmoothSettings(initial="reference"))
    assert truth.dive.reference is not None
    blind = replace(truth.dive.reference, rph=np.full_like(truth.dive.reference.rph, np.nan))
    with pytest.raises(InitialisationError, match="no full pose"):
        first(replace(truth.dive, reference=blind), SmoothSettings(initial="reference"))


def test_a_magnetic_heading_without_declination_is_refused(truth: Truth) -> None:
    assert truth.dive.heading is not None
    magnetic = replace(only(truth.dive), heading=replace(truth.dive.heading, reference="magnetic"))
    with pytest.raises(DataError, match="declination"):
        smooth(magnetic)
    rig = truth.dive.rig.model_copy(update={"heading": HeadingRig(declination_deg=10.0)})
    turned = first(replace(magnetic, rig=rig))
    assert heading_error_deg(truth, turned) == pytest.approx(10.0, abs=2.0)


def test_position_from_the_first_fix_and_depth_from_its_sensor(truth: Truth) -> None:
    found = first(truth.dive)
    assert "position from the first fix (gnss)" in found.source
    error = found.p_n - truth.p_n(np.array([found.t_ns]))[0]
    assert np.linalg.norm(error[:2]) < 4.0 * GnssModel().rig.sigma
    assert abs(error[2]) < 0.5


def test_without_fixes_the_dive_starts_at_its_origin(truth: Truth) -> None:
    found = first(only(truth.dive, "sun"))
    assert "the origin of the dive" in found.source
    np.testing.assert_array_equal(found.p_n[:2], 0.0)
    np.testing.assert_array_equal(found.sigma_p[:2], AUTO.position_sigma_m)


def test_the_sun_is_worth_its_noise() -> None:
    truth = Truth.of(SHORT.model_copy(update={"grade": "noise_free", "sun": SunModel(), "waves": 0.0}))
    assert heading_error_deg(truth, first(only(truth.dive, "sun"))) < 0.05


def test_the_first_position_is_that_of_the_body_and_not_of_its_sensors() -> None:
    """Antenna and depth sensor on lever arms, nothing with noise: dead reckoning starts where the body is."""
    fixes, depth = (-0.6, 0.2, -0.7), (-0.3, 0.1, -0.25)
    quiet = AT_SURFACE.model_copy(
        update={
            "grade": "noise_free",
            "gnss": GnssModel(rig=FixesRig(sigma=1e-4, translation_m=fixes)),
            "depth_sensor": DepthModel(rig=DepthRig(sigma=1e-4, translation_m=depth)),
        }
    )
    truth = Truth.of(quiet)
    found = first(truth.dive)
    np.testing.assert_allclose(found.p_n, truth.p_n(np.array([found.t_ns]))[0], atol=0.02)
