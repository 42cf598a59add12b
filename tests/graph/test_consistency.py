"""Cycles of closures and odometry: chi-square when true, whatever the odometry has in common, and not when false."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from uwgraph.graph.consistency import Loops, Odometry, against_odometry, consistent_pairs, gate
from uwgraph.graph.consistency import _cycles as cycles
from uwgraph.graph.se3 import Poses, moved
from uwgraph.types import NOT_MEASURED, FloatArray

SIGMA = np.repeat([np.radians(0.3), 0.1], 3)
STEP = np.repeat([np.radians(0.05), 0.02], 3)
LAP = 40


def exp(d: FloatArray) -> Poses:
    return Poses(Rotation.from_rotvec(d[:, :3]).as_matrix(), d[:, 3:])


def walk(seed: int, laps: int = 3) -> tuple[Poses, Odometry]:
    """Laps around a circle of 30 m: the truth, and an odometry that drifts, with its joint covariance."""
    rng = np.random.default_rng(seed)
    N = laps * LAP
    angle = 2.0 * np.pi * np.arange(N) / LAP
    R = Rotation.from_euler("z", angle[:, None]).as_matrix()
    truth = Poses(R, np.column_stack([30.0 * np.sin(angle), -30.0 * np.cos(angle), np.zeros(N)]))
    steps = truth[:-1].to(truth[1:])
    noisy = steps @ exp(STEP * rng.normal(size=(N - 1, 6)))
    # all of it is turned and moved by the error of the start, which no closure sees
    where = [truth[:1] @ exp(np.array([[0.0, 0.0, 0.3, 5.0, -8.0, 1.0]]))]
    for n in range(N - 1):
        where.append(where[-1] @ noisy[n : n + 1])
    T = Poses(np.concatenate([w.R for w in where]), np.concatenate([w.p for w in where]))
    # d_k = sum over steps of Ad(T_k^-1 T_n) d_n: as rows of a matrix, Sigma = L L^T
    from_start = T.adjoint()
    to_own = T.inverse().adjoint()
    L = np.zeros((N, 6, N, 6))
    for n in range(1, N):
        L[n:, :, n] = to_own[n:] @ from_start[n] * STEP
    L[:, :, 0] = to_own @ from_start[0] * np.repeat([0.2, 10.0], 3)
    flat = L.reshape(6 * N, 6 * N)
    return truth, Odometry(T, (flat @ flat.T).reshape(N, 6, N, 6).swapaxes(1, 2))


def closures(truth: Poses, seed: int, count: int = 40) -> Loops:
    rng = np.random.default_rng([seed, 1])
    j = np.sort(rng.choice(np.arange(LAP, len(truth)), count, replace=False))
    i = j % LAP + rng.integers(-1, 2, count) % LAP
    T = truth[i].to(truth[j]) @ exp(SIGMA * rng.normal(size=(count, 6)))
    return Loops(i, j, T, np.tile(np.diag(SIGMA**2), (count, 1, 1)))


def test_true_closures_are_chi_square() -> None:
    alone, pairs = [], []
    for seed in range(40):
        truth, odometry = walk(seed)
        loops = closures(truth, seed)
        alone.append(against_odometry(odometry, loops, 0.99).d2[::20])
        pairs.append(cycles(odometry, loops, 0, np.array([25]), 0.99).d2)
    assert kstest(np.concatenate(alone), chi2(6).cdf).pvalue > 0.01
    assert kstest(np.concatenate(pairs), chi2(6).cdf).pvalue > 0.01


def test_what_all_poses_have_in_common_is_no_doubt() -> None:
    """A thousand times less sure of the start, turned and moved: the same distances."""
    truth, odometry = walk(3)
    loops = closures(truth, 3)
    to_start = odometry.T_n.inverse().adjoint()
    common = to_start[:, None] @ np.diag(np.repeat([4.0, 1e6], 3)) @ np.swapaxes(to_start, 1, 2)[None]
    vague = Odometry(odometry.T_n, odometry.cov + common)
    b = np.arange(1, len(loops))
    np.testing.assert_allclose(cycles(vague, loops, 0, b, 0.9).d2, cycles(odometry, loops, 0, b, 0.9).d2, rtol=1e-4)


def test_a_group_that_agrees_with_itself_is_told_from_the_true_ones() -> None:
    truth, odometry = walk(5)
    loops = closures(truth, 5)
    false = np.arange(10, 18)
    shift = Poses(np.broadcast_to(np.eye(3), (8, 3, 3)), np.tile([2.0, 1.5, 0.0], (8, 1)))
    i, j = loops.i[false], loops.j[false]
    wrong = truth[i].to(shift @ truth[j])
    loops.T.R[false], loops.T.p[false] = wrong.R, wrong.p
    agree = consistent_pairs(odometry, loops, 0.9999)
    is_false = np.isin(np.arange(len(loops)), false)
    assert agree[np.ix_(is_false, is_false)].all()
    assert agree[np.ix_(~is_false, ~is_false)].mean() > 0.995
    assert agree[np.ix_(is_false, ~is_false)].mean() < 0.2
    np.testing.assert_array_equal(agree, agree.T)


def test_what_was_not_measured_is_not_held_against_anything() -> None:
    """A camera that does not know the scale: any way along its direction will do, others will not."""
    direction = np.array([0.6, 0.8, 0.0])
    cov = np.diag(SIGMA**2)
    cov[3:, 3:] += NOT_MEASURED * np.outer(direction, direction)
    here = Poses(np.eye(3)[None], np.zeros((1, 3)))
    predicted = np.diag(SIGMA**2)[None]

    def held(p: FloatArray) -> tuple[float, bool]:
        found = gate(here, predicted, Poses(np.eye(3)[None], p[None]), cov[None], 0.99)
        assert found.limit[0] == pytest.approx(chi2.ppf(0.99, 5))
        return float(found.d2[0]), bool(found.accepted[0])

    d2, accepted = held(50.0 * direction)
    assert accepted
    assert d2 < 1e-2
    assert not held(np.array([-0.8, 0.6, 0.0]))[1]


def test_the_gate_adds_both_covariances() -> None:
    T = Poses(Rotation.from_euler("xyz", [[0.1, -0.3, 1.0]]).as_matrix(), np.array([[3.0, -1.0, 2.0]]))
    d = np.array([[0.01, 0.02, -0.01, 0.1, 0.3, -0.2]])
    A, B = np.diag(np.arange(1.0, 7.0)) * 1e-3, np.eye(6) * 2e-3
    closure = T @ exp(d)
    found = gate(T, A[None], closure, B[None], 0.99)
    e = closure.to(T)
    S = A + moved(B, e.inverse().adjoint()[0])
    assert found.d2[0] == pytest.approx(float(e.log()[0] @ np.linalg.solve(S, e.log()[0])))
