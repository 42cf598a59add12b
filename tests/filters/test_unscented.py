"""The unscented transform: on a linear problem the Kalman filter, whatever its spread; on a manifold a fair mean."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from linear import System, belief_of, covariance, held_to, predicted, updated, vector
from scipy.spatial.transform import Rotation

from uwgraph.filters import unscented
from uwgraph.filters.roots import condition, lower_root
from uwgraph.filters.state import Belief, State
from uwgraph.filters.unscented import Spread, Weights

SPREADS = [Spread(), Spread(0.2, 2.0, 0.0), Spread(0.5, 0.0, 3.0), Spread(1.0, 0.0, 1.0), Spread(1.7, 2.0, 0.5)]
EACH_SPREAD = pytest.mark.parametrize("spread", SPREADS, ids=lambda s: f"{s.alpha}, {s.beta}, {s.kappa}")


def linear_motion(F: np.ndarray) -> unscented.Motion:
    def move(x: State) -> State:
        return State(x.R, x.y @ F.T, x.rot)

    return move


@EACH_SPREAD
@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 8), m=st.integers(1, 5), seed=st.integers(0, 2**32 - 1))
def test_a_linear_problem_gives_the_kalman_filter(spread: Spread, n: int, m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = System.drawn(rng, n, m)
    x, P = rng.normal(size=n), covariance(rng, n)
    belief, weights = belief_of(x, P), spread.of(n)
    for k in range(10):
        z = rng.normal(size=m)
        belief = unscented.predict(belief, k, linear_motion(system.F), system.noise_rows, weights)
        x, P = predicted(x, P, system.F, system.Q)
        held_to(belief, (x, P))
        seen = unscented.see(belief, lambda s, z=z: s.y @ system.H.T - z, weights)
        np.testing.assert_allclose(seen.spread, system.H @ P @ system.H.T, rtol=1e-9, atol=1e-9)
        belief = unscented.moved_by(belief, seen, seen.with_noise(system.S_R))
        x, P = updated(x, P, system.H, system.R, z)
        held_to(belief, (x, P))


@EACH_SPREAD
@pytest.mark.parametrize("seed", range(5))
def test_fewer_sigma_points_do_where_only_the_first_numbers_are_seen(spread: Spread, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, a, m = 7, 3, 2
    system = System.drawn(rng, n, m)
    H = np.hstack([system.H[:, :a], np.zeros((m, n - a))])
    x, P, z = rng.normal(size=n), covariance(rng, n), rng.normal(size=m)
    belief = belief_of(x, P)
    seen = unscented.see(belief, lambda s: s.y @ H.T - z, spread.of(a))
    assert len(seen.Z) == 2 * a + 1
    after = unscented.moved_by(belief, seen, seen.with_noise(system.S_R))
    held_to(after, updated(x, P, H, system.R, z))


def test_sigma_points_are_drawn_afresh_after_the_noise_went_in() -> None:
    """Points of the propagated covariance alone would see a spread without Q."""
    belief = belief_of(np.zeros(1), np.array([[1.0]]))
    after = unscented.predict(belief, 1, linear_motion(np.eye(1)), np.array([[2.0]]), Weights(1, Spread()))
    seen = unscented.see(after, lambda s: s.y, Weights(1, Spread()))
    assert seen.spread[0, 0] == pytest.approx(5.0)


@EACH_SPREAD
def test_the_transform_is_exact_to_second_order_in_the_mean(spread: Spread) -> None:
    """E[x^T A x] = m^T A m + tr(A P) for a quadratic, which no first-order filter knows."""
    rng = np.random.default_rng(4)
    n = 4
    x, P, A = rng.normal(size=n), covariance(rng, n), covariance(rng, n)
    seen = unscented.see(belief_of(x, P), lambda s: np.einsum("mi,ij,mj->m", s.y, A, s.y)[:, None], spread.of(n))
    assert seen.mean[0] == pytest.approx(x @ A @ x + np.trace(A @ P), rel=1e-10)


@settings(max_examples=100, deadline=None)
@given(n=st.integers(1, 20), alpha=st.floats(1e-3, 2.0), beta=st.floats(0.0, 3.0), kappa=st.floats(0.0, 5.0))
def test_weights(n: int, alpha: float, beta: float, kappa: float) -> None:
    weights = Spread(alpha, beta, kappa).of(n)
    assert weights.mean.sum() == pytest.approx(1.0, abs=1e-9 * max(1.0, abs(weights.mean[0])))
    np.testing.assert_allclose(weights.rows.T @ weights.rows, np.eye(n), atol=1e-9)
    np.testing.assert_allclose(weights.mean @ weights.points, 0.0, atol=1e-9)
    assert (weights.root >= 0.0).all()


def test_the_usual_spread_has_no_negative_weight_for_any_number_of_states() -> None:
    for n in (1, 2, 15, 60):
        weights = Spread().of(n)
        assert weights.mean.min() >= 0.0
        np.testing.assert_allclose(weights.root[0] ** 2, 2.0)


@EACH_SPREAD
def test_a_rotation_stays_one_and_its_mean_is_that_of_many_draws(spread: Spread) -> None:
    """Turning about a rotated axis by an uncertain angle: mean and covariance against ten thousand draws."""
    rng = np.random.default_rng(0)
    sigma = 0.15
    start = State(Rotation.from_rotvec([0.3, -2.0, 0.5]).as_matrix()[None], np.zeros(3), np.array([0]))
    belief = Belief(0, start, sigma * np.diag([1.0, 0.5, 0.2]))
    turn = Rotation.from_rotvec([0.0, 0.4, 0.0])

    def move(x: State) -> State:
        """Half of the rotation vector from the unit matrix, and a turn: not linear, and not of one side."""
        halved = Rotation.from_rotvec(0.5 * Rotation.from_matrix(x.R[:, 0]).as_rotvec())
        return State((turn * halved).as_matrix()[:, None], x.y, x.rot)

    after = unscented.predict(belief, 1, move, np.zeros((3, 3)), spread.of(3))
    np.testing.assert_allclose(after.x.R[0] @ after.x.R[0].T, np.eye(3), atol=1e-12)
    drawn = move(start.plus(rng.normal(size=(40_000, 3)) @ belief.S.T))
    away = after.x.to(drawn)
    np.testing.assert_allclose(away.mean(axis=0), 0.0, atol=3e-3)
    np.testing.assert_allclose(np.cov(away.T), after.P, atol=0.04 * after.P.max())


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 12), m=st.integers(1, 6), small=st.floats(1e-12, 1.0))
def test_conditioning_never_loses_definiteness(seed: int, n: int, m: int, small: float) -> None:
    """A measurement twelve orders more exact than the prior: where P - K S K^T would become negative."""
    rng = np.random.default_rng(seed)
    Z = rng.normal(size=(n, m))
    found = condition(Z, np.eye(n), small * np.eye(m))
    assert (np.linalg.eigvalsh(found.L @ found.L.T) > -1e-15).all()
    assert np.linalg.eigvalsh(found.L @ found.L.T)[-1] <= 1.0 + 1e-9
    np.testing.assert_allclose(found.S_z @ found.S_z.T, Z.T @ Z + small**2 * np.eye(m), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_whitening_keeps_the_side_of_an_innovation(seed: int) -> None:
    """Whatever the signs that QR gives: a filter asks whether its innovations lie on one side."""
    rng = np.random.default_rng(seed)
    found = condition(rng.normal(size=(7, 3)), rng.normal(size=(7, 4)), 0.1 * np.eye(3))
    assert (np.diag(found.S_z) > 0.0).all()
    assert found.whiten(np.array([2.0, 0.0, 0.0]))[0] > 0.0


def test_a_root_of_rows() -> None:
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(9, 5))
    S = lower_root(rows)
    np.testing.assert_allclose(S @ S.T, rows.T @ rows, atol=1e-12)
    np.testing.assert_array_equal(S, np.tril(S))


# States


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), angle=st.floats(0.0, np.pi - 1e-6))
def test_to_is_the_inverse_of_plus(seed: int, angle: float) -> None:
    """Up to half a turn, two rotations and numbers between them."""
    rng = np.random.default_rng(seed)
    x = State(Rotation.random(2, random_state=seed).as_matrix(), rng.normal(size=9), np.array([0, 5]))
    x.y[[0, 1, 2, 5, 6, 7]] = 0.0
    d = rng.normal(size=(4, 9))
    for at in (0, 5):
        d[:, at : at + 3] *= angle / np.linalg.norm(d[:, at : at + 3], axis=1, keepdims=True)
    np.testing.assert_allclose(x.to(x.plus(d)), d, atol=2e-8)
    np.testing.assert_allclose(x.to(x.plus(d[0])), d[0], atol=2e-8)
    np.testing.assert_allclose(x.plus(d).R[1, 1], x.R[1] @ Rotation.from_rotvec(d[1, 5:8]).as_matrix(), atol=1e-12)


def test_a_core_goes_back_where_it_was() -> None:
    rng = np.random.default_rng(3)
    x = State(Rotation.random(2, random_state=1).as_matrix(), rng.normal(size=9), np.array([0, 6]))
    moved = x.core(6).plus(0.1 * rng.normal(size=6))
    back = x.with_core(moved)
    np.testing.assert_array_equal(back.R, np.stack([moved.R[0], x.R[1]]))
    np.testing.assert_array_equal(back.y, np.concatenate([moved.y, x.y[6:]]))
    assert vector(np.zeros(4)).core(2).size == 2
