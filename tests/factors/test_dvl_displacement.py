"""DVL pings preintegrated between keyframes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import factors

NS = 1_000_000_000


def ns(seconds: np.ndarray) -> np.ndarray:
    return np.rint(np.asarray(seconds) * NS).astype(np.int64)


def attitude(t: np.ndarray) -> np.ndarray:
    return Rotation.from_euler("ZYX", np.stack([0.3 * t, 0.1 * np.sin(t), 0.2 * np.cos(0.7 * t)], -1)).as_matrix()


def rate(t: np.ndarray, step: float = 1e-5) -> np.ndarray:
    dR = np.swapaxes(attitude(t - step), 1, 2) @ attitude(t + step)
    return Rotation.from_matrix(dR).as_rotvec() / (2.0 * step)


def pings(t: np.ndarray, v_n: np.ndarray, l_b: np.ndarray) -> np.ndarray:
    return np.einsum("nji,nj->ni", attitude(t), v_n) + np.cross(rate(t), l_b)


def unit_cov(t: np.ndarray) -> np.ndarray:
    return np.broadcast_to(np.eye(3), (len(t), 3, 3))


def test_a_steady_course_with_any_turn_and_lever_arm_is_exact() -> None:
    t, k, l_b, v = np.arange(0.0, 20.2, 0.2), np.arange(0.37, 19.5, 1.13), np.array([1.2, -0.5, 0.8]), [1.0, -0.4, 0.2]
    v_b = pings(t, np.tile(v, (len(t), 1)), l_b)
    # The lever arm's own velocity is not linear between pings: integrate it apart by taking it off before.
    without = pings(t, np.tile(v, (len(t), 1)), np.zeros(3))
    exact = factors.displacements(ns(t), without, unit_cov(t), attitude(t), ns(k), attitude(k))
    truth = np.einsum("nji,nj->ni", attitude(k[:-1]), np.diff(k)[:, None] * np.array(v))
    np.testing.assert_allclose(exact.d_start, truth, atol=1e-8)
    with_arm = factors.displacements(ns(t), v_b, unit_cov(t), attitude(t), ns(k), attitude(k), l_b)
    np.testing.assert_allclose(with_arm.d_start, truth, atol=2e-3)
    np.testing.assert_allclose(with_arm.dR, np.swapaxes(attitude(k[:-1]), 1, 2) @ attitude(k[1:]), atol=1e-12)


def test_a_velocity_that_changes_linearly_is_exact_at_partial_trapezoids() -> None:
    t, k = np.array([0.0, 0.7, 1.0, 2.5, 3.0]), np.array([0.1, 0.5, 0.9, 2.9, 3.0])
    v = np.stack([1.0 + 2.0 * t, -t, np.zeros_like(t)], -1)
    eye = np.broadcast_to(np.eye(3), (5, 3, 3))
    d = factors.displacements(ns(t), v, unit_cov(t), eye, ns(k), eye)
    p = np.stack([k + k**2, -(k**2) / 2.0, np.zeros_like(k)], -1)
    np.testing.assert_allclose(d.d_start, np.diff(p, axis=0), atol=1e-12)


@pytest.mark.parametrize(("period", "start"), [(1.0, 0.0), (1.0, 0.3), (0.2, 0.0), (0.2, 0.07), (2.7, 0.1), (0.9, 0.0)])
def test_many_intervals_add_up_to_the_variance_of_independent_pings(period: float, start: float) -> None:
    t, k = np.arange(-4.0, 110.0, period), start + np.arange(101.0)
    eye = np.broadcast_to(np.eye(3), (len(t), 3, 3))
    one = np.broadcast_to(np.eye(3), (len(k), 3, 3))
    chain = factors.displacements(ns(t), np.zeros((len(t), 3)), unit_cov(t), eye, ns(k), one)
    whole = factors.displacements(ns(t), np.zeros((len(t), 3)), unit_cov(t), eye, ns(k[[0, -1]]), one[:2])
    np.testing.assert_allclose(chain.cov_start.sum(axis=0), whole.cov_start[0], rtol=1e-9)


def test_the_covariance_of_one_interval_is_that_of_its_weights() -> None:
    rng = np.random.default_rng(2)
    t, k = np.arange(0.0, 2.1, 0.25), np.array([0.33, 1.41])
    cov = np.tile(np.diag([1e-2, 4e-2, 1e-3]), (len(t), 1, 1))
    args = ns(t), attitude(t), ns(k), attitude(k)

    def displace(v: np.ndarray) -> factors.Displacements:
        return factors.displacements(args[0], v, cov, *args[1:])

    draws = rng.multivariate_normal(np.zeros(3), cov[0], size=(2000, len(t)))
    sampled = np.cov(np.stack([displace(v).d_start[0] for v in draws]).T)
    np.testing.assert_allclose(sampled, displace(draws[0]).cov_start[0], rtol=0.12, atol=5e-4)


def test_intervals_without_pings_or_with_a_long_gap_are_not_valid() -> None:
    t = np.concatenate([np.arange(2.0, 6.0), np.arange(9.0, 13.0)])
    k = np.arange(0.5, 14.0)
    eye = np.broadcast_to(np.eye(3), (20, 3, 3))
    d = factors.displacements(ns(t), np.ones((8, 3)), unit_cov(t), eye[: len(t)], ns(k), eye[: len(k)], max_gap_s=2.0)
    assert d.valid.tolist() == [a >= 2.0 and b <= 12.0 and not (b > 5.0 and a < 9.0) for a, b in pairwise(k)]
    assert np.isnan(d.d_start[~d.valid]).all()
    np.testing.assert_allclose(d.d_start[d.valid], 1.0)


def test_the_covariance_turns_into_the_axes_of_the_end() -> None:
    dR = Rotation.from_rotvec([0.0, 0.0, np.pi / 2]).as_matrix()
    measurement = factors.DvlDisplacement(np.array([1.0, 0.0, 0.0]), dR, np.diag([1.0, 4.0, 9.0]))
    S = measurement.noise().R()
    np.testing.assert_allclose(np.linalg.inv(S.T @ S), np.diag([4.0, 1.0, 9.0]), atol=1e-12)


def test_stamps_must_increase() -> None:
    eye = np.broadcast_to(np.eye(3), (2, 3, 3))
    with pytest.raises(ValueError, match="increase"):
        factors.displacements(ns([1.0, 0.0]), np.zeros((2, 3)), eye, eye, ns([0.0, 1.0]), eye)
