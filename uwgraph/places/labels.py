"""Which images show the same place, by their positions: the labels that a metric is learnt from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uwgraph.types import FloatArray

Labels = NDArray[np.intp]
NO_PLACE = -1


def places_of(positions: FloatArray, radius: float) -> Labels:
    """The place of every position (N, 2) or (N, 3), shape (N,): its nearest centre.

    Centres are taken along the way, each a position further than ``radius`` [m] from all before it.
    """
    centres: list[int] = []
    nearest = np.full(len(positions), np.inf)
    labels = np.zeros(len(positions), np.intp)
    for i in range(len(positions)):
        if nearest[i] > radius:
            distance = np.linalg.norm(positions - positions[i], axis=1)
            labels[distance < nearest] = len(centres)
            nearest = np.minimum(nearest, distance)
            centres.append(i)
    return labels


def places_apart(positions: FloatArray, radius: float, gap: float, rng: np.random.Generator) -> Labels:
    """Some places that no position within ``gap`` [m] separates, shape (N,); :data:`NO_PLACE` for what lies between.

    Two images a step apart show the same scene, on whichever side of a border of :func:`places_of` they were taken. As
    impostors they would teach a metric to tell apart what is alike. Here every member of a place is within ``radius``
    of its centre and further than ``gap`` from every member of others; the centres are drawn at random, so that many
    draws use every image.
    """
    labels = np.full(len(positions), NO_PLACE, np.intp)
    taken = np.full(len(positions), np.inf)  # distance from the nearest member of any place
    count = 0
    for i in rng.permutation(len(positions)):
        members = np.flatnonzero(np.linalg.norm(positions - positions[i], axis=1) <= radius)
        if len(members) < 2 or taken[members].min() <= gap:
            continue
        labels[members] = count
        count += 1
        for member in members:
            taken = np.minimum(taken, np.linalg.norm(positions - positions[member], axis=1))
    return labels
