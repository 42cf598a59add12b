"""Our own Gauss-Newton loop, damped after Levenberg and Marquardt when steps fail.

GTSAM's optimisers eliminate by Cholesky, which fails on tight bias walks, and copy all values for every Python factor.
This loop eliminates by QR, reports progress, keeps a trace, and stops on time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from uwgraph.errors import SolveError
from uwgraph.graph.builder import Problem
from uwgraph.graph.columns import column_norms, damped
from uwgraph.graph.settings import SmoothSettings

FIRST_DAMPING = 1e-4
LAST_DAMPING = 1e8
LOOK_AHEAD = 3
"""Undamped steps that are allowed to go up ..."""
CRAWLED = 2
"""... after so many damped ones in a row: what is merely curved needs a damped step or two."""


@dataclass(frozen=True)
class Iteration:
    """One line of the trace."""

    number: int
    error: float
    step: float
    """Largest component of the step: rad, m, m/s or bias."""
    damping: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Solved:
    """Where the loop ended and how it went."""

    values: gtsam.Values
    trace: tuple[Iteration, ...]
    converged: bool
    why: str


def solve(problem: Problem, settings: SmoothSettings, progress: Callable[[float], None]) -> Solved:
    """Minimise the problem's error from its first guess.

    Raises
    ------
    SolveError
        When the error is not finite or the linear system cannot be solved; :func:`uwgraph.graph.diagnose.diagnose`
        tells why.
    """
    start = time.monotonic()
    values, error = problem.values, problem.error(problem.values)
    if not np.isfinite(error):
        raise SolveError("the error of the first guess is not finite", remedy="run `uwgraph check` on the dive")
    trace = [Iteration(0, error, np.nan, 0.0, 0.0)]
    damping = 0.0
    ordering: gtsam.Ordering | None = None
    for number in range(1, settings.max_iterations + 1):
        linear = problem.linearize(values)
        ordering = ordering or problem.ordering(linear)
        while True:
            delta = _step(linear, ordering, values, damping)
            candidate = values.retract(delta)
            new_error = problem.error(candidate)
            if _lower(new_error, error):
                break
            crawls = damping == 0.0 and all(i.damping > 0.0 for i in trace[-CRAWLED:])
            ahead = _look_ahead(problem, ordering, candidate, error) if crawls else None
            if ahead is not None:
                candidate, new_error = ahead
                break
            damping = max(10.0 * damping, FIRST_DAMPING)
            if damping > LAST_DAMPING and number == 1:
                raise SolveError("no step lowers the error of the first guess")
            if damping > LAST_DAMPING:
                return Solved(values, tuple(trace), True, "no step lowers the error any more")
        step = float(np.abs(delta.vector()).max())
        gain = error - new_error
        values, error = candidate, new_error
        trace.append(Iteration(number, error, step, damping, time.monotonic() - start))
        progress(number / settings.max_iterations)
        damping = damping / 10.0 if damping > FIRST_DAMPING else 0.0
        if step < settings.tolerance or gain <= settings.tolerance * error + 1e-9:
            return Solved(values, tuple(trace), True, "the steps are below the tolerance")
        if time.monotonic() - start > settings.time_limit_s:
            return Solved(values, tuple(trace), False, f"the time limit of {settings.time_limit_s:g} s is over")
    return Solved(values, tuple(trace), False, f"{settings.max_iterations} iterations were not enough")


def _lower(new_error: float, error: float) -> bool:
    return bool(np.isfinite(new_error)) and new_error <= error * (1.0 + 1e-12) + 1e-9


def _look_ahead(
    problem: Problem, ordering: gtsam.Ordering, values: gtsam.Values, error: float
) -> tuple[gtsam.Values, float] | None:
    """Go on undamped from where the error is higher, and see whether it soon falls below ``error``.

    A long way that turns as a whole goes up before it goes down: its positions move along tangents, which stretches
    it, and the next step puts that right (the watchdog of Chamberlain, Powell, Lemarechal & Pedersen 1982). Damping
    instead would hold every keyframe to its neighbours and take hundreds of steps.
    """
    for _ in range(LOOK_AHEAD):
        try:
            values = values.retract(_step(problem.linearize(values), ordering, values, 0.0))
        except SolveError:
            return None
        new_error = problem.error(values)
        if _lower(new_error, error):
            return values, new_error
    return None


def _step(
    linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering, values: gtsam.Values, damping: float
) -> gtsam.VectorValues:
    system = linear if damping == 0.0 else damped(linear, column_norms(linear, values), damping)
    try:
        delta = system.eliminateMultifrontal(ordering, gtsam.EliminateQR).optimize()
    except RuntimeError as failure:
        raise SolveError(f"the linear system has no unique solution: {str(failure).strip().splitlines()[0]}") from None
    if not np.isfinite(delta.vector()).all():
        raise SolveError("the linear system has no unique solution")
    return delta
