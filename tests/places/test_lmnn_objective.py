"""The objective against the equation written out, its gradients against finite differences, impostors in blocks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.places import lmnn_impostors, lmnn_objective
from uwgraph.places.lmnn_impostors import class_starts, impostors, target_neighbours
from uwgraph.places.lmnn_objective import Objective, add_laplacian, factor


def problem(seed, n=30, d=5, p=5, classes=3, k=3, shrinkage=0.7, push_weight=0.4):
    rng = np.random.default_rng(seed)
    labels = np.sort(rng.integers(classes, size=n))
    labels = np.unique(labels, return_inverse=True)[1]
    X, starts = rng.normal(size=(n, d)), class_starts(labels)
    L = rng.normal(size=(p, d))
    return Objective(X, starts, target_neighbours(X, starts, k), push_weight, shrinkage, L), labels, rng


def written_out(objective, labels, M):
    """The equation, term by term."""
    X, mu = objective.X, objective.push_weight

    def d(i, j):
        return (X[i] - X[j]) @ M @ (X[i] - X[j])

    total = 0.0
    for i, targets in enumerate(objective.targets):
        for j in targets[targets >= 0]:
            total += (1.0 - mu) * d(i, j)
            total += mu * sum(max(0.0, 1.0 + d(i, j) - d(i, l)) for l in np.flatnonzero(labels != labels[i]))  # noqa: E741
    M_0 = objective.start.T @ objective.start
    return total + objective.shrinkage * len(X) * np.sum((M - M_0) ** 2) / np.sum(M_0**2)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(1, 4), st.integers(1, 4))
def test_value_is_the_equation(seed, p, classes, k):
    objective, labels, rng = problem(seed, n=14, p=p, classes=classes, k=k)
    L = rng.normal(size=(p, 5))
    expected = written_out(objective, labels, L.T @ L)
    assert objective.of_components(L)[0] == pytest.approx(expected, rel=1e-10)
    assert objective.of_metric(L.T @ L)[0] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("p", [2, 5])
def test_gradient_in_L_is_the_finite_difference(seed, p):
    objective, _, rng = problem(seed, p=p)
    L, step = rng.normal(size=(p, 5)), 1e-6
    gradient = objective.of_components(L)[1]
    for index in np.ndindex(L.shape):
        E = np.zeros_like(L)
        E[index] = step
        ahead, behind = objective.of_components(L + E)[0], objective.of_components(L - E)[0]
        assert gradient[index] == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5, abs=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_gradient_in_M_is_the_finite_difference(seed):
    objective, _, rng = problem(seed)
    L, step = rng.normal(size=(7, 5)), 1e-6
    M = L.T @ L
    gradient = objective.of_metric(M)[1]
    np.testing.assert_allclose(gradient, gradient.T, rtol=1e-10)
    for _ in range(10):
        E = rng.normal(size=(5, 5))
        E += E.T
        ahead, behind = objective.of_metric(M + step * E)[0], objective.of_metric(M - step * E)[0]
        assert np.sum(gradient * E) == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5)


def test_chain_rule_between_the_two_gradients():
    objective, _, rng = problem(0)
    L = rng.normal(size=(3, 5))
    np.testing.assert_allclose(objective.of_components(L)[1], 2.0 * L @ objective.of_metric(L.T @ L)[1], rtol=1e-8)


def test_convex_in_M():
    objective, _, rng = problem(1)
    for _ in range(20):
        A, B = (rng.normal(size=(5, 5)) for _ in range(2))
        A, B = A.T @ A, B.T @ B
        middle = objective.of_metric(0.5 * (A + B))[0]
        assert middle <= 0.5 * (objective.of_metric(A)[0] + objective.of_metric(B)[0]) * (1.0 + 1e-12)


def brute_force_pairs(Y, labels, radius):
    d = ((Y[:, None] - Y[None]) ** 2).sum(axis=-1)
    return set(zip(*np.nonzero((d < radius[:, None]) & (labels[:, None] != labels)), strict=True))


@pytest.mark.parametrize("block", [1, 137, 1 << 20])
@pytest.mark.parametrize("spread", [1.0, 1e4], ids=["single precision", "double precision"])
@pytest.mark.parametrize("reach", [0.5, 20.0], ids=["few", "many"])
def test_impostors_are_those_of_brute_force(monkeypatch, block, spread, reach):
    monkeypatch.setattr(lmnn_impostors, "BLOCK", block)
    rng = np.random.default_rng(2)
    labels = np.unique(np.sort(rng.integers(6, size=50)), return_inverse=True)[1]
    Y = rng.normal(size=(50, 4))
    Y[:, 0] += spread * (np.arange(50) % 2)
    radius = reach * rng.uniform(0.5, 2.0, size=50)
    radius[::7] = -np.inf
    found = list(impostors(Y, class_starts(labels), radius))
    pairs = {(int(i) + part.rows.start, int(j)) for part in found for i, j in zip(part.i, part.l, strict=True)}
    assert pairs == brute_force_pairs(Y, labels, radius)
    for part in found:
        d = ((Y[part.rows][part.i] - Y[part.l]) ** 2).sum(axis=1)
        np.testing.assert_allclose(part.distance, d, atol=1e-12 * (Y**2).sum(axis=1).max())


@pytest.mark.parametrize("dense", [0.0, 1.0])
def test_laplacian_of_a_block(monkeypatch, dense):
    monkeypatch.setattr(lmnn_objective, "DENSE", dense)
    rng = np.random.default_rng(0)
    Z, rows = rng.normal(size=(9, 3)), slice(2, 6)
    i, j, weight = np.sort(rng.integers(4, size=20)), rng.integers(9, size=20), rng.normal(size=20)
    expected = np.zeros((9, 9))
    for a, b, w in zip(i + 2, j, weight, strict=True):
        e = np.zeros(9)
        e[a] += 1.0
        e[b] -= 1.0
        expected += w * np.outer(e, e)
    out = np.ones_like(Z)
    add_laplacian(out, Z, rows, i, j, weight)
    np.testing.assert_allclose(out, 1.0 + expected @ Z, atol=1e-12)


def test_target_neighbours_stay_in_the_class_and_are_the_nearest():
    rng = np.random.default_rng(0)
    labels = np.repeat([0, 1, 2], [10, 3, 1])
    Y = rng.normal(size=(14, 2))
    targets = target_neighbours(Y, class_starts(labels), 4)
    assert np.sum(targets[:10] >= 0) == 40
    assert np.sum(targets[10:13] >= 0) == 6
    assert np.all(targets[13] == -1)
    for i, row in enumerate(targets):
        mine = row[row >= 0]
        assert i not in mine
        assert np.all(labels[mine] == labels[i])
        others = np.flatnonzero((labels == labels[i]) & (np.arange(14) != i))
        d = ((Y[others] - Y[i]) ** 2).sum(axis=1)
        assert set(mine) == set(others[np.argsort(d)][: len(mine)])


def test_factor_is_the_root_of_the_positive_part():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(4, 4))
    M = A + A.T
    L = factor(M)
    values, vectors = np.linalg.eigh(M)
    np.testing.assert_allclose(L.T @ L, (vectors * np.maximum(values, 0.0)) @ vectors.T, atol=1e-12)
    assert np.all(np.diff((L**2).sum(axis=1)) <= 1e-12)
