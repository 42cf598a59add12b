"""What is drawn of a contest: errors and sigmas over time, histories of innovations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uwgraph.evaluate.entries import Contest, Entry
from uwgraph.evaluate.metrics import Comparison, compare, nees_bounds
from uwgraph.evaluate.people import people, sigmas
from uwgraph.types import FloatArray, Innovations, Solution, TimeArray

IndexArray = NDArray[np.intp]

QUANTITIES = (("north", "m"), ("east", "m"), ("depth", "m"), ("heading", "deg"), ("roll", "deg"), ("pitch", "deg"))
"""The columns of :class:`Course`, with their units."""


@dataclass(frozen=True, eq=False)
class Course:
    """One estimator's errors and 1-sigma at its stamps."""

    entry: Entry
    solution: Solution
    """After the alignment that the metrics were taken with."""
    comparison: Comparison | None
    """None where the dive has no reference."""
    t_s: FloatArray
    """Seconds since the start of the contest, shape (K,)."""
    error: FloatArray
    """Estimate minus reference along :data:`QUANTITIES`, shape (K, 6), m and deg; NaN where not known."""
    sigma: FloatArray
    """1-sigma along the same, shape (K, 6); NaN where not known."""

    @property
    def horizontal(self) -> FloatArray:
        """Horizontal error, shape (K,), m."""
        return np.hypot(self.error[:, 0], self.error[:, 1])


def start_ns(contest: Contest) -> int:
    """The first stamp that any estimator was judged at: zero of every time axis; 0 where there is none."""
    return min((int(entry.judged.solution.t_ns[0]) for entry in contest.entries), default=0)


def seconds(t_ns: TimeArray, start: int) -> FloatArray:
    """Seconds since the start of the contest, shape (N,)."""
    return np.asarray((t_ns - start) * 1e-9)


def course(entry: Entry, start: int) -> Course:
    """Errors and sigmas of an entry, aligned as its metrics are."""
    judged = entry.judged
    solution, comparison = judged.solution, None
    error = np.full((len(solution), len(QUANTITIES)), np.nan)
    if judged.reference is not None and len(judged.reference):
        comparison = compare(solution, judged.reference, judged.metrics.get("alignment", "none"))
        solution = comparison.solution
        error[:, :2], error[:, 2] = comparison.e_n[:, :2], comparison.e_depth
        error[:, 3:] = np.degrees(comparison.e_rph[:, [2, 0, 1]])
    read = people(solution)
    sigma = np.hstack([sigmas(read.cov_p_n), np.degrees(sigmas(read.cov_rph))[:, [2, 0, 1]]])
    return Course(entry, solution, comparison, seconds(solution.t_ns, start), error, sigma)


def courses(contest: Contest) -> list[Course]:
    """Of every entry, on one time axis."""
    start = start_ns(contest)
    return [course(entry, start) for entry in contest.entries]


def reach(course: Course, column: int) -> float:
    """How far a panel must reach for one estimator: its errors whole, its 3-sigma unless five times as wide."""
    largest = np.nanmax(np.abs(course.error[:, column]), initial=0.0)
    wide = 3.0 * course.sigma[np.isfinite(course.sigma[:, column]), column]
    top = float(np.quantile(wide, 0.98)) if len(wide) else 0.0
    return float(max(largest, min(top, 5.0 * largest) if largest > 0.0 else top))


def frame(reaches: Sequence[float]) -> float:
    """Half the height of a panel of several estimators: six times the middle one's reach at most.

    One that has lost its way must not make lines of zero of all the others.
    """
    known = sorted(reach for reach in reaches if reach > 0.0)
    return min(known[-1], 6.0 * known[(len(known) - 1) // 2]) if known else 1.0


def peaks(values: FloatArray, limit: int) -> IndexArray:
    """At most ``limit`` + 2 rows to draw: of every bunch of neighbours the one that stands out most, and both ends."""
    n = len(values)
    if n <= limit:
        return np.arange(n)
    height = np.nan_to_num(np.abs(values.reshape(n, -1)))
    height = (height / np.maximum(np.sqrt(np.mean(height**2, axis=0)), 1e-300)).max(axis=1)
    size = -(-n // limit)
    bunches = np.pad(height, (0, -n % size), constant_values=-1.0).reshape(-1, size)
    return np.unique(np.concatenate([[0], bunches.argmax(axis=1) + np.arange(len(bunches)) * size, [n - 1]]))


def evenly(n: int, limit: int) -> IndexArray:
    """At most ``limit`` of n rows, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, limit)).round().astype(np.intp))


@dataclass(frozen=True, eq=False)
class Running:
    """A running mean of NIS over the last measurements that were used."""

    t_s: FloatArray
    nis: FloatArray
    window: int
    """Measurements in a mean."""
    bounds: tuple[float, float]
    """95 % interval of such a mean, were the innovations white and the noise as believed."""


@dataclass(frozen=True, eq=False)
class History:
    """What a filter made of one sensor."""

    kind: str
    t_s: FloatArray
    of: Innovations
    """This sensor's alone."""
    running: Running | None
    """None where fewer than two measurements were used."""

    @property
    def axes(self) -> int:
        """Dimension of the largest measurement."""
        return int(self.of.dof.max())

    @property
    def refused(self) -> int:
        return int((~self.of.accepted).sum())

    @property
    def mean_nis(self) -> float | None:
        """Of the measurements that were used."""
        used = self.of.nis[self.of.accepted & np.isfinite(self.of.nis)]
        return float(used.mean()) if len(used) else None


def histories(innovations: Innovations | None, start: int) -> Iterator[History]:
    """Of every sensor of a filter, in the order in which they first spoke."""
    if innovations is None or not len(innovations):
        return
    kinds, first = np.unique(innovations.kind, return_index=True)
    for kind in kinds[np.argsort(first)]:
        mine = innovations.select(innovations.kind == kind)
        mine = mine.select(np.argsort(mine.t_ns, kind="stable"))  # late ones stand where they were taken
        t_s = seconds(mine.t_ns, start)
        yield History(str(kind), t_s, mine, _running(t_s, mine))


def _running(t_s: FloatArray, of: Innovations) -> Running | None:
    used = of.accepted & np.isfinite(of.nis)
    count = int(used.sum())
    if count < 2:
        return None
    window = int(np.clip(count // 20, min(count, 5), 50))
    m = of.dof[used].astype(np.float64)
    total, weight = (np.cumsum(np.append(0.0, x)) for x in (of.nis[used] * m, m))
    mean = (total[window:] - total[:-window]) / (weight[window:] - weight[:-window])
    bounds = nees_bounds(1, runs=round(window * float(np.median(m))))
    return Running(t_s[used][window - 1 :], mean, window, bounds)
