"""A single Doppler velocity; and every measurement asked for many states at once, as filters do."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
import pytest

import factors
from factors.adapter import Poses
from uwgraph.types import FloatArray

ARM = np.array([0.8, -0.4, 0.3])
EARTH_RATE = np.array([5e-5, 0.0, -5e-5])


def pose_of(rng: np.random.Generator) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), 20.0 * rng.normal(size=3))


def states(rng: np.random.Generator, count: int) -> list[tuple[Any, ...]]:
    """Pose, velocity, bias, calibration of the Doppler log."""
    return [
        (
            pose_of(rng),
            rng.normal(size=3),
            gtsam.imuBias.ConstantBias(0.1 * rng.normal(size=3), 0.01 * rng.normal(size=3)),
            0.05 * rng.normal(size=4),
        )
        for _ in range(count)
    ]


def velocity(rng: np.random.Generator, l_b: FloatArray = ARM) -> factors.DvlVelocity:
    return factors.DvlVelocity(rng.normal(size=3), np.diag([1e-4, 4e-4, 1e-4]), rng.normal(size=3), l_b, EARTH_RATE)


def test_its_jacobians_are_its_derivatives() -> None:
    rng = np.random.default_rng(0)
    factors.check_jacobians(velocity(rng), states(rng, 50), tolerance=1e-6)
    factors.check_jacobians(velocity(rng, np.zeros(3)), states(rng, 10), tolerance=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_zero_at_the_velocity_that_a_moving_body_has(seed: int) -> None:
    """The instrument's way on a turning body, differentiated: nothing of the formula is used."""
    rng = np.random.default_rng(seed)
    R, p, v_n, w_true = (
        gtsam.Rot3.Expmap(rng.normal(size=3)),
        rng.normal(size=3),
        rng.normal(size=3),
        rng.normal(size=3),
    )
    bias_gyro, c = 0.02 * rng.normal(size=3), 0.02 * rng.normal(size=4)

    def instrument(t: float) -> FloatArray:
        """The gyro tells turns against inertial space, of which n has its own part."""
        w_nb = w_true - R.unrotate(EARTH_RATE)
        return np.asarray(p + v_n * t + R.matrix() @ gtsam.Rot3.Expmap(w_nb * t).matrix() @ ARM)

    u = R.unrotate((instrument(1e-5) - instrument(-1e-5)) / 2e-5)
    measured = (1.0 + c[0]) * u + np.cross(c[1:], u)
    model = factors.DvlVelocity(measured, 1e-4 * np.eye(3), w_true + bias_gyro, ARM, EARTH_RATE)
    found = model.residual(gtsam.Pose3(R, p), v_n, gtsam.imuBias.ConstantBias(np.zeros(3), bias_gyro), c)
    np.testing.assert_allclose(found, 0.0, atol=1e-8)


