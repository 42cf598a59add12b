"""Noise of a still IMU: Allan deviation, fitted terms, stillness, refusals."""

import os
import tracemalloc
from pathlib import Path
from time import perf_counter

import allantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter

from uwgraph.dive.allan import allan_variance, fit_terms, model_variance
from uwgraph.dive.imu_log import read_imu
from uwgraph.dive.imu_noise import imu_noise
from uwgraph.dive.noise_terms import sensor_noise
from uwgraph.dive.rig import ImuRig
from uwgraph.errors import DataError
from uwgraph.simulate.imu import ImuGrade, imu_errors
from uwgraph.simulate.noise import Noise
from uwgraph.types import Imu

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
GRAVITY_S = np.array([0.3, -0.2, -9.8])
RIG = ImuRig(gyro_noise_density=1.2e-4, accel_noise_density=1.5e-3, gyro_bias_walk=1e-9, accel_bias_walk=1e-9)


def recording(rig, seed, duration_s, rate_hz, **grade):
    """A still IMU as the simulator's errors have it."""
    dt = np.full(round(duration_s * rate_hz), 1.0 / rate_hz)
    errors = imu_errors(ImuGrade(rig=rig, **grade), dt, Noise.of(seed, "imu"))
    stamps = 1_700_000_000_000_000_000 + np.round(np.arange(1, len(dt) + 1) * 1e9 / rate_hz).astype(np.int64)
    return Imu(stamps, f_s=errors.accel + GRAVITY_S, w_s=errors.gyro)


def flicker(rng, count, rate_hz, instability, finer=4):
    """Means over the samples' intervals of noise of two-sided density B^2 / (2 pi f), from below 1/T on."""
    f = np.fft.rfftfreq(4 * count * finer, 1.0 / (finer * rate_hz))
    f[0] = f[1]
    amplitude = instability * np.sqrt(finer * rate_hz * 4 * count * finer / 2.0 / (2.0 * np.pi * f))
    y = np.fft.irfft(amplitude * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))))
    return y[: count * finer].reshape(count, finer).mean(axis=1)


def noise_of(rng, count, rate_hz, N, K=0.0, axes=3):
    """White noise and walk."""
    y = N * np.sqrt(rate_hz) * rng.standard_normal((count, axes))
    return y + np.cumsum(K / np.sqrt(rate_hz) * rng.standard_normal((count, axes)), axis=0)


@settings(max_examples=30, deadline=None)
@given(st.integers(16, 5000), st.floats(0.5, 1000.0), st.floats(0.0, 100.0), st.integers(0, 2**32))
def test_allan_deviation_is_that_of_allantools(count, rate_hz, offset, seed):
    y = offset + np.cumsum(np.random.default_rng(seed).standard_normal(count) * [[0.1], [1.0]][seed % 2])
    found = allan_variance(y, rate_hz)
    tau, deviation, _, _ = allantools.oadev(y, rate=rate_hz, data_type="freq", taus=found.tau_s)
    np.testing.assert_allclose(found.tau_s, tau, rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(found.variance), deviation, rtol=1e-12)


@pytest.mark.parametrize(
    ("truth", "rate_hz", "count", "within"),
    [
        ({"N": 1.0}, 20.0, 2**14, 0.02),
        ({"N": 1.0, "K": 0.05}, 5.0, 2**15, 0.3),
        ({"N": 1.0, "B": 0.4}, 5.0, 2**14, 0.25),
        ({"Q": 1.0, "N": 0.5}, 20.0, 2**14, 0.05),
    ],
)
def test_terms_are_recovered_within_their_sigmas(truth, rate_hz, count, within):
    seeds, terms = 60, tuple(truth)
    deviations, misfits = [], []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, count])
        y = noise_of(rng, count, rate_hz, truth["N"], truth.get("K", 0.0), axes=1)[:, 0]
        if "B" in truth:
            y += flicker(rng, count, rate_hz, truth["B"])
        y += truth.get("Q", 0.0) * rate_hz * np.diff(rng.standard_normal(count + 1))
        t = np.arange(count) - (count - 1) / 2
        y -= y.mean() + t * (t @ y) / (t @ t)
        fit = fit_terms(allan_variance(y, rate_hz), terms)
        power = np.array([truth[term] ** 2 for term in terms])
        relative = np.sqrt(np.diag(fit.cov)) / fit.power
        # a power is chi-square distributed: its logarithm is nearer to Gaussian
        deviations.append(np.log(fit.power / power) / relative)
        misfits.append(fit.chi2 / fit.dof)
        assert (np.abs(np.sqrt(fit.power / power) - 1.0) < 4.0 * within).all()
    square = np.sum(np.square(deviations), axis=0)
    assert (square > 34.0).all()  # chi-square of 60: 0.2 and 99.8 %
    assert (square < 96.0).all()
    assert np.abs(np.mean(deviations, axis=0)).max() < 3.5 / np.sqrt(seeds)
    assert 0.8 < np.mean(misfits) < 1.2


