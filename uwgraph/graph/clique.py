"""The largest set of closures that are all consistent with each other: a maximum clique.

Where nearly all agree, that is the largest set without a conflict: linear programming by a bipartite matching decides
most of it (Nemhauser & Trotter, Mathematical Programming 1975). What is left goes to branch and bound with greedy
colouring on bit sets (Tomita & Seki, DMTCS 2003; San Segundo, Rodriguez-Losada & Jimenez, Computers & OR 2011): exact,
unless its limit on branches is reached; the best clique found so far is then the answer.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from uwgraph.types import BoolArray

MAX_BRANCHES = 20_000


def max_clique(joined: BoolArray, max_branches: int = MAX_BRANCHES) -> BoolArray:
    """Mask, shape (N,), of the largest clique of a symmetric adjacency matrix, shape (N, N)."""
    clique, open_ = _decided(_conflicts(joined))
    rest = np.flatnonzero(open_)
    clique[rest[_branch_and_bound(joined[np.ix_(rest, rest)], max_branches)]] = True
    return clique


def contested(joined: BoolArray, clique: BoolArray) -> BoolArray:
    """Mask, shape (N,), of the clique's members that others, as many at least, could stand in for.

    Greedy: around every vertex outside a set of others that agree is grown, the one with the fewest new conflicts next.
    """
    conflict = _conflicts(joined)
    doubted = np.zeros(len(joined), dtype=np.bool_)
    for first in np.flatnonzero(~clique):
        others = np.zeros(len(joined), dtype=np.bool_)
        against = np.zeros(len(joined), dtype=np.bool_)
        candidates = ~clique
        vertex = first
        while True:
            others[vertex] = True
            against |= conflict[vertex] & clique
            candidates = candidates & ~conflict[vertex] & ~others
            if others.sum() >= against.sum():
                doubted |= against
            left = np.flatnonzero(candidates)
            if not len(left):
                break
            vertex = left[np.argmin((conflict[left] & clique & ~against).sum(axis=1))]
    return doubted


def _conflicts(joined: BoolArray) -> BoolArray:
    conflict: BoolArray = ~joined & ~np.eye(len(joined), dtype=np.bool_)
    return conflict


def _decided(conflict: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Vertices that some largest set without a conflict has for sure, and those about which nothing is decided yet.

    The relaxed problem takes 0, 1/2 or 1 of every vertex; Koenig's theorem reads it off a matching of the bipartite
    double cover, and 0 and 1 stand.
    """
    match = maximum_bipartite_matching(csr_array(conflict), perm_type="column")
    left, right = match < 0, np.zeros(len(conflict), dtype=np.bool_)
    partner = np.full(len(conflict), -1)
    partner[match[~left]] = np.flatnonzero(~left)
    new = left
    while new.any():
        reached = conflict[new].any(axis=0) & ~right
        right |= reached
        new = np.zeros_like(left)
        new[partner[reached]] = True
        new &= ~left
        left = left | new
    return left & ~right, left == right


def _branch_and_bound(joined: BoolArray, max_branches: int) -> NDArray[np.intp]:
    joined = joined & ~np.eye(len(joined), dtype=np.bool_)
    order = np.argsort(-joined.sum(axis=1), kind="stable")
    rows = np.packbits(joined[np.ix_(order, order)], axis=1, bitorder="little")
    search = _Search([int.from_bytes(row.tobytes(), "little") for row in rows], max_branches)
    search.expand([], (1 << len(joined)) - 1)
    found: NDArray[np.intp] = order[search.best]
    return found


class _Search:
    """One search: the best clique so far and how many branches are left."""

    def __init__(self, neighbours: list[int], branches: int) -> None:
        self.neighbours = neighbours
        self.branches = branches
        self.best: list[int] = []

    def expand(self, clique: list[int], candidates: int) -> None:
        """Try every candidate that could still lead to a larger clique, the most promising first."""
        if len(clique) > len(self.best):
            self.best = clique
        for vertex, colour in reversed(list(self._coloured(candidates))):
            if len(clique) + colour <= len(self.best) or self.branches <= 0:
                return
            self.branches -= 1
            self.expand([*clique, vertex], candidates & self.neighbours[vertex])
            candidates &= ~(1 << vertex)

    def _coloured(self, candidates: int) -> Iterator[tuple[int, int]]:
        """Candidates by colour, from 1 on: no clique among those so far has more vertices than colours."""
        colour = 0
        while candidates:
            colour += 1
            same = candidates
            while same:
                lowest = same & -same
                vertex = lowest.bit_length() - 1
                candidates ^= lowest
                same &= ~(self.neighbours[vertex] | lowest)
                yield vertex, colour
