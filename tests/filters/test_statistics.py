"""Noise statistics with fading memory: what they converge to, what cannot happen to them, and what the traps are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from linear import covariance

from uwgraph.filters.statistics import (
    Noise,
    fading_factor,
    fading_weight,
    innovation_covariance,
    noise_mean,
    residual_noise,
    system_mean,
    system_noise,
    unbiased_noise,
)
from uwgraph.types import FloatArray

B = 0.995


# The fading weight


@given(k=st.integers(1, 3000), b=st.floats(0.5, 0.999))
def test_the_weights_of_all_measurements_sum_to_one(k: int, b: float) -> None:
    """d_k times b to the power of the age, over all k of them."""
    assert fading_weight(k, b) * np.sum(b ** np.arange(k)) == pytest.approx(1.0, rel=1e-9)


@given(k=st.integers(1, 200), b=st.floats(0.5, 0.999), k0=st.integers(0, 100))
def test_the_recursion_weighs_by_age_and_the_start_as_so_many(k: int, b: float, k0: int) -> None:
    """R <- (1 - d) R + d x unrolled: the i-th of k has the share b^(k - i), the start that of k0 before them."""
    shares = np.zeros(k + 1)
    shares[0] = 1.0
    for i in range(1, k + 1):
        d = fading_weight(i, b, k0)
        shares *= 1.0 - d
        shares[i] += d
    total = np.sum(b ** np.arange(k + k0))
    np.testing.assert_allclose(shares[1:], b ** np.arange(k - 1, -1, -1) / total, rtol=1e-6, atol=1e-12)
    assert shares[0] == pytest.approx(np.sum(b ** np.arange(k, k + k0)) / total, rel=1e-6, abs=1e-12)


def test_without_a_start_the_first_measurement_replaces_what_was_stated() -> None:
    assert fading_weight(1, B) == 1.0
    assert fading_weight(1, B, k0=30) < 0.04


# The noise of the measurement: a constant state seen over and over, with a filter of random walk


def stationary(R: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance of a random walk seen directly, before and after the measurement."""
    P = Q
    for _ in range(2000):
        before = P + Q
        P = before - before @ np.linalg.solve(before + R, before)
    return P + Q, P


@pytest.mark.parametrize("m", [1, 3])
def test_both_estimators_converge_to_the_true_noise(m: int) -> None:
    """A right filter's innovations and residuals; averaged over the last of many, to five percent."""
    rng = np.random.default_rng(m)
    R, Q = covariance(rng, m), 0.1 * covariance(rng, m)
    before, after = stationary(R, Q)
    K = before @ np.linalg.inv(before + R)
    by_residual = by_innovation = Noise(9.0 * np.eye(m), np.zeros(m))
    means = np.zeros((2, m, m))
    steps, late = 12_000, 2000
    innovations = rng.multivariate_normal(np.zeros(m), before + R, size=steps)
    for k, v in enumerate(innovations):
        d = fading_weight(k + 1, B, 30)
        by_residual = residual_noise(by_residual, v - K @ v, after, d)
        by_innovation = unbiased_noise(by_innovation, v, before, d) or by_innovation
        if k >= late:
            means += np.stack([by_residual.R, by_innovation.R]) / (steps - late)
    scale = np.sqrt(np.outer(np.diag(R), np.diag(R)))
    np.testing.assert_allclose(means[0] / scale, R / scale, atol=0.06)
    np.testing.assert_allclose(means[1] / scale, R / scale, atol=0.06)


@pytest.mark.parametrize("m", [1, 3])
def test_the_residual_form_stays_positive_definite_for_ever(m: int) -> None:
    """Residuals from nothing to a thousand sigmas, spreads of rank one: 100 000 of them."""
    rng = np.random.default_rng(0)
    noise, least = Noise.stated(m), np.inf
    sizes = 10.0 ** rng.uniform(-8.0, 3.0, size=100_000)
    directions = rng.normal(size=(100_000, m))
    spread = np.outer(np.arange(1.0, m + 1), np.arange(1.0, m + 1))
    for k in range(100_000):
        d = fading_weight(k + 1, 0.95)
        noise = residual_noise(noise, sizes[k] * directions[k], 1e-6 * spread, d, cap=25.0 if k % 2 else np.inf)
        if k % 500 == 0:
            least = min(least, float(np.linalg.eigvalsh(noise.R)[0]))
    assert least > 0.0
    np.testing.assert_array_equal(noise.R, noise.R.T)
    assert noise.count == 100_000


