"""Measurements moved to their keyframes, held against the truth there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from graph_dives import START_NS, Truth, hand_made

from uwgraph.frames import geodetic_from_ned, matrix_from_rph, rph_from_matrix, wrap_pi
from uwgraph.graph import moving
from uwgraph.graph.prepare import BodyImu, Prepared, prepare
from uwgraph.graph.track import Track
from uwgraph.simulate import HeadingModel, SimulationSettings
from uwgraph.sun.ephemeris import sun_direction_n
from uwgraph.time import from_seconds
from uwgraph.types import Depth, Fixes, FloatArray, Heading, TimeArray

TURNING = SimulationSettings(
    duration_s=90.0,
    leg_length_m=15.0,
    line_spacing_m=15.0,
    surface_time_s=5.0,
    grade="noise_free",
    compass=HeadingModel(rate_hz=3.0),
)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth.of(TURNING)


@pytest.fixture(scope="module")
def prepared(truth: Truth) -> Prepared:
    return prepare(truth.dive)


@pytest.fixture(scope="module")
def track(truth: Truth, prepared: Prepared) -> Track:
    return truth.track(prepared)


@pytest.fixture(scope="module")
def keyframes(truth: Truth) -> TimeArray:
    """Off every sensor's stamps, 0.7 to 1.3 s apart."""
    steps = np.random.default_rng(0).uniform(0.7, 1.3, size=80)
    stamps = from_seconds(0.43 + np.cumsum(steps), truth.motion.start_ns)
    return stamps[stamps < truth.motion.start_ns + 89 * 10**9]


def test_the_way_turns_enough_to_tell(truth: Truth, keyframes: TimeArray) -> None:
    headings = np.unwrap(rph_from_matrix(truth.R_nb(keyframes))[:, 2])
    assert np.degrees(np.abs(np.diff(headings)).max()) > 5.0


def test_suns_point_where_the_sun_is_from_the_keyframe(
    truth: Truth, prepared: Prepared, track: Track, keyframes: TimeArray
) -> None:
    assert prepared.sun is not None
    at = moving.suns(prepared.sun, keyframes, track)
    s_n = sun_direction_n(prepared.origin, at.t_ns, prepared.origin.lat, prepared.origin.lon)
    expected = np.einsum("kji,kj->ki", truth.R_nb(keyframes[at.keyframe]), s_n)
    np.testing.assert_allclose(at.value, expected, atol=2e-6)
    # the information goes with the direction: none along it, and as much across it as before
    np.testing.assert_allclose(np.einsum("kij,kj->ki", at.spread, at.value), 0.0, atol=1e-6)
    seen = prepared.sun.select((prepared.sun.t_ns >= keyframes[0]) & (prepared.sun.t_ns <= keyframes[-1]))
    before, after = np.linalg.eigvalsh(seen.information_b), np.linalg.eigvalsh(at.spread)
    np.testing.assert_allclose(after[:, 1:], before[:, 1:], rtol=1e-9)


def test_flagged_suns_are_left_out(prepared: Prepared, track: Track, keyframes: TimeArray) -> None:
    assert prepared.sun is not None
    flags = prepared.sun.flags.copy()
    flags[::2] = 4
    all_of_them = moving.suns(prepared.sun, keyframes, track)
    good = moving.suns(replace(prepared.sun, flags=flags), keyframes, track)
    assert 0 < len(good.keyframe) < len(all_of_them.keyframe)
    assert not np.isin(good.t_ns, prepared.sun.t_ns[::2]).any()


def test_headings_are_those_of_the_keyframes(
    truth: Truth, prepared: Prepared, track: Track, keyframes: TimeArray
) -> None:
    assert prepared.heading is not None
    at = moving.headings(prepared.heading, keyframes, track)
    expected = rph_from_matrix(truth.R_nb(keyframes[at.keyframe]))[:, 2]
    # local north and the north of n part by 1e-5 rad in 100 m
    np.testing.assert_allclose(wrap_pi(at.value - expected), 0.0, atol=3e-5)
    assert len(at.keyframe) == len(keyframes)


def still(heading: float) -> tuple[Prepared, Track]:
    """Ten seconds without motion, against the stars and the Earth alike."""
    count = 1000
    imu = BodyImu(START_NS + 10**7 * np.arange(count + 1), np.zeros((count, 3)), np.zeros((count, 3)))
    prepared = hand_made(imu)
    R = np.tile(matrix_from_rph([0.0, 0.0, heading]), (2, 1, 1))
    ends = imu.t_ns[[0, -1]]
    return prepared, Track(prepared, ends, R, np.zeros((2, 3)), np.zeros((2, 3)))