def test_densities_of_the_simulator_from_ten_minutes():
    errors = []
    for seed in range(14):
        found = imu_noise(recording(RIG, seed, 600.0, 30.0))
        for name in ("gyro_noise_density", "accel_noise_density"):
            term = found.fields[name]
            assert term.seen
            assert abs(term.value / getattr(RIG, name) - 1.0) < 0.02
            errors.append((term.value - getattr(RIG, name)) / term.sigma)
    assert 0.41 < np.mean(np.square(errors)) < 1.88  # chi-square of 28: 0.2 and 99.8 %


def test_what_ten_minutes_cannot_show_is_refused():
    false = 0
    for seed in range(14):
        found = imu_noise(recording(RIG, seed, 600.0, 20.0))
        for name in ("gyro_bias_walk", "accel_bias_walk"):
            term = found.fields[name]
            false += term.seen
            assert term.limit > getattr(RIG, name)
            if not term.seen:
                assert getattr(found.rig(ImuRig()), name) == getattr(ImuRig(), name)
    assert false <= 2


def test_bias_walk_of_the_simulator_from_hours():
    rig = RIG.model_copy(update={"gyro_bias_walk": 5e-6, "accel_bias_walk": 8e-5})
    errors = []
    for seed in range(15):
        found = imu_noise(recording(rig, seed, 3 * 3600.0, 5.0)).fields
        for name in ("gyro_bias_walk", "accel_bias_walk"):
            assert found[name].seen
            errors.append(np.log(found[name].value / getattr(rig, name)) / (found[name].sigma / found[name].value))
    assert 0.45 < np.mean(np.square(errors)) < 1.85  # 30 of them
    assert abs(np.mean(errors)) < 3.5 / np.sqrt(len(errors))


def test_a_faint_walk_is_said_to_be_at_most_so_large():
    rig = RIG.model_copy(update={"gyro_bias_walk": 1.5e-6})
    for seed in range(5):
        term = imu_noise(recording(rig, seed, 900.0, 10.0)).fields["gyro_bias_walk"]
        assert term.limit > 0.8 * rig.gyro_bias_walk


def test_a_gauss_markov_bias_is_no_walk_of_the_rig():
    found = imu_noise(recording(RIG, 3, 2 * 3600.0, 10.0, gyro_instability=5e-5, instability_time_s=60.0))
    assert not found.fields["gyro_bias_walk"].seen
    assert found.gyro.inflation > 1.0 or found.gyro.model_error > 0.0 or found.gyro.terms["B"].seen


def test_axes_that_differ_give_the_noisiest():
    y = noise_of(np.random.default_rng(1), 20_000, 10.0, 1.0) * [1.0, 3.0, 1.0]
    term = sensor_noise(y, 10.0).terms["N"]
    assert term.axes == "y"
    assert term.value == pytest.approx(3.0, rel=0.03)
    assert sensor_noise(y * [1.0, 1 / 3.0, 1.0], 10.0).terms["N"].axes == "xyz"


def test_a_filtered_sensor_has_the_density_of_its_passband():
    rate_hz, rng = 100.0, np.random.default_rng(4)
    y = lfilter(*butter(2, 12.0, fs=rate_hz), noise_of(rng, 60_000, rate_hz, 1.0), axis=0)
    found = sensor_noise(y, rate_hz)
    assert found.tau_min_s > 2.0 / rate_hz
    assert found.terms["N"].value == pytest.approx(1.0, rel=0.05)


