"""Rigid motions as arrays against GTSAM's."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.graph.se3 import Poses, moved


def drawn(seed: int, angle: float, N: int = 8) -> Poses:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(N, 3))
    w = angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    return Poses(Rotation.from_rotvec(w).as_matrix(), rng.normal(0.0, 30.0, (N, 3)))


def native(poses: Poses) -> list[gtsam.Pose3]:
    return [gtsam.Pose3(gtsam.Rot3(R), p) for R, p in zip(poses.R, poses.p, strict=True)]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), angle=st.floats(0.0, 3.1))
def test_equal_to_gtsam(seed: int, angle: float) -> None:
    a, b = drawn(seed, angle), drawn(seed + 1, 1.0)
    A, B = native(a), native(b)
    np.testing.assert_allclose(a.log(), [gtsam.Pose3.Logmap(T) for T in A], atol=1e-6)
    np.testing.assert_allclose(a.adjoint(), [T.AdjointMap() for T in A], atol=1e-11)
    np.testing.assert_allclose((a @ b).p, [S.compose(T).translation() for S, T in zip(A, B, strict=True)], atol=1e-11)
    np.testing.assert_allclose(a.to(b).p, [S.between(T).translation() for S, T in zip(A, B, strict=True)], atol=1e-11)
    np.testing.assert_allclose(a.inverse().R, [T.inverse().rotation().matrix() for T in A], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.99e-4, 1.01e-4, 1e-3])
def test_the_logarithm_of_a_small_turn(angle: float) -> None:
    poses = drawn(3, angle)
    np.testing.assert_allclose(poses.log(), [gtsam.Pose3.Logmap(T) for T in native(poses)], atol=1e-8)


def test_a_covariance_moves_as_its_samples_do() -> None:
    """Exp of a small motion before a pose is another small motion after it."""
    rng = np.random.default_rng(1)
    A = rng.normal(size=(6, 6))
    cov = 1e-8 * A @ A.T
    T = drawn(2, 1.2, N=1)
    d = rng.multivariate_normal(np.zeros(6), cov, size=20_000)
    small = Poses(Rotation.from_rotvec(d[:, :3]).as_matrix(), d[:, 3:])
    seen = (T.inverse() @ small @ T).log()
    expected = moved(cov, T.inverse().adjoint())[0]
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(np.cov(seen.T) / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=0.04)
