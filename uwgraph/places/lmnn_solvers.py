"""Two ways down the objective of large-margin nearest neighbours; on both it never rises.

The hinges make it piecewise smooth. With thousands of terms it looks smooth to the line searches, and where it does
not, no step is found and the last good point stays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from uwgraph.places.lmnn_objective import Objective, factor
from uwgraph.types import FloatArray

Progress = Callable[[FloatArray, float], None]
"""Called with L and the objective after every iteration."""

ROOT = float(np.sqrt(2.0))
SCALINGS = 40
LOOK_BACK = 5
"""Iterations over which the projected gradient's fall is judged: single steps of its length rule may be short."""
SUFFICIENT = 1e-4
"""Armijo's constant."""
LEAST_STEP = 1e-12
"""Of the first step: below it no descent is left."""


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a solver ended."""

    L: FloatArray
    converged: bool


def best_multiple(objective: Objective, L: FloatArray) -> FloatArray:
    """L times the power of sqrt(2) below which pull and push do not fall (they are convex in the square of it).

    The margin is 1 whatever the data's unit; without this, the first iterations only find the scale.
    """
    best = objective.pull_and_push(objective.X @ L.T)
    for ratio in (ROOT, 1.0 / ROOT):
        for _ in range(SCALINGS):
            value = objective.pull_and_push(objective.X @ (ratio * L).T)
            if value >= best:
                break
            L, best = ratio * L, value
    return L


def lbfgs(objective: Objective, L: FloatArray, max_iter: int, tol: float, progress: Progress) -> Descent:
    """Limited-memory BFGS on L, of any rank; ends when an iteration's relative fall is below ``tol``."""
    n, shape = len(objective.X), L.shape

    def mean(flat: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = objective.of_components(flat.reshape(shape))
        return value / n, gradient.ravel() / n

    def tell(intermediate_result: OptimizeResult) -> None:
        progress(intermediate_result.x.reshape(shape), n * intermediate_result.fun)

    options = {"maxiter": max_iter, "maxfun": 100 * max_iter, "ftol": tol, "gtol": 0.0}
    result = minimize(mean, L.ravel(), jac=True, method="L-BFGS-B", callback=tell, options=options)
    return Descent(result.x.reshape(shape), result.status != 1)


def projected(objective: Objective, L: FloatArray, max_iter: int, tol: float, progress: Progress) -> Descent:
    """Gradient steps on M = L^T L, projected onto the positive semi-definite matrices: convex.

    Steps have Barzilai and Borwein's length and are halved from the same M until the objective falls. Of the last M as
    many directions are kept as the start has.
    """
    M = L.T @ L
    value, gradient = objective.of_metric(M)
    values = [value]
    step = first = 0.1 * float(np.linalg.norm(M) / max(np.linalg.norm(gradient), np.finfo(float).tiny))
    for _ in range(max_iter):
        while True:
            trial_L = factor(M - step * gradient)
            trial = trial_L.T @ trial_L
            moved = trial - M
            trial_value, trial_gradient = objective.of_metric(trial)
            if trial_value <= value - SUFFICIENT / step * float(np.sum(moved**2)):
                break
            step /= 2.0
            if step < LEAST_STEP * first:
                return Descent(factor(M)[: len(L)], True)
        bend = float(np.sum(moved * (trial_gradient - gradient)))
        step = float(np.sum(moved**2)) / bend if bend > 0.0 else 2.0 * step
        M, value, gradient = trial, trial_value, trial_gradient
        values.append(value)
        progress(trial_L, value)
        if len(values) > LOOK_BACK and values[-1 - LOOK_BACK] - value <= tol * value:
            return Descent(factor(M)[: len(L)], True)
    return Descent(factor(M)[: len(L)], False)