@pytest.mark.parametrize("centre_deg", [180.0, -180.0, 0.0, 90.0])
def test_headings_on_both_sides_of_the_cut_meet_in_the_middle(centre_deg: float) -> None:
    _, track = still(np.radians(centre_deg))
    stamps = START_NS + np.array([19, 20, 21]) * 10**8
    values = wrap_pi(np.radians(centre_deg + np.array([-2.0, 0.0, 2.0])))
    stream = Heading(stamps, values, np.radians([1.0, 2.0, 1.0]))
    at = moving.headings(stream, START_NS + np.array([0, 2, 4]) * 10**9, track)
    assert at.keyframe.tolist() == [1]
    assert abs(wrap_pi(at.value[0] - np.radians(centre_deg))) < 1e-5
    np.testing.assert_allclose(at.spread, np.radians([1.0 / 1.5]), rtol=1e-9)


def test_depths_are_a_weighted_mean_with_its_sigma() -> None:
    _, track = still(0.0)
    stream = Depth(START_NS + np.array([19, 21, 40]) * 10**8, np.array([10.0, 13.0, 7.0]), np.array([0.1, 0.2, 0.3]))
    at = moving.depths(stream, START_NS + np.array([0, 2, 4]) * 10**9, track, np.zeros(3))
    assert at.keyframe.tolist() == [1, 2]
    np.testing.assert_allclose(at.value, [(100.0 * 10.0 + 25.0 * 13.0) / 125.0, 7.0], rtol=1e-12)
    np.testing.assert_allclose(at.spread, [125.0**-0.5, 0.3], rtol=1e-12)


def test_depths_are_those_of_the_sensor_at_the_keyframes(
    truth: Truth, prepared: Prepared, track: Track, keyframes: TimeArray
) -> None:
    assert prepared.depth is not None
    lever = truth.dive.rig.depth.l_b
    at = moving.depths(prepared.depth, keyframes, track, lever)
    np.testing.assert_allclose(at.value, -height_of(truth, keyframes[at.keyframe], lever), atol=5e-5)
    samples_each = len(prepared.depth) / len(keyframes)
    assert np.median(at.spread) == pytest.approx(truth.dive.rig.depth.sigma / np.sqrt(samples_each), rel=0.2)


def height_of(truth: Truth, t_ns: TimeArray, lever_b: FloatArray) -> FloatArray:
    return geodetic_from_ned(truth.dive.origin, truth.p_n(t_ns) + truth.R_nb(t_ns) @ lever_b)[2]


def test_fixes_are_those_of_the_antenna_at_the_keyframes(
    truth: Truth, prepared: Prepared, track: Track, keyframes: TimeArray
) -> None:
    """Fixes at sea: positions of an antenna 2 m ahead, between keyframes, while the vehicle turns."""
    lever = np.array([2.0, 0.3, -0.5])
    t_ns = truth.motion.start_ns + np.arange(17, 78, 3) * 10**9 + 370_000_000
    lat, lon, height = geodetic_from_ned(truth.dive.origin, truth.p_n(t_ns) + truth.R_nb(t_ns) @ lever)
    height[::2] = np.nan
    cov = np.tile(np.diag([4.0, 9.0, 16.0]), (len(t_ns), 1, 1))
    stream = Fixes(t_ns, lat, lon, height, cov, np.full(len(t_ns), "usbl"))
    at, _ = moving.fixes(stream, truth.dive.origin, keyframes, track, lever)
    key_ns = keyframes[at.keyframe]
    expected = truth.p_n(key_ns) + truth.R_nb(key_ns) @ lever
    np.testing.assert_allclose(at.value[1::2], expected[1::2], atol=1e-4)
    # without a height the point is taken at the surface: north and east differ by the vertical's tilt alone
    np.testing.assert_allclose(at.value[::2, :2], expected[::2, :2], atol=2e-3)
    assert np.isinf(at.spread[::2, 2, 2]).all()
    np.testing.assert_array_equal(at.spread[1::2], cov[1::2])
    np.testing.assert_array_equal(stream.cov_n, cov)


def test_samples_outside_the_keyframes_are_left_out(prepared: Prepared, track: Track, keyframes: TimeArray) -> None:
    assert prepared.depth is not None
    few = keyframes[10:20]
    at = moving.depths(prepared.depth, few, track, np.zeros(3))
    inside = (prepared.depth.t_ns >= few[0]) & (prepared.depth.t_ns <= few[-1])
    weight = at.spread**-2.0
    np.testing.assert_allclose(weight.sum(), (prepared.depth.sigma[inside] ** -2.0).sum())
