"""Several dives, one rig: information added, unknowns refused that nothing shows, dives held against each other.

All numbers here are in units of the prior sigma, counted from the start value, so that every prior is N(0, 1) and
counts once however many dives there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uwgraph.calibrate.information import Information
from uwgraph.calibrate.parameters import Parameter
from uwgraph.chi_square import chi2_quantile
from uwgraph.dive.rig import Rig
from uwgraph.types import BoolArray, FloatArray

IndexArray = NDArray[np.intp]

TOLD = 0.5
"""Posterior over prior sigma: above it the dives say less about a value than the prior did."""
SIGNIFICANCE = 0.95
"""Dives scatter more than their covariances say when chi-square is beyond this quantile."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Which unknown each parameter of each dive is."""

    parameters: tuple[Parameter, ...]
    """Of each unknown."""
    dive: tuple[int | None, ...]
    """Of each unknown; None where it is common to all dives."""
    places: tuple[IndexArray, ...]
    """For each dive, the unknown of each of its parameters."""
    limits: FloatArray
    """Useful 1-sigma of each unknown, in units of its prior; infinite for what is only estimated along."""

    @classmethod
    def of(cls, parameters: Sequence[Parameter], dives: int, *, common_clock: bool) -> Unknowns:
        """All common, but for the clocks unless ``common_clock``."""
        common = [i for i, p in enumerate(parameters) if common_clock or not p.of_a_clock]
        own = [i for i in range(len(parameters)) if i not in common]
        owners = [(parameters[i], None) for i in common] + [(parameters[i], d) for d in range(dives) for i in own]
        places = []
        for d in range(dives):
            place = np.empty(len(parameters), dtype=np.intp)
            place[common] = np.arange(len(common))
            place[own] = len(common) + d * len(own) + np.arange(len(own))
            places.append(place)
        limits = np.array([p.limit / p.prior for p, _ in owners])
        return cls(tuple(p for p, _ in owners), tuple(d for _, d in owners), tuple(places), limits)

    def __len__(self) -> int:
        return len(self.parameters)

    def values(self, rigs: Sequence[Rig]) -> FloatArray:
        """The unknowns as the dives' rigs have them, the first dive's where they are common."""
        owners = [rigs[d or 0] for d in self.dive]
        return np.array([p.value(rig) for p, rig in zip(self.parameters, owners, strict=True)])

    @property
    def priors(self) -> FloatArray:
        return np.array([p.prior for p in self.parameters])


def added(unknowns: Unknowns, dives: Sequence[Information]) -> Information:
    """The information of all dives about all unknowns, priors apart."""
    n = len(unknowns)
    matrix, vector = np.zeros((n, n)), np.zeros(n)
    for place, dive in zip(unknowns.places, dives, strict=True):
        matrix[np.ix_(place, place)] += dive.matrix
        vector[place] += dive.vector
    return Information(matrix, vector)


@dataclass(frozen=True, eq=False)
class Combined:
    """Where the unknowns should be, all of them estimated together."""

    z: FloatArray
    covariance: FloatArray
    told: BoolArray
    """Whether the dives tell it: its sigma is at most ``TOLD`` of its prior's, and of use (``limits``).

    What is not told is estimated along all the same, held by its prior: what is told is then right whatever the
    others are, and its covariance knows that they are not known.
    """

    @property
    def sigma(self) -> FloatArray:
        return np.sqrt(np.diag(self.covariance))


def combine(unknowns: Unknowns, data: Information, now: FloatArray) -> Combined:
    """The unknowns from the priors and data linearised at ``now``."""
    covariance = np.linalg.inv(data.matrix + np.eye(len(now)))
    covariance = 0.5 * (covariance + covariance.T)
    z = covariance @ (data.vector + data.matrix @ now)
    told = np.sqrt(np.diag(covariance)) <= np.minimum(TOLD, unknowns.limits)
    return Combined(z, covariance, told)


@dataclass(frozen=True, eq=False)
class Scatter:
    """One parameter over the dives that tell it."""

    dives: IndexArray
    values: FloatArray
    """What each dive alone says, its own prior taken off, shape (dives,)."""
    sigmas: FloatArray
    birge: float
    """Factor on the sigma: above 1 where the dives scatter more than their covariances say (Birge 1932)."""

    @property
    def spread(self) -> float:
        """Standard deviation of the dives; NaN of less than two."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else np.nan


def scatter(unknowns: Unknowns, dives: Sequence[Information], now: FloatArray, i: int) -> Scatter:
    """Parameter number ``i`` from each dive alone, linearised at ``now``."""
    found = []
    for d, (place, dive) in enumerate(zip(unknowns.places, dives, strict=True)):
        P = np.linalg.inv(dive.matrix + np.eye(len(place)))
        z = P @ (dive.vector + dive.matrix @ now[place])
        if np.sqrt(P[i, i]) <= TOLD:
            told = 1.0 / P[i, i] - 1.0
            found.append((d, z[i] / P[i, i] / told, told**-0.5))
    numbers = np.array([d for d, *_ in found], dtype=np.intp)
    values, sigmas = (np.array([f[i] for f in found]) for i in (1, 2))
    return Scatter(numbers, values, sigmas, _birge(values, sigmas))


def _birge(values: FloatArray, sigmas: FloatArray) -> float:
    dof = len(values) - 1
    if dof < 1:
        return 1.0
    square = float(np.sum(((values - np.average(values, weights=sigmas**-2.0)) / sigmas) ** 2))
    return float(np.sqrt(square / dof)) if square > chi2_quantile(SIGNIFICANCE, dof) else 1.0
