"""A dive in, a trajectory with honest covariance out: against the truth of simulated dives, and on real ones."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from graph_dives import Truth, turned

from uwgraph.dive import Dive
from uwgraph.dive.importing import read_recording
from uwgraph.dive.rig import DepthRig, DvlRig, FixesRig
from uwgraph.errors import DataError
from uwgraph.evaluate import judge, nees_bounds
from uwgraph.frames import matrix_from_rph
from uwgraph.graph import SmoothSettings, resample, smooth
from uwgraph.simulate import (
    DepthModel,
    DvlModel,
    GnssModel,
    SimulationSettings,
    add_depth,
    add_dvl,
    add_sun_heading,
    simulate,
)
from uwgraph.types import FloatArray, Solution

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
AUTO = SmoothSettings()
REFERENCE = SmoothSettings(initial="reference")
TURNING = SimulationSettings(duration_s=300.0, leg_length_m=40.0, line_spacing_m=20.0)


def real(name: str) -> Dive:
    if not (DATA / name).is_dir():
        pytest.skip(f"no {DATA / name}: set UWGRAPH_DATA to the folder of the recordings")
    return read_recording(DATA / name).dive


def noise_free(**update: object) -> Truth:
    return Truth.of(TURNING.model_copy(update={"grade": "noise_free", **update}))


def errors(truth: Truth, solution: Solution) -> tuple[float, float]:
    """Largest position [m] and attitude error [deg]."""
    position = np.linalg.norm(solution.p_n - truth.p_n(solution.t_ns), axis=1).max()
    attitude = turned(solution.R_nb, truth.R_nb(solution.t_ns)).max()
    return float(position), float(np.degrees(attitude))


@pytest.mark.parametrize("settings", [AUTO, REFERENCE, SmoothSettings(dvl_calibration=False)])
def test_ten_minutes_without_noise(settings: SmoothSettings) -> None:
    truth = noise_free(duration_s=600.0)
    solution = smooth(truth.dive, settings)
    assert solution.info["converged"]
    position, attitude = errors(truth, solution)
    assert position < 0.02
    assert attitude < 0.01
    speed = np.linalg.norm(solution.v_n - truth.v_n(solution.t_ns), axis=1)
    assert speed.max() < 0.005


def test_lever_arms_of_all_sensors() -> None:
    """Every sensor a metre or two from the IMU; taking an arm's sign wrong costs decimetres."""
    truth = noise_free(
        dvl=DvlModel(rig=DvlRig(translation_m=(1.5, -0.4, 0.6), rotation_deg=(0.0, 0.0, 45.0))),
        depth_sensor=DepthModel(rig=DepthRig(translation_m=(-2.0, 0.3, -0.5))),
        gnss=GnssModel(rig=FixesRig(translation_m=(1.0, 0.5, -1.2), sigma=0.1)),
    )
    solution = smooth(truth.dive, REFERENCE)
    position, attitude = errors(truth, solution)
    assert position < 0.02
    assert attitude < 0.01
    for sensor in ("dvl", "depth", "fixes"):
        rig = getattr(truth.dive.rig, sensor)
        wrong = rig.model_copy(update={"translation_m": tuple(-x for x in rig.translation_m)})
        mounted = replace(truth.dive, rig=truth.dive.rig.model_copy(update={sensor: wrong}))
        assert errors(truth, smooth(mounted, REFERENCE))[0] > 0.05, sensor


def test_pings_once_a_second_in_turns() -> None:
    """Between such pings only the accelerometer knows that the way bends."""
    truth = noise_free(dvl=DvlModel(rate_hz=1.0), turn_rate_deg_s=9.0)
    position, attitude = errors(truth, smooth(truth.dive, REFERENCE))
    assert position < 0.02
    assert attitude < 0.01


