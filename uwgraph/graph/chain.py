"""A fixed-lag window as a chain of eliminated keyframes: what an update costs does not grow with the dive.

Every keyframe is a link: its variables, the factors whose earliest variable they are, and what is left of those
factors when its variables have been eliminated by QR: conditionals, and a message to later links (square-root
information; Bierman 1977, Dellaert & Kaess 2017, chapter 3). A new keyframe eliminates the one before it and itself.
A late measurement makes the factors of its own link anew, which are eliminated from there on, and nothing before it.
Forgetting the oldest link drops its conditionals, and its message stays: that is marginalisation, and no other
computation is needed for it.

A chain is not changed but followed by another that shares its links: to undo an update is to keep the chain before it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property

import gtsam
import numpy as np

from uwgraph.errors import SolveError
from uwgraph.graph.marginals import marginal_covariances
from uwgraph.types import FloatArray

Factors = Mapping[int, Sequence[gtsam.NonlinearFactor]]
"""All factors of some links, by the number of the link."""
Thresholds = Mapping[str, FloatArray]
"""By the symbol of a variable, how far each number of its step may be before it is linearised anew, shape (d,)."""


@dataclass(frozen=True, eq=False)
class Link:
    """One keyframe, or the variables of one moment."""

    keys: tuple[int, ...]
    """Its variables in the order of their elimination."""
    factors: tuple[gtsam.NonlinearFactor, ...] = ()
    """Those whose earliest variable is one of its own."""
    heritage: tuple[gtsam.NonlinearFactor, ...] = ()
    """What forgotten links told of it and of later ones."""
    linear: gtsam.GaussianFactorGraph = field(default_factory=gtsam.GaussianFactorGraph)
    """Factors and heritage where the chain is linearised; not to be changed."""
    conditionals: gtsam.GaussianBayesNet = field(default_factory=gtsam.GaussianBayesNet)
    """Its variables given later ones; empty in the last link."""
    message: tuple[gtsam.GaussianFactor, ...] = ()
    """What it tells of later variables."""

    @cached_property
    def reach(self) -> frozenset[int]:
        """All variables of its factors and its heritage."""
        return frozenset().union(*(factor.keys() for factor in (*self.factors, *self.heritage)))

    def linearized(self, at: gtsam.Values) -> Link:
        """Linearised there; it has to be eliminated again."""
        linear = gtsam.GaussianFactorGraph()
        for factor in (*self.factors, *self.heritage):
            linear.push_back(factor.linearize(at))
        return replace(self, linear=linear, conditionals=gtsam.GaussianBayesNet(), message=())

    @property
    def is_eliminated(self) -> bool:
        """Whether its conditionals and its message are there."""
        return bool(self.conditionals.size())

    def told(self, message: Iterable[gtsam.GaussianFactor]) -> gtsam.GaussianFactorGraph:
        """Its factors and what earlier links tell."""
        system = gtsam.GaussianFactorGraph()
        system.push_back(self.linear)
        for factor in message:
            system.push_back(factor)
        return system

    def eliminated(self, message: Iterable[gtsam.GaussianFactor]) -> Link:
        """Its variables eliminated, given what earlier links tell."""
        with _solvable(self.keys):
            conditionals, left = self.told(message).eliminatePartialSequential(_ordering(self.keys), gtsam.EliminateQR)
        factors = (left.at(i) for i in range(left.size()))
        return replace(self, conditionals=conditionals, message=tuple(f for f in factors if f is not None))


@dataclass(frozen=True, eq=False)
class Chain:
    """A window of links, all but the last one eliminated."""

    at: gtsam.Values
    """Where it is linearised; not to be changed."""
    links: tuple[Link, ...] = ()
    shared: tuple[int, ...] = ()
    """Variables of the whole dive, such as a calibration: never forgotten, eliminated last."""

    first: int = 0
    """Number of the first link that has not been forgotten: the one of a chain's beginning is 0."""

    @property
    def last(self) -> int:
        """Number of the last link."""
        return self.first + len(self.links) - 1

    def extended(self, keys: Sequence[int], values: gtsam.Values, factors: Factors) -> Chain:
        """With a link at its end, and all factors of the links that this changes: of the one before it, as a rule.

        Parameters
        ----------
        keys
            The new link's variables, in the order of their elimination.
        values
            Their first guess, and that of shared variables that the chain does not have yet.
        factors
            By the number of the link that has their earliest variable; shared variables are later than all others.

        Raises
        ------
        KeyError
            When a link has been forgotten, or a factor is not of its variables and later ones.
        SolveError
            When nothing measures a variable that is to be eliminated.
        """
        at = gtsam.Values(self.at)
        at.insert(values)
        shared = (*self.shared, *sorted(set(values.keys()) - set(keys)))
        return replace(self, at=at, links=(*self.links, Link(tuple(keys))), shared=shared).rebuilt(factors)

    def rebuilt(self, factors: Factors) -> Chain:
        """With other factors in some of its links: measurements that came late.

        Raises what :meth:`extended` does.
        """
        links = list(self.links)
        for number, new in factors.items():
            self._belong(number, new)
            i = number - self.first
            links[i] = replace(links[i], factors=tuple(new)).linearized(self.at)
        return replace(self, links=_eliminated(links))

    def _belong(self, number: int, factors: Sequence[gtsam.NonlinearFactor]) -> None:
        if not self.first <= number <= self.last:
            raise KeyError(f"link {number} is not among {self.first} to {self.last}")
        own = set(self.links[number - self.first].keys)
        later = {key for link in self.links[number - self.first :] for key in link.keys} | set(self.shared)
        for keys in (set(factor.keys()) for factor in factors):
            if not keys <= later or not (keys & own or (number == self.last and keys <= set(self.shared))):
                raise KeyError(f"a factor of {_names(keys)} does not belong to link {number}")

    def forgetting(self, count: int = 1) -> Chain:
        """Without its ``count`` oldest links; what they tell of the others stays, linearised where it was."""
        chain = self
        for _ in range(min(count, len(self.links) - 1)):
            chain = chain._without_first()
        return chain

    def _without_first(self) -> Chain:
        first, second, *rest = self.links
        at = gtsam.Values(self.at)
        for key in first.keys:
            at.erase(key)
        kept = tuple(gtsam.LinearContainerFactor(factor, at) for factor in first.message)
        heir = replace(second, heritage=(*second.heritage, *kept), linear=second.told(first.message))
        return replace(self, at=at, links=(heir, *rest), first=self.first + 1)

    @cached_property
    def newest(self) -> gtsam.GaussianBayesNet:
        """The last link's variables and the shared ones, given all that the chain knows.

        Raises
        ------
        SolveError
            When nothing measures one of them.
        """
        order = [*self.links[-1].keys, *self.shared]
        message = self.links[-2].message if len(self.links) > 1 else ()
        with _solvable(order):
            return self.links[-1].told(message).eliminateSequential(_ordering(order), gtsam.EliminateQR)

    def covariances(self) -> Mapping[int, FloatArray]:
        """Of the last link's variables and the shared ones, in the axes of their tangents."""
        return marginal_covariances(self.newest)

    @cached_property
    def step(self) -> gtsam.VectorValues:
        """From where it is linearised to the estimate, for every variable of the window."""
        step = self.newest.optimize()
        for link in reversed(self.links[:-1]):
            step = link.conditionals.optimize(step)
        return step

    def estimate(self) -> gtsam.Values:
        """The estimate of every variable of the window."""
        return self.at.retract(self.step)

    def newest_estimate(self) -> gtsam.Values:
        """The estimate of the last link's variables and the shared ones: nothing before it is asked."""
        keys = [*self.links[-1].keys, *self.shared]
        return self.at.extract(keys).retract(self.newest.optimize())

    def relinearized(self, thresholds: Thresholds) -> Chain:
        """Linearised at the estimate, from the first link on that has moved further than ``thresholds`` allow."""
        far = {key for key in self.variables if _beyond(self.step.at(key), thresholds, key)}
        if not far:
            return self
        if far & set(self.shared):
            low = 0
        else:
            low = min(i for i, link in enumerate(self.links) if far.intersection(link.keys))
        moved = {key for link in self.links[low:] for key in link.keys} | set(self.shared if low == 0 else ())
        step = gtsam.VectorValues()
        for key in moved:
            step.insert(key, self.step.at(key))
        at = self.at.retract(step)
        stale = [i for i, link in enumerate(self.links) if moved & link.reach]
        links = [link.linearized(at) if i in stale else link for i, link in enumerate(self.links)]
        return replace(self, at=at, links=_eliminated(links))

    @property
    def variables(self) -> list[int]:
        """Of the window, the shared ones last."""
        return [*(key for link in self.links for key in link.keys), *self.shared]


def _eliminated(links: list[Link]) -> tuple[Link, ...]:
    """The links with all but the last one eliminated, anew from the first one on that is not."""
    first = next((i for i, link in enumerate(links) if not link.is_eliminated), len(links))
    for i in range(first, len(links) - 1):
        links[i] = links[i].eliminated(links[i - 1].message if i else ())
    return tuple(links)


@contextmanager
def _solvable(keys: Iterable[int]) -> Iterator[None]:
    """GTSAM tells of a system without a unique solution in more than one way."""
    try:
        yield
    except (RuntimeError, ValueError) as failure:
        why = str(failure).strip().splitlines()[0]
        raise SolveError(f"the window has no unique solution: {why}", where=f"variables {_names(keys)}") from None


def _names(keys: Iterable[int]) -> str:
    return ", ".join(f"{chr(gtsam.symbolChr(key))}{gtsam.symbolIndex(key)}" for key in keys)


def _ordering(keys: Iterable[int]) -> gtsam.Ordering:
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering


def _beyond(step: FloatArray, thresholds: Thresholds, key: int) -> bool:
    limit = thresholds.get(chr(gtsam.symbolChr(key)))
    return limit is not None and bool(np.any(np.abs(step) > limit))
