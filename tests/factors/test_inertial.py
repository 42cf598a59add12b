"""Preintegration against exact kinematics on the rotating Earth."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import factors
from factors.inertial import InertialMotion, integration_steps

NS = 1_000_000_000
LAT = np.radians(40.0)
EARTH = 7.292115e-5 * np.array([np.cos(LAT), 0.0, -np.sin(LAT)])
GRAVITY = np.array([0.0, 0.0, 9.8])
NOISE = factors.ImuNoise(5e-5, 5e-4, 1e-7, 1e-5)
NO_BIAS = gtsam.imuBias.ConstantBias()
KEYS = tuple(range(6))
START_NS = 1_700_000_000 * NS
FAR = np.array([9_000.0, -4_000.0, 50.0])


class Wobble:
    """A helix with strong roll, pitch and heading wobble, analytic, far from the origin of n."""

    @staticmethod
    def R_nb(t: np.ndarray) -> np.ndarray:
        rph = np.stack([0.15 * np.sin(2.1 * t), 0.1 * np.sin(1.7 * t + 0.3), 0.3 * t + 0.2 * np.sin(0.9 * t)], -1)
        return Rotation.from_euler("ZYX", rph[..., ::-1]).as_matrix()

    @classmethod
    def rate(cls, t: np.ndarray) -> np.ndarray:
        roll, pitch = 0.15 * np.sin(2.1 * t), 0.1 * np.sin(1.7 * t + 0.3)
        d_roll, d_pitch, d_yaw = 0.315 * np.cos(2.1 * t), 0.17 * np.cos(1.7 * t + 0.3), 0.3 + 0.18 * np.cos(0.9 * t)
        body = np.stack(
            [
                d_roll - np.sin(pitch) * d_yaw,
                np.cos(roll) * d_pitch + np.sin(roll) * np.cos(pitch) * d_yaw,
                -np.sin(roll) * d_pitch + np.cos(roll) * np.cos(pitch) * d_yaw,
            ],
            -1,
        )
        return body + np.einsum("nji,j->ni", cls.R_nb(t), EARTH)

    @staticmethod
    def p(t: np.ndarray) -> np.ndarray:
        return FAR + np.stack([20 * np.sin(0.1 * t), 20 * np.cos(0.1 * t), 0.2 * t + 0.3 * np.sin(1.3 * t)], -1)

    @staticmethod
    def v(t: np.ndarray) -> np.ndarray:
        return np.stack([2 * np.cos(0.1 * t), -2 * np.sin(0.1 * t), 0.2 + 0.39 * np.cos(1.3 * t)], -1)

    @classmethod
    def force(cls, t: np.ndarray) -> np.ndarray:
        a = np.stack([-0.2 * np.sin(0.1 * t), -0.2 * np.cos(0.1 * t), -0.507 * np.sin(1.3 * t)], -1)
        return np.einsum("nji,nj->ni", cls.R_nb(t), a + 2.0 * np.cross(EARTH, cls.v(t)) - GRAVITY)


def mean_samples(rate: float, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps [ns], and means of force and rate over (t_{i-1}, t_i] by Gauss quadrature."""
    edges = np.arange(round(rate * duration) + 1) / rate
    nodes, weights = np.polynomial.legendre.leggauss(5)
    inner = [edges[:-1] + (x + 1.0) / (2.0 * rate) for x in nodes]
    f = sum(w / 2.0 * Wobble.force(t) for w, t in zip(weights, inner, strict=True))
    w = sum(w / 2.0 * Wobble.rate(t) for w, t in zip(weights, inner, strict=True))
    return stamps(edges[1:]), f, w


def stamps(seconds: np.ndarray) -> np.ndarray:
    return START_NS + np.rint(seconds * NS).astype(np.int64)


def pose_at(t: float) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(Wobble.R_nb(np.array(t))), Wobble.p(np.array(t)))


