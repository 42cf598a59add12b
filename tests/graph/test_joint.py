"""The joint covariance of chosen poses against the inverse of the whole information."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from graph_dives import SHORT, Truth
from gtsam.symbol_shorthand import X

import factors
from uwgraph.graph import SmoothSettings
from uwgraph.graph.joint import joint_poses


@pytest.mark.parametrize("calibrated", [True, False])
def test_equal_to_the_dense_inverse(calibrated: bool) -> None:
    problem = Truth.of(SHORT).problem(SmoothSettings(dvl_calibration=calibrated))
    # a long step of visual odometry jumps over chosen keyframes
    T = problem.values.atPose3(X(20)).between(problem.values.atPose3(X(40)))
    problem.graph.push_back(factors.RelativePose(T, 1e-3 * np.eye(6)).lowered((X(20), X(40))))
    chosen = [2, 3, 11, 25, 30, 39, 57]
    joint = joint_poses(problem, problem.values, chosen)
    found = joint.cov

    linear = problem.linearize(problem.values)
    ordering = problem.ordering(linear)
    A, _ = linear.jacobian(ordering)
    R_inv = np.linalg.inv(np.linalg.qr(A, mode="r"))
    Sigma = R_inv @ R_inv.T
    keys = [ordering.at(n) for n in range(ordering.size())]
    dims = linear.optimizeDensely()
    start = dict(zip(keys, np.cumsum([0, *(len(dims.at(k)) for k in keys)]).tolist(), strict=False))
    rows = np.concatenate([start[X(k)] + np.arange(6) for k in chosen])
    expected = Sigma[np.ix_(rows, rows)]

    dense = found.swapaxes(1, 2).reshape(expected.shape)
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(dense / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-9)
    np.testing.assert_array_equal(dense, dense.T)
    step = linear.eliminateMultifrontal(ordering, gtsam.EliminateQR).optimize()
    np.testing.assert_allclose(joint.mean, [step.at(X(k)) for k in chosen], atol=1e-8)


def test_neighbours_know_each_other_better_than_their_place() -> None:
    problem = Truth.of(SHORT).problem(SmoothSettings())
    P = joint_poses(problem, problem.values, [30, 31]).cov
    values = problem.values
    A = values.atPose3(X(31)).between(values.atPose3(X(30))).AdjointMap()
    relative = A @ P[0, 0] @ A.T + P[1, 1] - A @ P[0, 1] - (A @ P[0, 1]).T
    assert np.trace(relative[3:, 3:]) < 1e-3 * np.trace(P[1, 1][3:, 3:])
    assert gtsam.noiseModel.Gaussian.Covariance(relative).dim() == 6
