"""The metric: learnt along its axes, Euclidean across them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.decomposition import PCA

from uwgraph.places.metric import Metric, principal_components, symmetric_root


def drawn(rng: np.random.Generator, D: int, P: int) -> tuple[Metric, np.ndarray]:
    """A metric with P random axes of D, and its M along them."""
    A = rng.normal(size=(P, P))
    M = A @ A.T
    C = np.linalg.qr(rng.normal(size=(D, P)))[0].T
    arrays = rng.normal(size=D), C, symmetric_root(M) - np.eye(P)
    return Metric(*(array.astype(np.float32) for array in arrays), scale=float(rng.uniform(0.5, 3.0))), M


@given(seed=st.integers(0, 10_000), D=st.integers(1, 40), share=st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_distances_are_those_of_m_along_the_axes_and_plain_across_them(seed: int, D: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    P = round(share * D)
    metric, M = drawn(rng, D, P)
    C = metric.components.astype(float)
    whole = np.eye(D) + C.T @ (M - np.eye(P)) @ C
    X = rng.normal(size=(5, D)).astype(np.float32)
    y = X + (X - metric.mean) @ C.T @ metric.change @ C
    d = X[0].astype(float) - X[1]
    assert np.sum((y[0] - y[1]) ** 2) == pytest.approx(d @ whole @ d, rel=1e-3, abs=1e-3)
    z = metric.project(X)
    np.testing.assert_allclose(z, metric.scale * y / np.linalg.norm(y, axis=1, keepdims=True), atol=1e-3)
    np.testing.assert_allclose(metric.project(X[2]), z[2], atol=1e-5)
    assert (metric.size, z.dtype) == (D, np.float32)


def test_across_the_axes_nothing_changes_but_the_length() -> None:
    rng = np.random.default_rng(0)
    metric, _ = drawn(rng, 30, 6)
    across = np.linalg.svd(metric.components)[2][6:]
    x = metric.mean + (rng.normal(size=(8, 24)) @ across).astype(np.float32)
    unit = x / np.linalg.norm(x, axis=1, keepdims=True)
    np.testing.assert_allclose(metric.project(x), metric.scale * unit, atol=1e-5)


def test_a_descriptor_of_zeros_stays_a_number() -> None:
    metric = Metric(np.zeros(4, np.float32), np.eye(2, 4, dtype=np.float32), np.zeros((2, 2), np.float32), 1.0)
    np.testing.assert_array_equal(metric.project(np.zeros(4)), np.zeros(4))


@pytest.mark.parametrize(("n", "D", "count"), [(60, 10, 4), (12, 50, 5), (12, 50, 64), (60, 10, 64), (2, 3, 1)])
def test_principal_axes_are_those_of_scikit_learn(n: int, D: int, count: int) -> None:
    rng = np.random.default_rng(n)
    X = (3.0 + rng.normal(size=(n, D)) * np.linspace(3.0, 1.0, D)).astype(np.float32)
    mean, axes = principal_components(X, count)
    most = min(count, n - 1, D)
    pca = PCA(most, svd_solver="full").fit(X.astype(float))
    assert axes.shape == (most, D)
    np.testing.assert_allclose(mean, pca.mean_, atol=1e-5)
    np.testing.assert_allclose(axes @ axes.T, np.eye(most), atol=1e-5)
    np.testing.assert_allclose(np.abs(np.sum(axes * pca.components_, axis=1)), 1.0, atol=1e-4)


def test_samples_in_a_plane_have_two_axes_and_the_same_sample_has_none() -> None:
    rng = np.random.default_rng(1)
    plane = np.linalg.qr(rng.normal(size=(20, 2)))[0].T
    X = (rng.normal(size=20) + rng.normal(size=(30, 2)) @ plane).astype(np.float32)
    axes = principal_components(X, 8)[1]
    assert len(axes) == 2
    np.testing.assert_allclose(axes.T @ axes, plane.T @ plane, atol=1e-4)
    for n in (1, 7, 1000):
        assert principal_components(np.repeat(X[:1], n, axis=0), 8)[1].shape == (0, 20)


@given(seed=st.integers(0, 10_000), size=st.integers(0, 12), rank=st.integers(0, 12))
@settings(max_examples=40, deadline=None)
def test_the_root_is_symmetric_and_its_square_is_m(seed: int, size: int, rank: int) -> None:
    A = np.random.default_rng(seed).normal(size=(size, min(rank, size)))
    S = symmetric_root(A @ A.T)
    np.testing.assert_allclose(S @ S, A @ A.T, atol=1e-9)
    np.testing.assert_allclose(S, S.T, atol=1e-9)
    assert np.all(np.linalg.eigvalsh(S) > -1e-9)