def test_the_unbiased_form_says_when_it_fails() -> None:
    """An innovation smaller than the spread of its prediction: R would have to be negative."""
    noise = Noise.stated(2)
    assert unbiased_noise(noise, np.zeros(2), 5.0 * np.eye(2), d=0.5) is None
    assert unbiased_noise(noise, np.zeros(2), np.diag([0.1, 5.0]), d=0.5) is None
    kept = unbiased_noise(noise, np.array([2.0, 0.0]), 0.5 * np.eye(2), d=0.5)
    assert kept is not None
    np.testing.assert_allclose(kept.R, np.diag([0.5 + 0.5 * 3.5, 0.5 - 0.25]))
    assert kept.count == 1


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), m=st.integers(1, 4), cap=st.floats(0.5, 50.0), size=st.floats(0.0, 1e4))
def test_a_residual_counts_for_no_more_than_its_cap(seed: int, m: int, cap: float, size: float) -> None:
    rng = np.random.default_rng(seed)
    noise, e = Noise(covariance(rng, m), np.zeros(m)), size * rng.normal(size=m)
    d = 0.1
    grown = residual_noise(noise, e, np.zeros((m, m)), d, cap).R
    added = (grown - (1.0 - d) * noise.R) / d
    counted = np.trace(np.linalg.solve(noise.R, added))
    assert counted <= m * cap * (1.0 + 1e-9)
    assert counted == pytest.approx(min(float(e @ np.linalg.solve(noise.R, e)), m * cap), rel=1e-6, abs=1e-9)


def test_the_mean_of_the_noise() -> None:
    """Forgetting at the same pace: after many innovations of mean 3 it is 3, whatever it was."""
    rng = np.random.default_rng(0)
    noise = Noise.stated(1)
    for k in range(4000):
        noise = noise_mean(noise, 3.0 + rng.normal(size=1), fading_weight(k + 1, B))
    assert noise.r[0] == pytest.approx(3.0, abs=0.25)


# The noise of the system


@pytest.mark.parametrize(("with_Q", "low", "high"), [(False, 0.075, 0.105), (True, 0.0, 0.01)])
def test_the_noise_of_the_system_needs_the_points_without_it(with_Q: bool, low: float, high: float) -> None:
    """A walk of 0.09: found again from the covariance of the propagated points, and lost when that contains Q."""
    true, R, b = 0.09, 1.0, 0.99
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        Q, P, x, truth = np.array([[true]]), np.eye(1), 0.0, 0.0
        for k in range(3000):
            truth += np.sqrt(true) * rng.normal()
            z = truth + np.sqrt(R) * rng.normal()
            P0 = P
            before = P0 + Q
            K = before / (before + R)
            gained = (K * (z - x))[0]
            x, P = x + float(gained[0]), before - K @ before
            Q = system_noise(Q, gained, P, before if with_Q else P0, fading_weight(k + 1, b, 30))
            Q = np.maximum(Q, 1e-9)
            if k >= 1500:
                found.append(float(Q[0, 0]))
    assert low < np.mean(found) < high


def test_the_mean_of_the_system() -> None:
    q = np.zeros(2)
    for k in range(3000):
        q = system_mean(q, np.array([0.5, -2.0]), fading_weight(k + 1, B))
    np.testing.assert_allclose(q, [0.5, -2.0])


# Fading


def test_the_covariance_of_the_innovations_forgets() -> None:
    """V_1 = v v^T; then (rho V + v v^T) / (1 + rho), of which a constant v is the fixed point."""
    v = np.array([1.0, -2.0])
    V = innovation_covariance(None, v, 0.95)
    np.testing.assert_array_equal(V, np.outer(v, v))
    np.testing.assert_allclose(innovation_covariance(V, v, 0.95), V)
    np.testing.assert_allclose(innovation_covariance(V, np.zeros(2), 0.95), 0.95 / 1.95 * V)


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), m=st.integers(1, 4), size=st.floats(0.0, 30.0))
def test_the_fading_factor(seed: int, m: int, size: float) -> None:
    """lambda makes the predicted covariance as large as the innovations are: tr(lambda M + rest) = tr V, up to its cap.

    In white units P_zz is the unit matrix, made of the spread M, which lambda multiplies, and of the rest.
    """
    rng = np.random.default_rng(seed)
    V = size * covariance(rng, m)
    M = covariance(rng, m)
    M /= 1.2 * np.linalg.eigvalsh(M)[-1]
    rest = np.eye(m) - M
    factor = fading_factor(V, np.eye(m), M, most=1e9)
    assert factor >= 1.0
    if np.trace(V) > m:
        assert np.trace(factor * M + rest) == pytest.approx(np.trace(V), rel=1e-9)
    else:
        assert factor == 1.0
    assert fading_factor(V, np.eye(m), M, most=3.0) == min(factor, 3.0)


def test_what_does_not_depend_on_the_state_fades_nothing() -> None:
    assert fading_factor(9.0 * np.eye(2), np.eye(2), np.zeros((2, 2)), most=10.0) == 1.0


def test_a_noise_is_frozen_and_counts() -> None:
    noise = residual_noise(replace(Noise.stated(1), count=4), np.zeros(1), np.zeros((1, 1)), 0.5)
    assert noise.count == 5
    assert noise.R[0, 0] == 0.5
