"""Why a graph has no unique solution: which variable, when, which of its factors, and what nothing measures.

QR tells a false alarm (tight bias walks that only Cholesky stumbles over) from a true freedom: the diagonal of R is
scaled by its column, so that units cancel, and a freedom is a row that vanishes.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from uwgraph.graph.builder import DVL_CALIBRATION, Problem
from uwgraph.graph.columns import SMALLEST_NORM, column_norms, damped
from uwgraph.time import isoformat

DIRECTIONS = {
    "x": ("rotation about body x", "rotation about body y", "rotation about body z", "x", "y", "z"),
    "v": ("velocity north", "velocity east", "velocity down"),
    "b": ("accelerometer bias x", "y", "z", "gyro bias x", "y", "z"),
    "c": ("DVL scale", "DVL misalignment x", "y", "z"),
}
KINDS = {"x": "pose", "v": "velocity", "b": "IMU bias", "c": "DVL calibration"}
SINGULAR = 1e-10
"""A direction that keeps less than this part of its column's length is not measured."""
HELD = 1e-13
"""Every column is held by this part of its length: a row of R that vanished would keep what it knows of later ones."""


@dataclass(frozen=True)
class Freedom:
    """One direction that nothing measures."""

    variable: str
    """As in ``pose 12``."""
    time: str
    direction: str
    strength: float
    """What is left of the direction's column, 0 (free) to 1."""
    factors: tuple[str, ...]
    """Kinds of the factors on the variable."""


@dataclass(frozen=True)
class Diagnosis:
    """What is wrong with a graph, if anything."""

    freedoms: tuple[Freedom, ...]
    false_alarm: bool
    """QR solves it: a failure reported by a Cholesky solver is one of rounding."""
    condition: float
    """Smallest strength found: 1e-16 is singular, below 1e-12 badly conditioned."""

    @property
    def where(self) -> str:
        if not self.freedoms:
            return "the graph"
        first = self.freedoms[0]
        return f"{first.variable} at {first.time}"

    @property
    def remedy(self) -> str:
        if not self.freedoms:
            return "check the noise settings of the rig and the dive with `uwgraph check`"
        first = self.freedoms[0]
        held = ", ".join(first.factors) or "no factor at all"
        return f"nothing measures {first.direction} (held by {held}): add a stream that does, or a tighter prior"


def diagnose(problem: Problem) -> Diagnosis:
    """Find the directions that a graph leaves free at its first guess."""
    linear = problem.linearize(problem.values)
    norms = column_norms(linear, problem.values)
    held = damped(linear, norms, HELD**2)
    bayes_net = held.eliminateSequential(problem.ordering(held), gtsam.EliminateQR)
    freedoms = []
    weakest = 1.0
    for i in range(bayes_net.size()):
        conditional = bayes_net.at(i)
        key = conditional.firstFrontalKey()
        R = np.abs(np.diag(conditional.R()))
        strength = R / np.maximum(norms[key], SMALLEST_NORM)
        weakest = min(weakest, float(strength.min()))
        freedoms += [_freedom(problem, linear, key, d, s) for d, s in enumerate(strength) if not s > SINGULAR]
    freedoms.sort(key=lambda f: f.strength)
    return Diagnosis(tuple(freedoms), not freedoms, weakest)


def _freedom(problem: Problem, linear: gtsam.GaussianFactorGraph, key: int, d: int, strength: float) -> Freedom:
    kind, index = chr(gtsam.symbolChr(key)), gtsam.symbolIndex(key)
    name = "DVL calibration" if key == DVL_CALIBRATION else f"{KINDS[kind]} {index}"
    time = isoformat(int(problem.keyframes[index])) if kind != "c" else "all times"
    graph = [problem.graph.at(i) for i in range(problem.graph.size())]
    on_it = sorted({_kind_of(factor) for factor in graph if key in list(factor.keys())})
    return Freedom(name, time, DIRECTIONS[kind][d], strength, tuple(on_it))


def _kind_of(factor: gtsam.NonlinearFactor) -> str:
    return type(factor).__name__
