"""Stretched stamps and clock offsets, planted in simulated dives and present in real ones."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.dive.inertial_track import inertial_track
from uwgraph.dive.model import Dive
from uwgraph.dive.readers import snapir
from uwgraph.dive.reference_point import depth_is_copied, reference_point
from uwgraph.dive.timing import align_clocks, clock_offset, unstretch, unstretch_stream, with_mounting
from uwgraph.errors import DataError
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate import HeadingModel, SimulationSettings, simulate
from uwgraph.types import Imu

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
RUNS = (1, 2, 4, 6, 7, 9, 12)
PERIODS = st.sampled_from(
    [1.0, 0.5, 0.25, 0.2, 0.1, 0.05, 0.04, 0.02, 0.01, 0.005, 0.008, 0.0025, 1 / 3, 1 / 30, 1 / 64]
)


def snapir_run(number: int) -> Dive:
    folder = DATA / "snapir" / f"Trajectory{number}"
    if not folder.is_dir():
        pytest.skip(f"{folder} is missing: set UWGRAPH_DATA")
    return snapir.read(folder)


@pytest.fixture(scope="module")
def dive() -> Dive:
    settings = SimulationSettings(
        duration_s=300, grade="fog", gnss=None, compass=HeadingModel(), speed=2.0, waves=4, surface_depth=2, depth=4.5
    )
    return simulate(settings, seed=3)


@pytest.fixture(scope="module")
def calm() -> Dive:
    settings = SimulationSettings(
        duration_s=400, pattern="transit", waves=0, surface_time_s=0, surface_depth=20, depth=20, sun=None, gnss=None
    )
    return simulate(settings, seed=1)


def shifted(dive: Dive, sensor: str, shift_s: float, ppm: float = 0.0) -> Dive:
    """The dive with a sensor's stamps shifted and their rate changed about the middle."""
    stream = getattr(dive, sensor)
    t = (stream.t_ns - stream.t_ns[0]) * 1e-9
    new = t + shift_s + ppm * 1e-6 * (t - t.mean())
    return replace(dive, **{sensor: replace(stream, t_ns=stream.t_ns[0] + np.rint(new * 1e9).astype(np.int64))})


@pytest.mark.parametrize("n", [2, 9, 1000])
def test_the_track_is_the_product_of_its_steps(n: int) -> None:
    rng = np.random.default_rng(n)
    imu = Imu(np.arange(n) * 10_000_000, rng.normal(size=(n, 3)), rng.normal(size=(n, 3)))
    expected = Rotation.identity()
    for w in imu.w_s[1:]:
        expected = expected * Rotation.from_rotvec(0.01 * w)
    track = inertial_track(imu)
    assert (expected.inv() * track.attitude(track.t_s[-1:])).magnitude()[0] < 1e-12


@given(PERIODS, st.integers(100, 50_000), st.floats(0, 1e5))
def test_linspace_with_endpoint_is_recognised_and_undone(period: float, n: int, start: float) -> None:
    fixed, report = unstretch(start + np.linspace(0, n * period, n))
    assert report is not None
    assert report.drift_s == pytest.approx(period, rel=1e-6)
    np.testing.assert_allclose(fixed - start, np.arange(n) * period, atol=1e-9 * n * period + 1e-9 * max(start, 1))


@given(PERIODS, st.integers(100, 50_000), st.sampled_from([0.0, 1e-9, 1e-6, 1e-3]))
def test_honest_uniform_stamps_are_left_alone(period: float, n: int, rounding: float) -> None:
    t = np.arange(n) * period
    if 0 < rounding < period / 5:
        t = np.round(t / rounding) * rounding
    assert unstretch(t)[1] is None


@given(PERIODS, st.integers(100, 5_000), st.integers(0, 2**32 - 1), st.floats(-200, 200))
def test_honest_real_clocks_are_left_alone(period: float, n: int, seed: int, ppm: float) -> None:
    rng = np.random.default_rng(seed)
    jitter = rng.uniform(0.02, 0.2) * period
    t = np.sort(np.arange(n) * period * (1 + ppm * 1e-6) + rng.uniform(-jitter, jitter, n))
    assert unstretch(t)[1] is None


def test_a_stretched_stream_of_nanoseconds_keeps_its_start(dive: Dive) -> None:
    assert dive.dvl is not None
    n = len(dive.dvl)
    stretched = replace(dive.dvl, t_ns=dive.dvl.t_ns[0] + np.rint(np.linspace(0, n * 0.2, n) * 1e9).astype(np.int64))
    fixed, report = unstretch_stream(stretched)
    assert report is not None
    assert report.ppm == pytest.approx(1e6 / (n - 1), rel=1e-3)
    assert np.abs(fixed.t_ns - fixed.t_ns[0] - np.arange(n) * 200_000_000).max() <= 1


@pytest.mark.parametrize(
    ("sensor", "shift_s"), [("dvl", -1.234), ("depth", 0.417), ("heading", -0.8), ("sun", 1.1), ("reference", 0.05)]
)
def test_a_planted_offset_is_found(dive: Dive, sensor: str, shift_s: float) -> None:
    found = clock_offset(shifted(dive, sensor, shift_s), sensor)
    assert found.observable, found.how
    assert found.offset_s == pytest.approx(-shift_s, abs=4 * found.sigma_s)
    assert found.sigma_s < 0.1