def dead_reckoning_error(rate: float, keyframes: np.ndarray, samples_per_step: int) -> tuple[float, float]:
    """Error of position [m] and attitude [rad] at the last keyframe."""
    t_ns, f, w = mean_samples(rate, keyframes[-1])
    params = [factors.preintegration_params(NOISE, GRAVITY, EARTH, p) for p in Wobble.p(keyframes[:-1])]
    state = gtsam.NavState(pose_at(keyframes[0]), Wobble.v(keyframes[0]))
    for pim in factors.preintegrate(params, t_ns, f, w, stamps(keyframes), NO_BIAS, samples_per_step):
        state = pim.predict(state, NO_BIAS)
    error = pose_at(keyframes[-1]).between(state.pose())
    return float(np.linalg.norm(error.translation())), float(np.linalg.norm(gtsam.Rot3.Logmap(error.rotation())))


def test_the_error_is_small_and_of_high_order() -> None:
    keyframes = np.arange(0.0, 21.0)
    position, attitude = zip(*(dead_reckoning_error(rate, keyframes, 4) for rate in (50.0, 100.0)), strict=True)
    assert position[1] < 5e-4
    assert attitude[1] < 5e-8
    assert position[0] > 3.5 * position[1]
    assert attitude[0] > 12.0 * attitude[1]


def test_fewer_samples_per_step_are_more_exact() -> None:
    keyframes = np.arange(0.0, 11.0)
    errors = np.array([dead_reckoning_error(50.0, keyframes, m) for m in (1, 2, 8)])
    assert np.all(errors[0] < errors[2])
    assert np.all(errors[1] < errors[2])


def test_keyframes_inside_samples_cost_no_accuracy() -> None:
    aligned = np.arange(0.0, 21.0)
    shifted = np.concatenate([[0.0], aligned[1:-1] + 0.0043, [20.0]])
    position, attitude = dead_reckoning_error(100.0, shifted, 4)
    assert position < 5e-4
    assert attitude < 5e-8


def test_a_split_sample_is_still_the_sample() -> None:
    t_ns, f, w = mean_samples(100.0, 2.0)
    keyframes = np.array([0.0, 0.333, 1.0017, 1.0042, 2.0])
    steps = integration_steps(t_ns, f, w, stamps(keyframes), samples_per_step=1)
    assert steps.dt.sum() == pytest.approx(2.0, abs=1e-12)
    np.testing.assert_allclose(np.add.reduceat(steps.dt, steps.first[:-1]), np.diff(keyframes), atol=1e-9)
    np.testing.assert_allclose(steps.dt @ steps.w_b, w.sum(axis=0) * 0.01, atol=2e-5)


@pytest.mark.parametrize("rph", [(0.0, 0.0, 0.0), (0.3, -0.2, 2.0)])
def test_a_resting_imu_stays_where_it_is(rph: tuple[float, float, float]) -> None:
    R = gtsam.Rot3.RzRyRx(*rph)
    t_ns, keyframes = stamps(np.arange(1, 6001) / 10.0), stamps(np.arange(0.0, 601.0))
    f = np.tile(R.unrotate(-GRAVITY), (6000, 1))
    w = np.tile(R.unrotate(EARTH), (6000, 1))

    def drift(earth: np.ndarray, place: np.ndarray) -> tuple[float, float]:
        state = gtsam.NavState(R, FAR, np.zeros(3))
        params = factors.preintegration_params(NOISE, GRAVITY, earth, place)
        for pim in factors.preintegrate(params, t_ns, f, w, keyframes, NO_BIAS):
            state = pim.predict(state, NO_BIAS)
        turned = gtsam.Rot3.Logmap(R.between(state.attitude()))
        return float(np.linalg.norm(state.position() - FAR)), float(np.linalg.norm(turned))

    assert drift(EARTH, FAR) == pytest.approx((0.0, 0.0), abs=1e-4)
    assert drift(EARTH, np.zeros(3))[0] > 5.0, "gravity would count the centrifugal force twice"
    assert drift(np.zeros(3), FAR)[0] > 5_000.0


