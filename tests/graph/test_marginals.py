"""One backward pass against the inverse of the whole information, and against queries key by key."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from graph_dives import SHORT, Truth
from gtsam.symbol_shorthand import X

import factors
from uwgraph.graph import SmoothSettings
from uwgraph.graph.builder import DVL_CALIBRATION, Problem
from uwgraph.graph.marginals import marginal_covariances
from uwgraph.types import FloatArray


def eliminated(linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> gtsam.GaussianBayesNet:
    return linear.eliminateSequential(ordering, gtsam.EliminateQR)


def inverted(linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> dict[int, FloatArray]:
    """Diagonal blocks of (A^T A)^-1 from a dense QR of A."""
    A, _ = linear.jacobian(ordering)
    R_inv = np.linalg.inv(np.linalg.qr(A, mode="r"))
    Sigma = R_inv @ R_inv.T
    dims = linear.optimizeDensely()
    blocks, start = {}, 0
    for key in (ordering.at(i) for i in range(ordering.size())):
        end = start + len(dims.at(key))
        blocks[key] = Sigma[start:end, start:end]
        start = end
    return blocks


def relative_difference(found: FloatArray, expected: FloatArray) -> float:
    """Largest difference in units of the 1-sigmas."""
    sigma = np.sqrt(np.diag(expected))
    return float(np.abs((found - expected) / np.outer(sigma, sigma)).max())


def norm_difference(found: FloatArray, expected: FloatArray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def close_loops(problem: Problem, pairs: list[tuple[int, int]]) -> None:
    for i, j in pairs:
        T_ij = problem.values.atPose3(X(i)).between(problem.values.atPose3(X(j)))
        problem.graph.push_back(factors.RelativePose(T_ij, 1e-4 * np.eye(6)).lowered((X(i), X(j))))


@pytest.mark.parametrize("calibrated", [True, False], ids=["dense calibration", "native"])
@pytest.mark.parametrize("loops", [[], [(3, 50), (10, 58), (4, 49), (0, 30)]], ids=["chain", "loops"])
def test_equal_to_the_dense_inverse_and_to_single_queries(calibrated: bool, loops: list[tuple[int, int]]) -> None:
    problem = Truth.of(SHORT).problem(SmoothSettings(dvl_calibration=calibrated))
    close_loops(problem, loops)
    linear = problem.linearize(problem.values)
    ordering = problem.ordering(linear)
    found = marginal_covariances(eliminated(linear, ordering))
    dense = inverted(linear, ordering)
    assert set(found) == set(dense)
    assert (DVL_CALIBRATION in found) == calibrated
    assert max(relative_difference(found[k], dense[k]) for k in dense) < 1e-9
    tree = linear.eliminateMultifrontal(ordering, gtsam.EliminateQR)
    asked = [*list(found)[::7], X(0), X(58)]
    # in units of each sigma the queries, which square the information, are themselves no better than 2e-8
    assert max(norm_difference(found[k], tree.marginalCovariance(k)) for k in asked) < 1e-8


def test_every_covariance_is_symmetric_and_positive_definite() -> None:
    problem = Truth.of(SHORT).problem(SmoothSettings())
    close_loops(problem, [(3, 50)])
    linear = problem.linearize(problem.values)
    for key, cov in marginal_covariances(eliminated(linear, problem.ordering(linear))).items():
        np.testing.assert_array_equal(cov, cov.T, err_msg=gtsam.Symbol(key).string())
        sigma = np.sqrt(np.diag(cov))
        assert np.linalg.eigvalsh(cov / np.outer(sigma, sigma))[0] > 0.0


def chain(count: int, loops: list[tuple[int, int]]) -> gtsam.GaussianFactorGraph:
    """A random walk in three dimensions with steps of unit variance from a known start."""
    graph = gtsam.GaussianFactorGraph()
    unit, eye, zero = gtsam.noiseModel.Unit.Create(3), np.eye(3), np.zeros(3)
    graph.push_back(gtsam.JacobianFactor(X(0), eye, zero, unit))
    for i, j in [*zip(range(count - 1), range(1, count), strict=True), *loops]:
        graph.push_back(gtsam.JacobianFactor(X(i), -eye, X(j), eye, zero, unit))
    return graph


def test_a_long_chain_grows_as_a_random_walk_does() -> None:
    """Three thousand steps back, and the error of the recursion has not grown."""
    count = 3000
    graph = chain(count, [])
    ordering = gtsam.Ordering()
    for i in range(count):
        ordering.push_back(X(i))
    found = marginal_covariances(eliminated(graph, ordering))
    variance = np.array([found[X(i)] for i in range(count)])
    np.testing.assert_allclose(variance, (1.0 + np.arange(count))[:, None, None] * np.eye(3), rtol=1e-8, atol=1e-8)


def test_a_long_chain_with_loops_equals_single_queries() -> None:
    rng = np.random.default_rng(4)
    count = 3000
    graph = chain(count, [(int(i), int(j)) for i, j in rng.integers(0, count, size=(15, 2)) if i != j])
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(graph)
    found = marginal_covariances(eliminated(graph, ordering))
    tree = graph.eliminateMultifrontal(ordering, gtsam.EliminateQR)
    asked = [X(int(i)) for i in rng.integers(0, count, size=40)]
    assert max(relative_difference(found[k], tree.marginalCovariance(k)) for k in asked) < 1e-8


def test_a_long_chain_of_inertial_states_stays_finite() -> None:
    """Tight bias walks tie the biases of all keyframes together: an asymmetry would grow exponentially."""
    truth = Truth.of(SHORT.model_copy(update={"grade": "fog", "duration_s": 600.0, "imu_rate_hz": 20.0}))
    problem = truth.problem(SmoothSettings(keyframe_period_s=0.2))
    assert len(problem.keyframes) > 2900
    linear = problem.linearize(problem.values)
    found = marginal_covariances(eliminated(linear, problem.ordering(linear)))
    bias = np.array([found[gtsam.symbol("b", k)] for k in range(len(problem.keyframes))])
    assert (np.diagonal(bias, axis1=1, axis2=2) > 0.0).all()
    rig = truth.dive.rig.imu
    prior = np.repeat([rig.accel_bias_sigma, rig.gyro_bias_sigma], 3)
    walk = np.repeat([rig.accel_bias_walk, rig.gyro_bias_walk], 3) * np.sqrt(truth.motion.duration_s)
    assert (np.sqrt(np.diagonal(bias, axis1=1, axis2=2)) <= np.hypot(prior, walk) * (1.0 + 1e-6)).all()
