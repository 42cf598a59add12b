"""Column norms of a linear system, by variable, and damping in proportion to them."""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np

from uwgraph.types import FloatArray

SMALLEST_NORM = 1e-6
"""A column without any factor counts as this long."""


def column_norms(linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> dict[int, FloatArray]:
    """Norm of every column of the whitened system, by variable: the root of the information's diagonal."""
    zero = values.zeroVectors()
    squares = {key: np.zeros(len(zero.at(key))) for key in values.keys()}  # noqa: SIM118
    for i in range(linear.size()):
        factor = linear.at(i)
        columns = (factor.jacobian()[0] ** 2).sum(axis=0)
        for key in factor.keys():  # noqa: SIM118
            width = len(squares[key])
            squares[key] += columns[:width]
            columns = columns[width:]
    return {key: np.sqrt(s) for key, s in squares.items()}


def damped(
    linear: gtsam.GaussianFactorGraph, norms: Mapping[int, FloatArray], damping: float
) -> gtsam.GaussianFactorGraph:
    """The system with sqrt(damping) times the root of the information's diagonal added to every variable."""
    system = linear.clone()
    for key, norm in norms.items():
        A = np.diag(np.sqrt(damping) * np.maximum(norm, SMALLEST_NORM))
        system.push_back(gtsam.JacobianFactor(key, A, np.zeros(len(A)), gtsam.noiseModel.Unit.Create(len(A))))
    return system
