"""Largest cliques against trying all sets."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.graph.clique import essential, max_clique
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


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 10**6), N=st.integers(0, 9), density=st.floats(0.0, 1.0))
def test_equal_to_trying_all(seed: int, N: int, density: float) -> None:
    joined = graph(seed, N, density)
    largest = all_largest(joined)
    size = len(largest[0])
    found = max_clique(joined)
    assert set(found.tolist()) in largest
    assert len(max_clique(joined, at_least=size)) == size
    assert len(max_clique(joined, at_least=size + 1)) == 0
    core, one = essential(joined)
    assert set(np.flatnonzero(one).tolist()) in largest
    assert set(np.flatnonzero(core).tolist()) == set.intersection(*largest)


def test_a_planted_clique_among_hundreds() -> None:
    rng = np.random.default_rng(5)
    joined = graph(5, 400, 0.3)
    planted = np.sort(rng.choice(400, 60, replace=False))
    joined[np.ix_(planted, planted)] = True
    np.testing.assert_array_equal(max_clique(joined), planted)
    core, _ = essential(joined)
    np.testing.assert_array_equal(np.flatnonzero(core), planted)


def test_with_few_branches_a_clique_all_the_same() -> None:
    joined = graph(7, 120, 0.8)
    found = max_clique(joined, max_branches=50)
    assert len(found) > 5
    assert joined[np.ix_(found, found)][~np.eye(len(found), dtype=np.bool_)].all()


def test_two_that_contradict_each_other_are_not_essential() -> None:
    core, one = essential(np.zeros((2, 2), dtype=np.bool_))
    assert one.sum() == 1
    assert not core.any()
