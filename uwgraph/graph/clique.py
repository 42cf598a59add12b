"""The largest set of vertices that are all joined to each other.

Branch and bound with greedy colouring on bit sets (Tomita & Seki, DMTCS 2003; San Segundo, Rodriguez-Losada & Jimenez,
Computers & OR 2011): exact for the hundreds of closures of a dive; a limit on the branches keeps the worst cases, where
the best clique found so far is then the answer, to seconds.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from uwgraph.types import BoolArray

IndexArray = NDArray[np.intp]

MAX_BRANCHES = 200_000


def max_clique(joined: BoolArray, at_least: int = 1, max_branches: int = MAX_BRANCHES) -> IndexArray:
    """Indices, increasing, of the largest clique of a symmetric adjacency matrix, shape (N, N).

    Where several are equally large, the one found first: greedy, from the best connected vertex on. Empty where there
    is none of ``at_least`` vertices.
    """
    joined = joined & ~np.eye(len(joined), dtype=np.bool_)
    order = np.argsort(-joined.sum(axis=1), kind="stable")
    rows = np.packbits(joined[np.ix_(order, order)], axis=1, bitorder="little")
    search = _Search([int.from_bytes(row.tobytes(), "little") for row in rows], at_least - 1, max_branches)
    search.expand([], (1 << len(joined)) - 1)
    return np.sort(order[search.best])


def essential(joined: BoolArray) -> tuple[BoolArray, BoolArray]:
    """What all largest cliques have in common, and one of these, as masks of shape (N,).

    A vertex of the largest clique is not essential where one just as large does without it.
    """
    clique = max_clique(joined)
    largest = np.zeros(len(joined), dtype=np.bool_)
    largest[clique] = True
    core = largest.copy()
    for vertex in clique[~joined[clique].all(axis=1)]:
        others = np.delete(np.arange(len(joined)), vertex)
        core[vertex] = not len(max_clique(joined[np.ix_(others, others)], at_least=len(clique)))
    return core, largest


class _Search:
    """One search: the best clique so far and how many branches are left."""

    def __init__(self, neighbours: list[int], enough: int, branches: int) -> None:
        self.neighbours = neighbours
        self.size = enough
        self.branches = branches
        self.best: list[int] = []

    def expand(self, clique: list[int], candidates: int) -> None:
        """Try every candidate that could still lead to a larger clique, the most promising first."""
        if len(clique) > self.size:
            self.best, self.size = clique, len(clique)
        for vertex, colour in reversed(list(self._coloured(candidates))):
            if len(clique) + colour <= self.size or self.branches <= 0:
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
