"""Statistics of the inertial errors against what the rig states."""

import numpy as np
import pytest

from uwgraph.simulate import GRADES, ImuGrade
from uwgraph.simulate.imu import add_noise, imu_errors, with_errors
from uwgraph.simulate.noise import Noise
from uwgraph.types import Imu

RATE = 100.0
DT = np.full(60_000, 1.0 / RATE)


@pytest.mark.parametrize("grade", ["fog", "mems"])
def test_white_noise_averages_down_with_its_density(grade):
    """The mean over T has sigma density/sqrt(T), at every T: the slope -1/2 of the Allan deviation."""
    rig = GRADES[grade].rig
    errors = imu_errors(GRADES[grade], DT, Noise.of(1, "imu"))
    for white, density in (
        (errors.gyro - errors.gyro_bias, rig.gyro_noise_density),
        (errors.accel - errors.accel_bias, rig.accel_noise_density),
    ):
        for count in (1, 10, 100, 500):
            means = white.reshape(-1, count, 3).mean(axis=1)
            assert means.std() == pytest.approx(density / np.sqrt(count / RATE), rel=3.0 / np.sqrt(2 * means.size))


def test_bias_starts_and_walks_as_stated():
    grade = GRADES["mems"]
    dt = np.full(1000, 0.1)
    biases = np.stack([imu_errors(grade, dt, Noise.of(seed, "imu")).gyro_bias for seed in range(300)])
    assert biases[:, 0].std() == pytest.approx(grade.rig.gyro_bias_sigma, rel=0.1)
    assert np.degrees(grade.rig.gyro_bias_sigma) * 3600 == pytest.approx(20.0)
    assert np.degrees(grade.rig.gyro_noise_density) * 60 == pytest.approx(0.3)
    for steps in (100, 900):
        walk = biases[:, steps] - biases[:, 0]
        assert walk.std() == pytest.approx(grade.rig.gyro_bias_walk * np.sqrt(0.1 * steps), rel=0.1)


def test_instability_keeps_its_size_and_the_rig_states_it():
    rig = GRADES["noise_free"].rig
    grade = ImuGrade(rig=rig, gyro_instability=1e-5, instability_time_s=20.0)
    dt = np.full(2000, 0.1)
    biases = np.stack([imu_errors(grade, dt, Noise.of(seed, "imu")).gyro_bias for seed in range(200)])
    assert biases[:, 0].std() == pytest.approx(1e-5, rel=0.1)
    assert biases[:, -1].std() == pytest.approx(1e-5, rel=0.1)
    correlation = np.mean(biases[:, 0] * biases[:, 200]) / 1e-10
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.12)
    stated = grade.stated(10.0)
    short = (biases[:, 10] - biases[:, 0]).std()
    assert short == pytest.approx(stated.gyro_bias_walk * 1.0, rel=0.1)
    assert stated.gyro_bias_sigma == pytest.approx(1e-5, rel=1e-3)


def test_quantisation_rounds_and_is_stated_as_white_noise():
    grade = ImuGrade(rig=GRADES["mems"].rig, gyro_step=1e-3)
    errors = imu_errors(grade, DT, Noise.of(1, "imu"))
    ideal = Imu(np.arange(len(DT)), f_s=np.zeros((len(DT), 3)), w_s=np.zeros((len(DT), 3)))
    w = with_errors(ideal, errors, grade).w_s
    np.testing.assert_allclose(w / 1e-3, np.round(w / 1e-3), atol=1e-9)
    stated = grade.stated(RATE).gyro_noise_density * np.sqrt(RATE)
    assert (w - errors.gyro_bias).std() == pytest.approx(stated, rel=0.01)


def test_noise_free_adds_nothing_but_states_something():
    errors = imu_errors(GRADES["noise_free"], DT, Noise.of(1, "imu", silent=True))
    assert not errors.gyro.any()
    assert not errors.accel.any()
    assert GRADES["noise_free"].stated(RATE).gyro_noise_density > 0.0


def test_added_noise_adds_in_variance():
    rig = GRADES["mems"].rig
    both = add_noise(rig, rig.model_dump())
    assert both.gyro_bias_walk == pytest.approx(np.sqrt(2.0) * rig.gyro_bias_walk)
    assert both.gyro_range == rig.gyro_range