def test_a_minute_without_dvl() -> None:
    truth = noise_free(dvl=DvlModel(lost_s=((100.0, 160.0),)))
    solution = smooth(truth.dive, REFERENCE)
    assert solution.info["factors"]["dvl"] < len(solution) - 55
    position, attitude = errors(truth, solution)
    assert position < 0.02
    assert attitude < 0.01
    noisy = smooth(simulate(TURNING.model_copy(update={"dvl": DvlModel(lost_s=((100.0, 160.0),))})), REFERENCE)
    sigma = np.sqrt(np.linalg.eigvalsh(noisy.cov_v)[:, -1])
    seconds = (noisy.t_ns - noisy.t_ns[0]) * 1e-9
    assert sigma[np.abs(seconds - 130.0) < 1].min() > 3.0 * sigma[np.abs(seconds - 80.0) < 1].max()


def test_pings_that_contradict_their_neighbours_cost_nothing() -> None:
    """One ping in five is wrong by 1 m/s, and the bottom is lost now and then."""
    dvl = DvlModel(outlier_fraction=0.2, losses_per_hour=60.0)
    dive = simulate(TURNING.model_copy(update={"grade": "fog", "dvl": dvl}))
    solution = smooth(dive, REFERENCE)
    clean = judge(dive, smooth(simulate(TURNING.model_copy(update={"grade": "fog"})), REFERENCE)).metrics
    found = judge(dive, solution).metrics
    assert dive.dvl is not None
    assert 0.15 < solution.info["dvl_pings_refused"] / dive.dvl.valid.sum() < 0.25
    assert found["horizontal_rmse_m"] < clean["horizontal_rmse_m"] + 0.1
    assert found["nees_position"] < 3.0


def test_robust_losses_keep_what_least_squares_gives_away() -> None:
    """One sun direction in ten is turned by 30 degrees."""
    dive = simulate(TURNING)
    assert dive.sun is not None
    turn = np.broadcast_to(np.eye(3), (len(dive.sun), 3, 3)).copy()
    turn[::10] = matrix_from_rph(np.radians([0.0, 0.0, 30.0]))
    information = turn @ dive.sun.information_b @ np.swapaxes(turn, 1, 2)
    s_b = (turn @ dive.sun.s_b[:, :, None])[..., 0]
    wrong = replace(dive, sun=replace(dive.sun, information_b=information, s_b=s_b))
    heading = {
        loss: judge(dive, smooth(wrong, SmoothSettings(initial="reference", loss=loss))).metrics["heading_rmse_deg"]
        for loss in ("none", "huber", "cauchy")
    }
    assert heading["huber"] < 0.3 * heading["none"]
    assert heading["cauchy"] < 0.1 * heading["none"]


def test_between_keyframes_it_is_the_imu_that_tells() -> None:
    truth = noise_free()
    solution = smooth(truth.dive, REFERENCE)
    stamps = solution.t_ns[0] + np.arange(1, int(299.0 / 0.037)) * 37_000_000
    dense = resample(truth.dive, solution, stamps)
    position, attitude = errors(truth, dense)
    assert position < 0.03
    assert attitude < 0.01
    at_keyframes = resample(truth.dive, solution, solution.t_ns)
    np.testing.assert_allclose(at_keyframes.p_n, solution.p_n, atol=1e-9)
    np.testing.assert_allclose(at_keyframes.R_nb, solution.R_nb, atol=1e-9)
    np.testing.assert_allclose(at_keyframes.cov_pose, solution.cov_pose, rtol=1e-6, atol=1e-15)
    k = np.searchsorted(solution.t_ns, stamps, side="right") - 1
    np.testing.assert_allclose(cov_p_n(dense), cov_p_n(solution)[k], rtol=1e-6, atol=1e-12)


def cov_p_n(solution: Solution) -> FloatArray:
    """Covariance of the position in n: what is known does not depend on where the body looks."""
    return solution.R_nb @ solution.cov_pose[:, 3:, 3:] @ np.swapaxes(solution.R_nb, 1, 2)


@pytest.fixture(scope="module")
def mems() -> Dive:
    return simulate(TURNING.model_copy(update={"duration_s": 120.0}), seed=5)


