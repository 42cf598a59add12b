"""The nearest descriptors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.errors import DataError
from uwgraph.places.retrieval import Index


def filled(n: int, size: int = 16, seed: int = 0) -> Index:
    index = Index(size)
    Z = np.random.default_rng(seed).normal(size=(n, size))
    index.extend(Z, np.arange(n, dtype=np.int64) * 1_000_000_000)
    return index


@given(n=st.integers(0, 600), k=st.integers(0, 12), seed=st.integers(0, 99), apart=st.sampled_from([0.0, 2.5, 50.0]))
@settings(max_examples=40, deadline=None)
def test_the_nearest_are_those_of_brute_force(n: int, k: int, seed: int, apart: float) -> None:
    index = filled(n, seed=seed)
    rng = np.random.default_rng(seed + 1)
    query, now = rng.normal(size=16).astype(np.float32), int(rng.integers(0, max(n, 1))) * 1_000_000_000
    found = index.search(query, k, t_ns=now, apart_s=apart)
    distance = np.sum((index.descriptors.astype(float) - query) ** 2, axis=1)
    distance[np.abs(index.t_ns - now) < apart * 1e9] = np.inf
    expected = np.argsort(distance, kind="stable")[: min(k, np.count_nonzero(np.isfinite(distance)))]
    np.testing.assert_array_equal(found.sample, expected)
    np.testing.assert_allclose(found.distance, distance[expected])


def test_distances_are_exact_where_single_precision_cancels() -> None:
    index = Index(8)
    far = np.full(8, 1000.0, np.float32)
    index.extend(
        far + np.eye(8, dtype=np.float32)[:4] * np.array([[0.5], [0.25], [0.75], [0.125]], np.float32), np.arange(4)
    )
    found = index.search(far, 4)
    np.testing.assert_array_equal(found.sample, [3, 1, 0, 2])
    np.testing.assert_allclose(found.distance, [0.125**2, 0.25**2, 0.5**2, 0.75**2])


def test_only_what_is_asked_for_is_sought() -> None:
    index = filled(50)
    among = np.zeros(50, dtype=bool)
    among[[3, 40]] = True
    assert set(index.search(index.descriptors[7], 5, among=among).sample) == {3, 40}


def test_one_by_one_is_like_all_at_once() -> None:
    whole, single = filled(700), Index(16)
    for z, t in zip(whole.descriptors, whole.t_ns, strict=True):
        single.add(z, int(t))
    np.testing.assert_array_equal(single.descriptors, whole.descriptors)
    np.testing.assert_array_equal(single.t_ns, whole.t_ns)
    assert single.nbytes >= whole.descriptors.nbytes


@pytest.mark.parametrize("z", [np.full(16, np.nan), np.zeros(15), np.zeros((1, 16)), np.full(16, np.inf)])
def test_what_is_no_descriptor_is_refused(z: np.ndarray) -> None:
    index = filled(5)
    with pytest.raises(DataError, match="without a descriptor"):
        index.search(z)
    with pytest.raises(DataError, match="without a descriptor"):
        index.extend(z[None] if z.ndim == 1 else z[..., None], np.zeros(1, np.int64))
    assert len(index) == 5
