"""Checks for anybody's own measurement: do its Jacobians fit its residual, and does the native factor equal it?"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import gtsam
import numpy as np

from factors.adapter import Measurement, numerical_jacobians
from factors.lie import FloatArray


def check_jacobians(
    measurement: Measurement, states: Iterable[Sequence[Any]], tolerance: float = 1e-6, step: float = 1e-5
) -> float:
    """Compare a measurement's Jacobians with central differences.

    Parameters
    ----------
    states
        Each a tuple of the measurement's variables.
    tolerance
        Allowed difference, relative to the largest entry of the Jacobian or 1.

    Returns
    -------
    float
        The worst difference found.

    Raises
    ------
    AssertionError
        Naming the measurement, the variable and the difference.
    """
    worst = 0.0
    for state in states:
        numerical = numerical_jacobians(measurement, *state, step=step)
        for n, (J, J_num) in enumerate(zip(measurement.jacobians(*state), numerical, strict=True)):
            worst = max(worst, _compare(J, J_num, tolerance, f"{type(measurement).__name__}: Jacobian {n}"))
    return worst


def check_equivalence(
    reference: gtsam.NonlinearFactor,
    lowered: gtsam.NonlinearFactor,
    values: Iterable[gtsam.Values],
    tolerance: float = 1e-9,
) -> float:
    """Compare two factors by what an optimiser sees: the error, and A^T A, A^T b of the linearisation.

    The rows may differ by a rotation, or by rows of zeros.

    Parameters
    ----------
    tolerance
        Allowed difference, relative to the largest entry or 1.

    Returns
    -------
    float
        The worst difference found.

    Raises
    ------
    AssertionError
        Naming what differs and by how much.
    """
    worst = 0.0
    for v in values:
        worst = max(worst, _compare(lowered.error(v), reference.error(v), tolerance, "error"))
        found, expected = (f.linearize(v).augmentedInformation() for f in (lowered, reference))
        worst = max(worst, _compare(found, expected, tolerance, "augmented information [A b]^T [A b]"))
    return worst


def _compare(found: FloatArray | float, expected: FloatArray | float, tolerance: float, what: str) -> float:
    """Largest difference relative to the largest expected entry or 1."""
    if np.shape(found) != np.shape(expected):
        raise AssertionError(f"{what}: shape {np.shape(found)}, expected {np.shape(expected)}")
    difference = float(np.max(np.abs(np.subtract(found, expected))) / max(1.0, np.max(np.abs(expected))))
    if not difference <= tolerance:
        raise AssertionError(f"{what} differs by {difference:.3g}, allowed {tolerance:.3g}:\n{found}\n{expected}")
    return difference