def test_the_graph_solves_with_it() -> None:
    """Velocity from one ping, with everything else held: its own factor, for it has no native one."""
    rng = np.random.default_rng(3)
    pose, _, bias, c = states(rng, 1)[0]
    model = velocity(rng)
    keys = [gtsam.symbol(s, 0) for s in "xvbc"]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(model.lowered(keys))
    graph.push_back(gtsam.PriorFactorPose3(keys[0], pose, gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    graph.push_back(gtsam.PriorFactorConstantBias(keys[2], bias, gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    graph.push_back(gtsam.PriorFactorVector(keys[3], c, gtsam.noiseModel.Isotropic.Sigma(4, 1e-6)))
    for key, value in zip(keys, (pose, np.zeros(3), bias, c), strict=True):
        values.insert(key, value)
    for _ in range(5):
        values = values.retract(graph.linearize(values).optimize())
    np.testing.assert_allclose(model.residual(pose, values.atVector(keys[1]), bias, c), 0.0, atol=1e-6)


# Many states at once


def every_measurement(rng: np.random.Generator) -> dict[str, factors.Measurement]:
    tilted = gtsam.Rot3.RzRyRx(0.002, -0.001, 0.003).matrix()
    s_b, up_north = np.array([0.48, -0.6, 0.64]), np.array([0.6, 0.64, -0.48])
    unmeasured = np.diag([1.0, 2.0, np.inf])
    return {
        "depth": factors.Depth(12.3, 0.05, tilted[:, 2], np.array([5.0, -3.0, 11.0]), 11.01, ARM),
        "position": factors.PositionFix(rng.normal(size=3), np.eye(3), ARM),
        "position, horizontal": factors.PositionFix(rng.normal(size=3), unmeasured, ARM, tilted),
        "heading": factors.Heading(0.4, 0.02, 0.1, tilted),
        "sun scatter": factors.SunScatter((np.eye(3) - np.outer(s_b, s_b)) / 1e-4, up_north),
        "direction": factors.Direction(s_b, up_north, np.diag([1e-2, 4e-4]), tilted[:, 2]),
        "relative pose": factors.RelativePose(pose_of(rng), np.eye(6)),
        "dvl displacement": factors.DvlDisplacement(np.array([1.5, -0.3, 0.2]), np.eye(3), 0.01 * np.eye(3)),
        "dvl velocity": velocity(rng),
        "one's own": Range(np.array([3.0, 4.0, 5.0])),
    }


class Range(factors.Measurement):
    """Nothing but a residual and a noise."""

    variables = ("Pose3", "Vector", "ConstantBias")

    def __init__(self, place: FloatArray) -> None:
        self.place = place

    def residual(self, pose: gtsam.Pose3, v_n: FloatArray, bias: gtsam.imuBias.ConstantBias) -> FloatArray:
        return np.array([pose.range(self.place) + v_n[0] - bias.gyroscope()[1] - 2.0 * bias.accelerometer()[2]])

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Isotropic.Sigma(1, 0.5)


NAMES = list(every_measurement(np.random.default_rng(0)))


@pytest.mark.parametrize("name", NAMES)
def test_many_states_at_once_are_each_alone(name: str) -> None:
    rng = np.random.default_rng(1)
    measurement = every_measurement(rng)[name]
    drawn = states(rng, 20)
    columns = {"Pose3": 0, "ConstantBias": 2}
    others = [pose_of(rng) for _ in drawn]

    def variables(n: int) -> list[Any]:
        """In the model's order; the second pose, and the vectors by their lengths."""
        chosen: list[Any] = []
        for kind in measurement.variables:
            if kind == "Vector":
                chosen.append(drawn[n][3 if "Vector" in measurement.variables[: len(chosen)] else 1])
            elif kind == "Pose3" and chosen and isinstance(chosen[0], gtsam.Pose3):
                chosen.append(others[n])
            else:
                chosen.append(drawn[n][columns[kind]])
        return chosen

    each = [variables(n) for n in range(len(drawn))]
    together = measurement.residuals(*(as_arrays(of_kind) for of_kind in zip(*each, strict=True)))
    alone = np.stack([measurement.residual(*x) for x in each])
    assert together.shape == alone.shape
    assert np.abs(alone).max() > 1e-3
    np.testing.assert_allclose(together, alone, rtol=1e-9, atol=1e-9)


def as_arrays(variables: tuple[Any, ...]) -> Any:
    if isinstance(variables[0], gtsam.Pose3):
        return Poses(
            np.stack([x.rotation().matrix() for x in variables]), np.stack([x.translation() for x in variables])
        )
    return np.stack([x.vector() if isinstance(x, gtsam.imuBias.ConstantBias) else x for x in variables])


def test_ones_own_measurement_lowers_to_its_reference() -> None:
    keys = [gtsam.symbol(s, 0) for s in "xvb"]
    factor = Range(np.zeros(3)).lowered(keys, gtsam.noiseModel.mEstimator.Huber.Create(1.0))
    assert isinstance(factor, gtsam.CustomFactor)
    values = gtsam.Values()
    values.insert(keys[0], gtsam.Pose3(gtsam.Rot3(), np.array([3.0, 0.0, 0.0])))
    values.insert(keys[1], np.zeros(3))
    values.insert(keys[2], gtsam.imuBias.ConstantBias())
    assert factor.error(values) == pytest.approx(6.0 - 0.5)
