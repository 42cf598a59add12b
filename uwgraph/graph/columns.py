"""Column norms of a linear system, by variable."""

from __future__ import annotations

import gtsam
import numpy as np

from uwgraph.types import FloatArray


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
