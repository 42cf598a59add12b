"""Closures that do not lie: which places seen again the trajectory may rest on, and why the others not.

In this order, after Kimera-RPGO (Rosinol, Abate, Chang & Carlone, ICRA 2020): verified by the front end; in agreement
with the dive's own odometry; in agreement with each other (:mod:`uwgraph.graph.consistency`); fitting the trajectory
that all of them make (:mod:`uwgraph.graph.gnc`). In doubt a closure is given up: where as many closures speak against
one as for it, it is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uwgraph.graph.builder import Problem
from uwgraph.graph.clique import contested, max_clique
from uwgraph.graph.consistency import Loops, Odometry, against_odometry, consistent_pairs
from uwgraph.graph.gnc import graduate, poses_of, squared_residuals
from uwgraph.graph.joint import joint_poses
from uwgraph.graph.relative import BetweenKeyframes, closures_at_keyframes
from uwgraph.graph.settings import SmoothSettings
from uwgraph.graph.solver import Solved
from uwgraph.graph.track import Track
from uwgraph.types import ClosureVerdicts, RelativePoses

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Closed:
    """A problem solved with its closures."""

    problem: Problem
    solved: Solved
    verdicts: ClosureVerdicts
    """One row for every closure of the stream, in its order."""


def close_loops(
    problem: Problem,
    solved: Solved,
    track: Track,
    closures: RelativePoses,
    settings: SmoothSettings,
    solve: Callable[[Problem], Solved],
) -> Closed:
    """Decide about every closure and solve again with those that are believed.

    Parameters
    ----------
    problem, solved, track
        The dive without closures, its solution, and that as a track.
    solve
        Solves a problem from its own first guess.
    """
    record = _Record(closures)
    found = closures_at_keyframes(closures, problem.keyframes, track)
    found = found.select(closures.accepted[found.sample])
    record.reason[found.sample] = f"left out: {settings.max_closures} others, evenly spaced, were judged"
    found = _evenly(found, settings.max_closures)
    if not len(found):
        return Closed(problem, solved, record.verdicts())

    odometry, loops = _odometry(problem, solved, found)
    alone = against_odometry(odometry, loops, settings.closure_gate)
    record.chi2_odometry[found.sample] = alone.d2
    record.reason[found.sample] = "contradicts what the dive says without closures"

    inside = np.flatnonzero(alone.accepted)
    agree = consistent_pairs(odometry, loops.select(inside), settings.closure_pairs)
    largest = max_clique(agree)
    doubted = contested(agree, largest)
    record.reason[found.sample[inside[~largest]]] = "contradicts the largest set of closures that agree"
    record.reason[found.sample[inside[largest & doubted]]] = "as many closures speak against it as for it"

    believed = found.select(inside[largest & ~doubted])
    if not len(believed):
        record.chi2[found.sample] = squared_residuals(solved.values, found)
        return Closed(problem, solved, record.verdicts())
    fitted = graduate(problem, solved.values, believed, settings.closure_inliers, solve)
    record.chi2[found.sample] = squared_residuals(fitted.solved.values, found)
    record.weight[believed.sample] = fitted.weight
    accepted = believed.sample[fitted.weight > 0.0]
    record.reason[believed.sample] = "does not fit the trajectory that the others make"
    record.reason[accepted] = _in_agreement(len(accepted) - 1)
    return Closed(fitted.problem, fitted.solved, record.verdicts())


class _Record:
    """What becomes of every closure of a stream: rejected until something else is said."""

    def __init__(self, closures: RelativePoses) -> None:
        N = len(closures)
        self.closures = closures
        self.reason = np.full(N, "its moments are not of two keyframes of the solution", dtype=np.object_)
        unverified = np.flatnonzero(~closures.accepted)
        self.reason[unverified] = [f"its geometry was not verified: {closures.reason[n]}" for n in unverified]
        self.weight = np.zeros(N)
        self.chi2_odometry = np.full(N, np.nan)
        self.chi2 = np.full(N, np.nan)

    def verdicts(self) -> ClosureVerdicts:
        return ClosureVerdicts(
            self.closures.t_ns,
            from_ns=self.closures.from_ns,
            accepted=self.weight > 0.0,
            reason=self.reason.astype(np.str_),
            weight=self.weight,
            chi2_odometry=self.chi2_odometry,
            chi2=self.chi2,
        )


def _in_agreement(others: int) -> str:
    if others == 0:
        return "agrees with what the dive says without closures; no other closure to hold it against"
    return f"agrees with what the dive says without closures, and with {others} others"


def _evenly(closures: BetweenKeyframes, most: int) -> BetweenKeyframes:
    """At most so many, evenly spaced."""
    if len(closures) <= most:
        return closures
    return closures.select(np.linspace(0, len(closures) - 1, most).round().astype(np.intp))


def _odometry(problem: Problem, solved: Solved, closures: BetweenKeyframes) -> tuple[Odometry, Loops]:
    """What the solution without closures knows of their ends."""
    ends, place = np.unique(np.concatenate([closures.i, closures.j]), return_inverse=True)
    N = len(closures)
    odometry = Odometry(poses_of(solved.values, ends), joint_poses(problem, solved.values, ends.tolist()).cov)
    return odometry, Loops(place[:N], place[N:], closures.T, closures.cov)
