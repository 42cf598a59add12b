"""Robust estimates against least squares, other implementations, and their own covariance."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from uwgraph.sun.m_estimate import Loss, grouped_cov, inefficiency, m_estimate

LOSSES: tuple[Loss, ...] = ("l1", "l2", "huber", "soft_l1")
T = np.linspace(0.0, 3.0, 200)


def curve(x):
    return x[0] * np.exp(-x[1] * T)


def noisy(seed, sigma=0.05, outliers=0.0):
    rng = np.random.default_rng(seed)
    y = curve([2.0, 0.8]) + sigma * rng.standard_normal(len(T))
    wrong = rng.random(len(T)) < outliers
    return np.where(wrong, y + 3.0, y)


def fitted(y, loss, sigma=0.05, start=(1.0, 0.3)):
    def residuals(candidates):
        return np.stack([(y - curve(x)) / sigma for x in candidates])[..., None]

    return m_estimate(residuals, lambda x, d: x + d, np.array(start), 2, loss)


def test_least_squares_is_least_squares():
    y = noisy(0)
    found = fitted(y, "l2")
    oracle = least_squares(lambda x: (y - curve(x)) / 0.05, [1.0, 0.3])
    np.testing.assert_allclose(found.x, oracle.x, atol=1e-5)
    assert found.converged


@pytest.mark.parametrize(("loss", "c"), [("huber", 1.345), ("soft_l1", 1.0)])
def test_robust_minimum_is_that_of_scipy(loss, c):
    y = noisy(1, outliers=0.1)
    found = fitted(y, loss)
    oracle = least_squares(
        lambda x: (y - curve(x)) / 0.05, [1.0, 0.3], loss=loss, f_scale=c * found.scale, xtol=1e-12, ftol=1e-12
    )
    np.testing.assert_allclose(found.x, oracle.x, atol=1e-4)


def test_l1_is_the_least_sum_of_absolute_values():
    y = noisy(2, outliers=0.2)
    x = fitted(y, "l1").x
    least = np.abs(y - curve(x)).sum()
    around = [np.abs(y - curve(x + d)).sum() for d in 0.02 * np.random.default_rng(0).standard_normal((200, 2))]
    assert least <= min(around) * (1 + 1e-3)


@pytest.mark.parametrize("loss", ["l1", "huber", "soft_l1"])
def test_outliers_pull_less(loss):
    y = noisy(3, outliers=0.15)
    error = np.abs(fitted(y, loss).x - [2.0, 0.8]).max()
    assert error < 0.15 * np.abs(fitted(y, "l2").x - [2.0, 0.8]).max() + 0.03


@pytest.mark.parametrize("loss", LOSSES)
def test_covariance_is_that_of_the_errors(loss):
    nees = []
    for seed in range(120):
        found = fitted(noisy(seed), loss)
        error = found.x - [2.0, 0.8]
        nees.append(error @ np.linalg.solve(found.cov, error) / 2.0)
    assert 0.7 < np.mean(nees) < 1.3


def test_understated_noise_widens_the_covariance():
    stated, understated = fitted(noisy(4), "huber"), fitted(noisy(4), "huber", sigma=0.01)
    assert understated.scale == pytest.approx(5.0, rel=0.2)
    np.testing.assert_allclose(understated.cov, stated.cov, rtol=0.25)


def test_errors_in_common_widen_the_covariance():
    rng = np.random.default_rng(5)
    group = np.arange(len(T)) // 20
    y = curve([2.0, 0.8]) + np.repeat(0.05 * rng.standard_normal(10), 20)
    found = fitted(y, "l2")
    assert np.trace(grouped_cov(found, group)) > 5.0 * np.trace(found.cov)
    np.testing.assert_array_equal(grouped_cov(found, np.zeros(len(T), dtype=np.intp)), found.cov)


@pytest.mark.parametrize(("loss", "k", "value"), [("l2", 1, 1.0), ("l1", 1, np.pi / 2), ("huber", 1, 1 / 0.95)])
def test_inefficiency(loss, k, value):
    assert inefficiency(loss, k) == pytest.approx(value, rel=0.03)