def test_a_planted_rate_is_found(dive: Dive) -> None:
    found = clock_offset(shifted(dive, "reference", 0.3, ppm=2500), "reference")
    assert found.rate_ppm == pytest.approx(-2500, abs=4 * found.rate_sigma_ppm)
    assert found.rate_sigma_ppm < 300


def test_offsets_add_up(dive: Dive) -> None:
    a, b = (clock_offset(shifted(dive, "dvl", s), "dvl").offset_s for s in (0.2, 0.7))
    assert a - b == pytest.approx(0.5, abs=0.02)


def test_a_quiet_transit_shows_no_dvl_offset(calm: Dive) -> None:
    found = clock_offset(calm, "dvl")
    assert not found.observable
    assert "not observable" in found.how


def test_noise_is_no_offset(dive: Dive) -> None:
    assert dive.dvl is not None
    rng = np.random.default_rng(0)
    noise = replace(dive.dvl, v_s=dive.dvl.v_s.mean(axis=0) + rng.normal(0, 0.3, dive.dvl.v_s.shape))
    assert not clock_offset(replace(dive, dvl=noise), "dvl").observable


def test_what_is_missing_is_named(dive: Dive) -> None:
    with pytest.raises(DataError, match="dvl"):
        clock_offset(replace(dive, dvl=None), "dvl")
    with pytest.raises(DataError, match="imu"):
        clock_offset(replace(dive, imu=None), "dvl")


def test_a_dive_is_put_on_one_clock(dive: Dive) -> None:
    late = shifted(shifted(shifted(dive, "dvl", -0.8), "depth", 0.4), "reference", 0.6)
    aligned, report = align_clocks(late)
    assert aligned.rig.dvl.time_offset_s == pytest.approx(0.8, abs=0.03)
    assert aligned.rig.depth.time_offset_s == pytest.approx(-0.4, abs=0.1)
    assert aligned.rig.reference.time_offset_s == pytest.approx(-0.6, abs=0.02)
    assert aligned.rig.heading.time_offset_s == 0.0
    assert not report.stretched
    assert aligned.dvl is late.dvl


def test_the_reference_point_is_found(dive: Dive) -> None:
    assert dive.imu is not None
    assert dive.reference is not None
    track = inertial_track(dive.imu, dive.rig.imu)
    here = reference_point(dive, track)
    assert here is not None
    assert np.abs(here.l_b)[:2].max() < 0.05
    w = track.rate((dive.reference.t_ns - dive.imu.t_ns[0]) * 1e-9)
    lever = np.array([1.8, -0.4, 0.3])
    moved = np.einsum("nij,nj->ni", matrix_from_rph(dive.reference.rph), np.cross(w, lever))
    there = reference_point(replace(dive, reference=replace(dive.reference, v_n=dive.reference.v_n + moved)), track)
    assert there is not None
    np.testing.assert_allclose(there.l_b - here.l_b, lever, atol=0.02)
    assert there.rms_after < 0.8 * there.rms_before


def test_settings_of_the_rig_are_validated(dive: Dive) -> None:
    with pytest.raises(ValueError, match="time_offset_s"):
        with_mounting(dive, "dvl", time_offset_s=1e9)


@pytest.mark.data
@pytest.mark.parametrize("number", RUNS)
def test_snapir_clocks(number: int) -> None:
    """The DVL's offset from the IMU alone agrees with the way by the reference, the depth's with the reference."""
    run = snapir_run(number)
    assert depth_is_copied(run)
    aligned, report = align_clocks(run)
    found = {o.sensor: o for o in report.offsets}
    assert all(o.observable for o in report.offsets)
    assert all(abs(o.rate_ppm) < 4 * o.rate_sigma_ppm for o in report.offsets)
    assert found["dvl"].offset_s == pytest.approx(1.027, abs=0.03)
    assert found["depth"].offset_s == pytest.approx(found["reference"].offset_s, abs=0.08)
    assert report.point is not None
    assert report.point.l_b[0] == pytest.approx(1.77, abs=0.1)
    assert aligned.rig.depth.translation_m == aligned.rig.reference.translation_m


@pytest.mark.data
def test_snapir_stamps_as_printed_run_fast() -> None:
    run = snapir_run(4)
    assert run.reference is not None
    n = len(run.reference)
    printed = run.reference.t_ns[0] + np.rint(np.linspace(0, n, n) * 1e9).astype(np.int64)
    stretched = replace(run, reference=replace(run.reference, t_ns=printed))
    found = clock_offset(stretched, "reference")
    assert found.rate_ppm == pytest.approx(-2500, abs=4 * found.rate_sigma_ppm)
    assert abs(found.rate_ppm) > 5 * found.rate_sigma_ppm
    aligned, report = align_clocks(stretched)
    assert set(report.stretched) == {"reference"}
    assert aligned.rig.reference.time_offset_s == pytest.approx(-0.43, abs=0.005)
