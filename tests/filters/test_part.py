"""The unscented transform over a part of a state: that of the whole state where it is linear, and better where not."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.filters import part, unscented
from uwgraph.filters.state import Belief, State
from uwgraph.filters.unscented import Spread
from uwgraph.types import FloatArray

SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=40, deadline=None)
SPREAD = Spread()


def belief(rng: np.random.Generator, n: int) -> Belief:
    x = State(np.empty((0, 3, 3)), rng.normal(size=n), np.empty(0, dtype=np.int64))
    return Belief(0, x, np.tril(rng.normal(size=(n, n))))


@given(SEEDS, st.integers(2, 12), st.data())
@FEW
def test_turning_the_root_changes_no_covariance(seed: int, n: int, data: st.DataObject):
    before = belief(np.random.default_rng(seed), n)
    at = np.array(data.draw(st.lists(st.integers(0, n - 1), min_size=1, max_size=n, unique=True)))
    facing = part.facing(before, at)
    np.testing.assert_allclose(facing.P, before.P, atol=1e-12)
    np.testing.assert_array_equal(facing.S[at, len(at) :], 0.0)
    np.testing.assert_allclose(part.lowered(facing).P, before.P, atol=1e-12)


@given(SEEDS, st.integers(2, 12), st.integers(1, 3), st.data())
@FEW
def test_a_linear_measurement_is_that_of_the_kalman_filter(seed: int, n: int, m: int, data: st.DataObject):
    rng = np.random.default_rng(seed)
    before = belief(rng, n)
    at = np.array(data.draw(st.lists(st.integers(0, n - 1), min_size=1, max_size=n, unique=True)))
    H, z = rng.normal(size=(m, len(at))), rng.normal(size=m)
    facing = part.facing(before, at)
    seen = part.sight(lambda x: x.y[:, at] @ H.T - z, len(at), SPREAD)(facing)
    after = unscented.moved_by(facing, seen, seen.with_noise(np.eye(m)))

    full = np.zeros((m, n))
    full[:, at] = H
    K = before.P @ full.T @ np.linalg.inv(full @ before.P @ full.T + np.eye(m))
    np.testing.assert_allclose(after.x.y, before.x.y - K @ (full @ before.x.y - z), atol=1e-8)
    np.testing.assert_allclose(after.P, before.P - K @ full @ before.P, atol=1e-8)


@given(SEEDS, st.integers(1, 5), st.integers(0, 8))
@FEW
def test_a_linear_motion_of_the_first_numbers_carries_the_others_along(seed: int, k: int, others: int):
    rng = np.random.default_rng(seed)
    n = k + others
    before, F, noise = belief(rng, n), np.eye(k + others), np.zeros((k, k + others))
    F[:k, :k], noise[:, :k] = rng.normal(size=(k, k)), rng.normal(size=(k, k))

    def motion(x: State) -> State:
        return State(x.R, x.y @ F.T, x.rot)

    after = part.predict(before, 7, k, motion, noise, SPREAD)
    assert after.t_ns == 7
    np.testing.assert_allclose(after.x.y, F @ before.x.y, atol=1e-10)
    np.testing.assert_allclose(after.P, F @ before.P @ F.T + noise.T @ noise, atol=1e-9)


def test_a_large_map_does_not_spoil_the_heading():
    """A chord over an uncertain heading, against sampling: the whole state's sigma points are far too wide."""
    sigma, others = 0.25, 150

    def ahead(x: State) -> State:
        y = x.y.copy()
        y[:, 0] += 10.0 * np.cos(x.y[:, 1])
        return State(x.R, y, x.rot)

    S = np.diag(np.r_[0.1, sigma, np.ones(others)])
    before = Belief(0, State(np.empty((0, 3, 3)), np.zeros(2 + others), np.empty(0, dtype=np.int64)), S)
    none: FloatArray = np.zeros((0, 2 + others))
    mean = 10.0 * np.exp(-0.5 * sigma**2)  # of a cosine over a normal angle
    alone = part.predict(before, 1, 2, ahead, none, SPREAD).x.y[0]
    whole = unscented.predict(before, 1, ahead, none, SPREAD.of(2 + others)).x.y[0]
    assert abs(alone - mean) < 0.01
    assert abs(whole - mean) > 10.0 * abs(alone - mean)