def test_a_linear_trend_changes_nothing_and_is_told():
    y = noise_of(np.random.default_rng(5), 30_000, 10.0, 1.0, K=0.01)
    slope = np.array([0.0, 2e-3, -5e-3])
    plain, drifting = sensor_noise(y, 10.0), sensor_noise(y + slope * np.arange(len(y))[:, None] / 10.0, 10.0)
    for term in "NK":
        assert drifting.terms[term].value == pytest.approx(plain.terms[term].value, rel=1e-6)
    trends = [b.trend - a.trend for a, b in zip(plain.axes, drifting.axes, strict=True)]
    np.testing.assert_allclose(trends, slope, atol=1e-9)
    imu = recording(RIG, 1, 700.0, 20.0)
    told = imu_noise(Imu(imu.t_ns, imu.f_s, imu.w_s + [[1e-6]] * imu.t_s[:, None]))
    assert any("linear trend" in note and "rad/s" in note for note in told.notes)


@settings(max_examples=10, deadline=None)
@given(st.floats(1e-9, 1e6), st.integers(0, 1000))
def test_scaling_the_signal_scales_the_terms(scale, seed):
    y = noise_of(np.random.default_rng(seed), 4000, 10.0, 1.0, K=0.02)
    one, other = sensor_noise(y, 10.0), sensor_noise(scale * y, 10.0)
    for term in "NBK":
        assert one.terms[term].seen == other.terms[term].seen
        assert other.terms[term].limit == pytest.approx(scale * one.terms[term].limit, rel=1e-4)


def test_the_model_is_drawn_through_the_measured_points():
    found = sensor_noise(noise_of(np.random.default_rng(7), 50_000, 10.0, 1.0, K=0.05), 10.0)
    for axis in found.axes:
        np.testing.assert_allclose(np.sqrt(axis.model[:8]), np.sqrt(axis.allan.variance[:8]), rtol=0.15)
    np.testing.assert_allclose(model_variance("NK", np.array([3.0])), [[1 / 3.0, 1.0]])


# -- stillness


def moved(imu, first_s, last_s, amplitude=0.05, period_s=4.0):
    """The recording with a roll back and forth in between."""
    t = imu.t_s
    wave = np.where((t >= first_s) & (t < last_s), amplitude * np.sin(2 * np.pi * t / period_s), 0.0)
    tilt = np.where(
        (t >= first_s) & (t < last_s), amplitude * period_s / (2 * np.pi) * np.cos(2 * np.pi * t / period_s), 0
    )
    w, f = imu.w_s.copy(), imu.f_s.copy()
    w[:, 0] += wave
    f[:, 1] += 9.8 * tilt
    return Imu(imu.t_ns, f, w)


@pytest.mark.parametrize(
    ("first_s", "last_s", "still"), [(100, 400, (0, 100)), (0, 200, (200, 400)), (120, 140, (140, 400))]
)
@pytest.mark.parametrize("amplitude", [0.005, 0.5])
def test_the_longest_still_stretch_is_taken(first_s, last_s, still, amplitude):
    found = imu_noise(moved(recording(RIG, 9, 400.0, 50.0), first_s, last_s, amplitude))
    assert found.start_s == pytest.approx(still[0], abs=3.0)
    assert found.start_s + found.duration_s == pytest.approx(still[1], abs=3.0)
    assert found.fields["gyro_noise_density"].value == pytest.approx(RIG.gyro_noise_density, rel=0.03)


def test_a_moving_log_is_refused():
    for period_s in (2.0, 8.0):
        with pytest.raises(DataError, match="nothing of these 300 s is still"):
            imu_noise(moved(recording(RIG, 9, 300.0, 50.0), 0, 301, 0.01, period_s))


def test_a_knock_is_not_noise():
    imu = recording(RIG, 2, 300.0, 100.0)
    f = imu.f_s.copy()
    f[10_000:10_020] += np.random.default_rng(0).normal(0.0, 2.0, (20, 3))
    found = imu_noise(Imu(imu.t_ns, f, imu.w_s))
    assert found.start_s == pytest.approx(101.0, abs=1.5)


def test_a_shaking_sensor_shows_nothing():
    imu = recording(RIG, 2, 60.0, 100.0)
    hum = 0.01 * np.sin(2 * np.pi * 11.3 * imu.t_s)[:, None]
    found = imu_noise(Imu(imu.t_ns, imu.f_s, imu.w_s + hum))
    assert not found.fields["gyro_noise_density"].seen
    assert found.fields["accel_noise_density"].seen
    assert any(note.startswith("gyro") and "nothing is taken" in note for note in found.notes)


