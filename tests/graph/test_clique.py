"""Largest cliques against trying all sets."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.graph.clique import contested, max_clique
from uwgraph.types import BoolArray


def graph(seed: int, N: int, density: float) -> BoolArray:
    above = np.triu(np.random.default_rng(seed).random((N, N)) < density, 1)
    joined: BoolArray = above | above.T
    return joined


def all_largest(joined: BoolArray) -> list[set[int]]:
    for size in range(len(joined), 0, -1):
        found = [
            set(s) for s in combinations(range(len(joined)), size) if all(joined[a, b] for a, b in combinations(s, 2))
        ]
        if found:
            return found
    return [set()]


@settings(max_examples=120, deadline=None)
@given(seed=st.integers(0, 10**6), N=st.integers(0, 9), density=st.floats(0.0, 1.0))
def test_equal_to_trying_all(seed: int, N: int, density: float) -> None:
    joined = graph(seed, N, density)
    assert set(np.flatnonzero(max_clique(joined)).tolist()) in all_largest(joined)


@settings(max_examples=120, deadline=None)
@given(seed=st.integers(0, 10**6), N=st.integers(1, 9), density=st.floats(0.0, 1.0))
def test_only_what_another_largest_clique_does_without_is_contested(seed: int, N: int, density: float) -> None:
    joined = graph(seed, N, density)
    clique = max_clique(joined)
    in_all = set.intersection(*all_largest(joined))
    assert not in_all & set(np.flatnonzero(contested(joined, clique)).tolist())


def cluster_graph(sizes: list[int]) -> BoolArray:
    """Groups that agree within and with nobody else."""
    of = np.repeat(np.arange(len(sizes)), sizes)
    joined: BoolArray = of[:, None] == of
    return joined


@pytest.mark.parametrize(("sizes", "doubted"), [([1, 1], 1), ([3, 3], 3), ([3, 2], 0), ([5, 4, 1], 0), ([4, 2, 4], 4)])
def test_groups_as_large_as_the_largest_put_it_in_doubt(sizes: list[int], doubted: int) -> None:
    joined = cluster_graph(sizes)
    clique = max_clique(joined)
    assert clique.sum() == max(sizes)
    assert contested(joined, clique).sum() == doubted


def test_a_local_tie_leaves_the_others_alone() -> None:
    """Three against three at one place, with which fifty elsewhere have no quarrel."""
    joined = np.ones((56, 56), dtype=np.bool_)
    joined[50:53, 53:] = joined[53:, 50:53] = False
    clique = max_clique(joined)
    assert clique.sum() == 53
    np.testing.assert_array_equal(np.flatnonzero(contested(joined, clique)), np.flatnonzero(clique)[-3:])


def test_a_planted_clique_among_hundreds() -> None:
    joined = graph(5, 400, 0.3)
    planted = np.sort(np.random.default_rng(5).choice(400, 60, replace=False))
    joined[np.ix_(planted, planted)] = True
    clique = max_clique(joined)
    np.testing.assert_array_equal(np.flatnonzero(clique), planted)
    assert not contested(joined, clique).any()


def test_few_conflicts_among_many_are_decided_without_a_search() -> None:
    """Two hundred that agree, and groups that contradict some of them: branch and bound alone would not end."""
    rng = np.random.default_rng(2)
    joined = np.ones((280, 280), dtype=np.bool_)
    for start in range(200, 280, 8):
        against = rng.choice(200, 30, replace=False)
        group = np.arange(start, start + 8)
        joined[np.ix_(group, against)] = joined[np.ix_(against, group)] = False
    clique = max_clique(joined, max_branches=0)
    np.testing.assert_array_equal(np.flatnonzero(clique), np.arange(200))


def test_with_few_branches_a_clique_all_the_same() -> None:
    joined = graph(7, 120, 0.8)
    found = np.flatnonzero(max_clique(joined, max_branches=50))
    assert len(found) > 5
    assert joined[np.ix_(found, found)][~np.eye(len(found), dtype=np.bool_)].all()
