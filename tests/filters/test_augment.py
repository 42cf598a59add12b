"""A state that grows and shrinks: covariances against the equations, and against each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.filters.augment import augmented, without
from uwgraph.filters.state import Belief, State
from uwgraph.types import FloatArray

SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=40, deadline=None)


def belief(rng: np.random.Generator, n: int, rotations: int = 0) -> Belief:
    """Any belief; its rotations stand first."""
    R = Rotation.random(rotations, rng=rng).as_matrix() if rotations else np.empty((0, 3, 3))
    y = rng.normal(size=n)
    y[: 3 * rotations] = 0.0
    return Belief(0, State(R, y, 3 * np.arange(rotations)), np.tril(rng.normal(size=(n, n))))


def drawn(rng: np.random.Generator, *shape: int) -> FloatArray:
    return rng.normal(size=shape)


@given(SEEDS, st.integers(1, 9), st.integers(1, 5), st.integers(1, 7))
@FEW
def test_what_is_seen_gets_the_covariance_of_the_equation(seed: int, n: int, k: int, rows: int):
    rng = np.random.default_rng(seed)
    before, J, noise, y = belief(rng, n), drawn(rng, k, n), drawn(rng, rows, k), drawn(rng, k)
    after = augmented(before, y, J, noise)
    P = before.P
    expected = np.block([[P, P @ J.T], [J @ P, J @ P @ J.T + noise.T @ noise]])
    np.testing.assert_allclose(after.P, expected, atol=1e-10)
    np.testing.assert_array_equal(after.x.y, np.concatenate([before.x.y, y]))
    np.testing.assert_array_equal(after.S, np.tril(after.S))


@given(SEEDS, st.integers(2, 9), st.data())
@FEW
def test_dropping_is_forgetting(seed: int, n: int, data: st.DataObject):
    rng = np.random.default_rng(seed)
    size = data.draw(st.integers(1, n - 1))
    at = data.draw(st.integers(0, n - size))
    before = belief(rng, n)
    after = without(before, at, size)
    keep = np.r_[0:at, at + size : n]
    np.testing.assert_allclose(after.P, before.P[np.ix_(keep, keep)], atol=1e-12)
    np.testing.assert_array_equal(after.x.y, before.x.y[keep])
    np.testing.assert_array_equal(after.S, np.tril(after.S))


@given(SEEDS, st.integers(1, 6), st.integers(1, 4))
@FEW
def test_dropping_what_was_appended_gives_the_belief_back(seed: int, n: int, k: int):
    rng = np.random.default_rng(seed)
    before = belief(rng, n)
    back = without(augmented(before, drawn(rng, k), drawn(rng, k, n), drawn(rng, 2, k)), n, k)
    np.testing.assert_allclose(back.P, before.P, atol=1e-12)
    np.testing.assert_array_equal(back.x.y, before.x.y)


def test_a_remembered_pose_is_a_copy_with_its_rotation():
    rng = np.random.default_rng(0)
    before = belief(rng, 9, rotations=1)
    J = np.eye(6, 9)
    after = augmented(before, before.x.y[:6], J, R=before.x.R[0])
    assert after.x.rot.tolist() == [0, 9]
    np.testing.assert_array_equal(after.x.R[1], before.x.R[0])
    difference = np.hstack([J, -np.eye(6)])
    np.testing.assert_allclose(difference @ after.P @ difference.T, 0.0, atol=1e-14)
    # what moves the two as their covariance says keeps them the same
    moved = after.x.plus(after.S @ drawn(rng, 15))
    np.testing.assert_allclose(moved.R[0], moved.R[1], atol=1e-12)


@pytest.mark.parametrize("dropped", [0, 1, 2])
def test_rotations_behind_what_is_dropped_move_up(dropped: int):
    rng = np.random.default_rng(1)
    grown = belief(rng, 9, rotations=1)
    for _ in range(2):
        grown = augmented(grown, grown.x.y[:6], drawn(rng, 6, grown.x.size), drawn(rng, 6, 6), R=grown.x.R[0])
    starts = [0, 9, 15]
    after = without(grown, starts[dropped], 6)
    assert after.x.rot.tolist() == {0: [3, 9], 1: [0, 9], 2: [0, 9]}[dropped]
    np.testing.assert_array_equal(after.x.R, np.delete(grown.x.R, dropped, axis=0))
    assert after.x.plus(drawn(rng, after.x.size)).R.shape == (2, 3, 3)