def test_covariances_when_asked(mems: Dive) -> None:
    without = smooth(mems, AUTO.model_copy(update={"covariances": False}))
    for cov in (without.cov_pose, without.cov_v, without.cov_bias):
        assert np.isnan(cov).all()
    assert not any(name.endswith("_sigma") for name in without.calibration)
    solution = smooth(mems)
    np.testing.assert_array_equal(solution.p_n, without.p_n)
    for cov in (solution.cov_pose, solution.cov_v, solution.cov_bias):
        assert (np.linalg.eigvalsh(cov)[:, 0] > 0.0).all()
    assert solution.calibration["dvl_scale_error_sigma"] < mems.rig.dvl.scale_sigma


def test_the_drawn_errors_are_found(mems: Dive) -> None:
    """Biases and the DVL's scale lie within four of their stated sigmas, and those are smaller than the prior's."""
    solution, drawn = smooth(mems), mems.provenance["drawn"]
    sigma = np.sqrt(np.diagonal(solution.cov_bias[0]))
    found = np.concatenate([solution.bias_accel[0], solution.bias_gyro[0]])
    error = found - np.concatenate([drawn["accel_bias"], drawn["gyro_bias"]])
    assert (np.abs(error) < 4.0 * sigma).all()
    assert (sigma[3:] < mems.rig.imu.gyro_bias_sigma).all()
    # what the instrument reads is 1 / (1 + scale) of the truth
    scale = -drawn["dvl_scale"] - solution.calibration["dvl_scale_error_estimate"]
    assert abs(scale) < 4.0 * solution.calibration["dvl_scale_error_sigma"]


def test_progress_names_its_stages(mems: Dive) -> None:
    told: list[tuple[str, float]] = []
    smooth(mems, progress=lambda stage, done: told.append((stage, done)))
    stages = list(dict.fromkeys(stage for stage, _ in told))
    assert stages == ["reading the streams", "building the graph", "solving", "covariances", "done"]
    assert all(0.0 <= done <= 1.0 for _, done in told)


def test_the_log_holds_what_happened(mems: Dive) -> None:
    info = smooth(mems).info
    assert info["keyframes"] == 121
    assert info["factors"]["imu"] == 120
    assert info["converged"]
    assert info["iterations"][0]["number"] == 0
    assert info["runtime_s"] > 0.0


def test_without_an_imu_nothing_is_smoothed(mems: Dive) -> None:
    with pytest.raises(DataError, match="no IMU samples"):
        smooth(replace(mems, imu=None))


@pytest.mark.slow
def test_the_covariance_is_honest() -> None:
    """Six dives; the bounds hold 99.9 times in 100, as one seed in twenty would fail those of 95 %."""
    runs = [simulate(TURNING.model_copy(update={"duration_s": 600.0}), seed) for seed in range(6)]
    figures = [judge(dive, smooth(dive, REFERENCE)).metrics for dive in runs]
    for name, dof in (("position", 3), ("heading", 1), ("attitude", 3)):
        low, high = nees_bounds(dof, runs=len(runs), confidence=0.999)
        assert low < np.mean([m[f"nees_{name}"] for m in figures]) < high, name


@pytest.mark.data
def test_a_real_dive_of_the_snapir() -> None:
    dive = real("snapir/Trajectory6")
    m = judge(dive, smooth(dive, REFERENCE)).metrics
    assert m["horizontal_rmse_m"] <= 2.5
    assert m["heading_rmse_deg"] <= 0.15


@pytest.mark.data
def test_a_real_imu_in_fast_motion() -> None:
    """EuRoC's drone: a gyro bias of 4.5 deg/s that nobody tells; velocity, depth and heading are simulated.

    Its reference and its IMU disagree by 0.2 deg in every angle, with or without a heading aid.
    """
    dive = add_sun_heading(add_depth(add_dvl(real("euroc"))))
    solution = smooth(dive, REFERENCE)
    assert solution.info["converged"]
    m = judge(dive, solution).metrics
    assert m["horizontal_rmse_m"] <= 0.3
    assert m["heading_rmse_deg"] <= 0.4
    assert np.degrees(np.linalg.norm(solution.bias_gyro[-1])) == pytest.approx(4.6, abs=0.5)