def test_a_body_in_free_fall_goes_down() -> None:
    params = factors.preintegration_params(NOISE, GRAVITY, np.zeros(3))
    zeros = np.zeros((100, 3))
    (pim,) = factors.preintegrate(
        params, stamps(np.arange(1, 101) / 100.0), zeros, zeros, stamps(np.array([0.0, 1.0])), NO_BIAS
    )
    state = pim.predict(gtsam.NavState(), NO_BIAS)
    np.testing.assert_allclose(state.position(), [0.0, 0.0, 4.9], atol=1e-9)
    np.testing.assert_allclose(state.velocity(), [0.0, 0.0, 9.8], atol=1e-9)


def test_the_bias_is_taken_off() -> None:
    t_ns, f, w = mean_samples(100.0, 2.0)
    bias = gtsam.imuBias.ConstantBias(np.array([0.05, -0.1, 0.08]), np.array([1e-2, -2e-2, 1e-2]))
    keyframes = stamps(np.array([0.0, 2.0]))
    params = factors.preintegration_params(NOISE, GRAVITY, EARTH)
    (clean,) = factors.preintegrate(params, t_ns, f, w, keyframes, NO_BIAS)
    biased = f + bias.accelerometer(), w + bias.gyroscope()
    (seen,) = factors.preintegrate(params, t_ns, *biased, keyframes, bias)
    np.testing.assert_allclose(seen.deltaPij(), clean.deltaPij(), atol=1e-10)
    np.testing.assert_allclose(seen.deltaRij().matrix(), clean.deltaRij().matrix(), atol=1e-12)


def test_the_noise_is_that_of_the_densities() -> None:
    resting = np.tile(-GRAVITY, (400, 1))
    params = factors.preintegration_params(NOISE, GRAVITY, np.zeros(3))
    (pim,) = factors.preintegrate(
        params, stamps(np.arange(1, 401) / 100.0), resting, 0 * resting, stamps(np.array([0.0, 4.0])), NO_BIAS
    )
    sigma = np.sqrt(np.diag(pim.residualCovariance()))
    assert sigma[:3] == pytest.approx(5e-5 * 2.0, rel=1e-3)
    assert sigma[8] == pytest.approx(5e-4 * 2.0, rel=2e-3)
    assert sigma[9:] == pytest.approx([1e-5 * 2.0] * 3 + [1e-7 * 2.0] * 3, rel=1e-3)


def test_the_covariance_is_that_of_the_scatter() -> None:
    rng = np.random.default_rng(6)
    noise = factors.ImuNoise(2e-4, 2e-3, 1e-9, 1e-9)
    t_ns, f, w = mean_samples(100.0, 2.0)
    params = factors.preintegration_params(noise, GRAVITY, EARTH, FAR)
    states = pose_at(0.0), Wobble.v(np.array(0.0)), pose_at(2.0), Wobble.v(np.array(2.0)), NO_BIAS, NO_BIAS
    squares = []
    for _ in range(300):
        noisy = f + rng.normal(size=f.shape) * 2e-3 * 10.0, w + rng.normal(size=w.shape) * 2e-4 * 10.0
        (pim,) = factors.preintegrate(params, t_ns, *noisy, stamps(np.array([0.0, 2.0])), NO_BIAS)
        factor = factors.imu_factor(KEYS, pim)
        squares.append(np.sum(factor.noiseModel().whiten(factor.evaluateError(*states)) ** 2))
    assert np.mean(squares) / 9.0 == pytest.approx(1.0, abs=0.1)


# The factor


def motion(bias: gtsam.imuBias.ConstantBias, duration: float = 1.0) -> InertialMotion:
    t_ns, f, w = mean_samples(100.0, duration)
    steps = integration_steps(t_ns, f, w, stamps(np.array([0.0, duration])), bias)
    return InertialMotion(steps, NOISE, GRAVITY, EARTH, FAR, bias)


