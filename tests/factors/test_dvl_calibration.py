"""The DVL's calibration as a variable: one interval, all intervals at once, and the bend between pings."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from scipy.spatial.transform import Rotation

import factors
from factors.adapter import Loss

estimator = gtsam.noiseModel.mEstimator
NS = 1_000_000_000
CALIBRATION = gtsam.symbol("c", 0)
COUNT = 12


def random_pose(rng: np.random.Generator) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(Rotation.random(rng=rng).as_matrix()), rng.uniform(-50.0, 50.0, 3))


def intervals(rng: np.random.Generator, loss: Loss | None = None) -> factors.CalibratedDisplacements:
    root = rng.normal(size=(COUNT, 3, 3)) * 0.1
    return factors.CalibratedDisplacements(
        [X(k) for k in range(COUNT)],
        [X(k + 1) for k in range(COUNT)],
        CALIBRATION,
        rng.normal(size=(COUNT, 3)),
        0.2 * rng.normal(size=(COUNT, 3)),
        Rotation.random(COUNT, rng=rng).as_matrix(),
        root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(3),
        loss,
    )


def values(rng: np.random.Generator) -> gtsam.Values:
    drawn = gtsam.Values()
    for k in range(COUNT + 1):
        drawn.insert(X(k), random_pose(rng))
    drawn.insert(CALIBRATION, rng.normal(size=factors.CALIBRATION_DIM) * 0.1)
    return drawn


def test_jacobians() -> None:
    rng = np.random.default_rng(0)
    block = intervals(rng)
    for k in range(COUNT):
        states = [(random_pose(rng), random_pose(rng), rng.normal(size=4) * 0.1) for _ in range(5)]
        factors.check_jacobians(block.measurement(k), states, tolerance=1e-6)


@pytest.mark.parametrize(
    "loss",
    [None, estimator.Huber.Create(2.8), estimator.Huber.Create(200.0), estimator.Cauchy.Create(200.0)],
    ids=["no loss", "all beyond the width", "some beyond it", "Cauchy"],
)
def test_all_at_once_equals_the_sum_of_the_references(loss: Loss | None) -> None:
    rng = np.random.default_rng(1)
    block = intervals(rng, loss)
    graph = gtsam.NonlinearFactorGraph()
    for k in range(COUNT):
        graph.push_back(block.measurement(k).reference((X(k), X(k + 1), CALIBRATION), loss))
    for _ in range(5):
        v = values(rng)
        assert block.error(v) == pytest.approx(graph.error(v), rel=1e-12)
        ours, theirs = gtsam.GaussianFactorGraph(), graph.linearize(v)
        for factor in block.linearize(v):
            ours.push_back(factor)
        ordering = gtsam.Ordering.ColamdGaussianFactorGraph(theirs)
        found, expected = ours.augmentedHessian(ordering), theirs.augmentedHessian(ordering)
        # the last entry is the sum of squares, which nothing is solved with
        scale = np.abs(expected[:-1]).max()
        np.testing.assert_allclose(found[:-1] / scale, expected[:-1] / scale, atol=1e-12)


def test_the_loss_bends_some_and_not_others() -> None:
    rng = np.random.default_rng(1)
    block, v = intervals(rng, 200.0), values(rng)
    norms = [
        np.sqrt(2.0 * block.measurement(k).reference((X(k), X(k + 1), CALIBRATION)).error(v)) for k in range(COUNT)
    ]
    assert min(norms) < 200.0 < max(norms)


def test_the_true_calibration_leaves_no_residual() -> None:
    """A DVL that reads 2 % too much and looks 3 deg aside, on a vehicle that turns on the spot and moves."""
    rng = np.random.default_rng(2)
    c = np.array([0.02, 0.01, -0.02, 0.05])
    start, turn, way = random_pose(rng), gtsam.Rot3.Rz(0.3), np.array([1.5, 0.2, -0.1])
    l_b = np.array([0.4, -0.1, 0.2])
    lever = turn.matrix() @ l_b - l_b
    q = way + lever
    d = (1.0 + c[0]) * q + np.cross(c[1:], q)
    measurement = factors.CalibratedDisplacement(d, lever, np.eye(3), np.eye(3))
    end = start.compose(gtsam.Pose3(turn, way))
    np.testing.assert_allclose(measurement.residual(start, end, c), 0.0, atol=1e-13)


def test_without_calibration_it_is_the_plain_displacement() -> None:
    rng = np.random.default_rng(3)
    start, end = random_pose(rng), random_pose(rng)
    dR = start.rotation().matrix().T @ end.rotation().matrix()
    cov = np.diag([0.01, 0.04, 0.09])
    plain = factors.DvlDisplacement(np.array([1.0, 2.0, 3.0]), dR, cov)
    calibrated = factors.CalibratedDisplacement(plain.d_start, np.zeros(3), np.eye(3), cov)
    free, native = gtsam.Values(), plain.lowered((X(0), X(1)))
    for key, pose in ((X(0), start), (X(1), end)):
        free.insert(key, pose)
    error = native.error(free)
    free.insert(CALIBRATION, np.zeros(4))
    assert calibrated.reference((X(0), X(1), CALIBRATION)).error(free) == pytest.approx(error, rel=1e-9)


# --- the bend between pings

T = np.arange(0.0, 20.0 + 1e-9, 0.01)


def ns(seconds: np.ndarray) -> np.ndarray:
    return np.rint(np.asarray(seconds) * NS).astype(np.int64)


def test_a_constant_acceleration_has_no_bend() -> None:
    velocity = T[:, None] * np.array([0.3, -0.2, -9.8])
    bend = factors.inertial_bend(ns(T), velocity, ns(np.arange(0.4, 20.0)), ns(np.arange(1.1, 18.0)))
    np.testing.assert_allclose(bend, 0.0, atol=1e-11)


def test_the_bend_completes_pings_once_a_second_in_a_turn() -> None:
    """On a circle at 15 deg/s pings at 1 Hz alone are 0.6 % short; with the bend the way is that of the circle."""
    rate, speed = np.radians(15.0), 1.5
    heading = rate * T
    v_n = speed * np.stack([np.cos(heading), np.sin(heading), np.zeros_like(T)], axis=1)
    pings, keyframes = np.arange(0.0, 20.01, 1.0), np.arange(1.3, 18.0, 1.0)
    v_pings = speed * np.stack([np.cos(rate * pings), np.sin(rate * pings), np.zeros_like(pings)], axis=1)
    true = speed / rate * np.stack([np.sin(rate * keyframes), -np.cos(rate * keyframes), 0.0 * keyframes], axis=1)
    eye = np.broadcast_to(np.eye(3), (len(pings), 3, 3))
    straight = factors.displacements(ns(pings), v_pings, eye, eye, ns(keyframes), eye[: len(keyframes)]).d_start
    # gravity and a bias ride along in the integrated specific force
    velocity = v_n + T[:, None] * np.array([0.02, -0.01, -9.8])
    bent = straight + factors.inertial_bend(ns(T), velocity, ns(pings), ns(keyframes))
    way = np.diff(true, axis=0)
    assert np.linalg.norm(straight - way, axis=1).max() > 5e-3
    np.testing.assert_allclose(bent, way, atol=2e-5)


def test_outside_the_pings_nothing_is_added() -> None:
    velocity = np.sin(T)[:, None] * np.ones(3)
    bend = factors.inertial_bend(ns(T), velocity, ns(np.arange(5.0, 10.1)), ns(np.arange(0.0, 20.0)))
    np.testing.assert_array_equal(bend[:4], 0.0)
    np.testing.assert_array_equal(bend[11:], 0.0)
    assert np.abs(bend[5:9]).min() > 0.0