def test_gaps_end_a_stretch_and_lost_samples_are_told():
    imu = recording(RIG, 2, 400.0, 50.0)
    late = Imu(imu.t_ns + np.where(imu.t_s > 100.0, 20_000_000_000, 0), imu.f_s, imu.w_s)
    found = imu_noise(late)
    assert (found.start_s, found.duration_s) == (pytest.approx(120.0, abs=0.1), pytest.approx(299.0, abs=2.0))
    lost = imu.select(np.random.default_rng(1).random(len(imu)) > 0.05)
    found = imu_noise(lost)
    assert any("samples are missing" in note for note in found.notes)
    assert found.fields["gyro_noise_density"].value == pytest.approx(RIG.gyro_noise_density, rel=0.06)


def test_what_cannot_be_used_is_named():
    imu = recording(RIG, 2, 100.0, 50.0)
    dead = imu.w_s.copy()
    dead[:, 1] = 0.25
    with pytest.raises(DataError, match=r"w_y: never changes from 0\.25"):
        imu_noise(Imu(imu.t_ns, imu.f_s, dead), "log")
    with pytest.raises(DataError, match="accelerometer reads 1 m/s"):
        imu_noise(Imu(imu.t_ns, imu.f_s / 9.807, imu.w_s))
    with pytest.raises(DataError, match="not in order"):
        imu_noise(imu.select(slice(None, None, -1)))
    with pytest.raises(DataError, match="not finite"):
        imu_noise(Imu(imu.t_ns, imu.f_s, np.where(np.arange(3) == 1, np.nan, imu.w_s)))
    for count in (0, 1, 2, 40, 200):
        with pytest.raises(DataError, match="still"):
            imu_noise(imu.select(slice(0, count)))


def test_coarse_samples_are_still():
    imu = recording(RIG, 2, 200.0, 50.0)
    w = np.round(imu.w_s / 2e-3) * 2e-3
    assert imu_noise(Imu(imu.t_ns, imu.f_s, w)).duration_s > 190.0


# -- real recordings


@pytest.fixture
def recorded():
    def read(name):
        if not (DATA / name).exists():
            pytest.skip(f"no {DATA / name}: set UWGRAPH_DATA to the folder of the recordings")
        return read_imu(DATA / name)

    return read


@pytest.mark.data
@pytest.mark.parametrize("run", [1, 2, 4, 6, 7, 9, 12])
def test_a_vehicle_under_way_is_refused(recorded, run):
    imu, _ = recorded(f"snapir/Trajectory{run}")
    with pytest.raises(DataError, match="still"):
        imu_noise(imu)


@pytest.mark.data
def test_rotors_that_idle_are_no_noise(recorded):
    """Four seconds before take-off: still, but nothing that a rig should take."""
    imu, rig = recorded("euroc")
    found = imu_noise(imu)
    assert (found.start_s, found.duration_s) == (0.0, pytest.approx(4.0, abs=0.1))
    assert found.rig(rig.imu) == rig.imu


@pytest.mark.data
def test_twelve_seconds_on_deck(recorded):
    """The gyro of an autopilot's MEMS IMU; the accelerometer feels the deck."""
    imu, rig = recorded("ardusub/small.BIN")
    found = imu_noise(imu)
    assert 8.0 < found.duration_s < 14.0
    density = found.fields["gyro_noise_density"]
    assert density.seen
    assert 4e-5 < density.value < 1.2e-4
    assert found.rig(rig.imu).gyro_bias_walk == rig.imu.gyro_bias_walk


@pytest.mark.data
def test_a_dive_sampled_slowly_is_not_still(recorded):
    """Telemetry at 2 Hz: so slow that motion looks like noise from sample to sample."""
    imu, _ = recorded("ardusub/small.tlog")
    with pytest.raises(DataError, match="still"):
        imu_noise(imu)


@pytest.mark.slow
def test_three_hours_at_200_hz():
    rng, count = np.random.default_rng(0), 3 * 3600 * 200
    stamps = np.arange(count) * 5_000_000
    imu = Imu(
        stamps, f_s=rng.standard_normal((count, 3)) * 0.02 + GRAVITY_S, w_s=rng.standard_normal((count, 3)) * 1e-3
    )
    start = perf_counter()
    found = imu_noise(imu)
    assert perf_counter() - start < 20.0
    assert found.duration_s == pytest.approx(3 * 3600.0)
    tracemalloc.start()
    imu_noise(imu)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2 * (imu.f_s.nbytes + imu.w_s.nbytes)