def random_values(measurement: InertialMotion, rng: np.random.Generator, bias_off: float) -> gtsam.Values:
    bias = measurement.bias.retract(bias_off * rng.normal(size=6))
    pose, v = pose_at(0.0).retract(rng.normal(size=6)), rng.normal(size=3)
    end, v_end = measurement.predict(pose, v, bias)
    values = gtsam.Values()
    states = (pose, v, end.retract(rng.normal(size=6) * 0.1), v_end + rng.normal(size=3) * 0.1)
    for key, x in zip(KEYS, (*states, bias, bias.retract(rng.normal(size=6) * 1e-4)), strict=True):
        values.insert(key, x)
    return values


def test_gtsam_predicts_what_the_independent_model_predicts() -> None:
    measurement = motion(gtsam.imuBias.ConstantBias(np.array([0.02, 0.01, -0.03]), np.array([1e-4, -2e-4, 3e-4])))
    pose, v = pose_at(0.0), Wobble.v(np.array(0.0))
    end, v_end = measurement.predict(pose, v, measurement.bias)
    state = measurement.pim().predict(gtsam.NavState(pose, v), measurement.bias)
    assert state.pose().equals(end, 1e-10)
    np.testing.assert_allclose(state.velocity(), v_end, atol=1e-10)


def test_the_imu_factor_equals_the_reference() -> None:
    rng = np.random.default_rng(4)
    measurement = motion(gtsam.imuBias.ConstantBias(np.array([0.02, 0.01, -0.03]), np.array([1e-4, -2e-4, 3e-4])))
    values = [random_values(measurement, rng, bias_off=0.0) for _ in range(3)]
    factors.check_equivalence(measurement.reference(KEYS), measurement.lowered(KEYS), values, tolerance=1e-6)
    loss = gtsam.noiseModel.mEstimator.Cauchy.Create(1.0)
    factors.check_equivalence(
        measurement.reference(KEYS, loss), measurement.lowered(KEYS, loss), values, tolerance=1e-6
    )


def test_the_imu_factor_corrects_a_change_of_bias_to_first_order() -> None:
    rng = np.random.default_rng(4)
    measurement = motion(NO_BIAS)
    lowered = measurement.lowered(KEYS)
    off = rng.normal(size=6) * np.repeat([0.1, 1e-2], 3)

    def difference(scale: float) -> float:
        bias = gtsam.imuBias.ConstantBias(scale * off[:3], scale * off[3:])
        state = (pose_at(0.0), np.ones(3), pose_at(1.0), np.ones(3), bias, bias)
        return float(np.abs(measurement.residual(*state) - lowered.evaluateError(*state)).max())

    assert difference(1.0) < 1e-3
    assert difference(1.0) / difference(0.5) == pytest.approx(4.0, rel=0.1)


# Rotation alone


def test_the_rotation_history_is_exact_at_any_time() -> None:
    t_ns, _, w = mean_samples(100.0, 30.0)
    at = np.sort(np.random.default_rng(0).uniform(0.0, 30.0, size=200))
    w_nb = w - np.einsum("nji,j->ni", Wobble.R_nb(np.arange(3000) / 100.0 + 0.005), EARTH)
    R = factors.rotation_history(t_ns, w_nb, stamps(at))
    truth = Wobble.R_nb(at[:1]).swapaxes(1, 2) @ Wobble.R_nb(at)
    angle = Rotation.from_matrix(R.swapaxes(1, 2) @ truth).magnitude()
    assert angle.max() < 3e-7


# Bad input


@pytest.mark.parametrize(
    ("t_s", "keyframes", "problem"),
    [
        ([0.1, 0.3, 0.2], [0.1, 0.2], "increase"),
        ([0.1], [0.0, 0.1], "increase"),
        ([0.1, 0.2, 0.3], [0.2, 0.1], "increase"),
        ([0.1, 0.2, 0.3], [0.1, 0.4], "covers"),
        ([0.1, 0.2, 0.3], [-0.1, 0.2], "covers"),
    ],
)
def test_bad_stamps_are_refused(t_s: list[float], keyframes: list[float], problem: str) -> None:
    zeros = np.zeros((len(t_s), 3))
    with pytest.raises(ValueError, match=problem):
        integration_steps(stamps(np.array(t_s)), zeros, zeros, stamps(np.array(keyframes)))
