"""Estimators that go wrong, each in its own way."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import NoReturn

import numpy as np

from uwgraph.errors import SolveError
from uwgraph.filters import ESTIMATORS, Estimate, EstimatorSettings, Named
from uwgraph.filters.estimate import Task

Progress = Callable[[str, float], None]


def killed(task: Task, settings: EstimatorSettings, progress: Progress) -> NoReturn:
    progress("about to die", 0.5)
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def leaves(task: Task, settings: EstimatorSettings, progress: Progress) -> NoReturn:
    sys.exit(3)


def stumbles(task: Task, settings: EstimatorSettings, progress: Progress) -> NoReturn:
    raise ZeroDivisionError("by zero")


def refuses(task: Task, settings: EstimatorSettings, progress: Progress) -> NoReturn:
    raise SolveError("the matrix is singular", where="x7")


def diverges(task: Task, settings: EstimatorSettings, progress: Progress) -> Estimate:
    estimate = ESTIMATORS["dr"].run(task, settings, progress)
    p_n = estimate.solution.p_n.copy()
    p_n[-1] = np.nan
    return replace(estimate, solution=replace(estimate.solution, p_n=p_n))


BAD = {f.__name__: Named(f"one that {f.__name__}", True, f) for f in (killed, leaves, stumbles, refuses, diverges)}
