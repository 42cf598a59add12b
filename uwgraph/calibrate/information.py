"""What one dive says about the rig: the graph with the rig's numbers as one more variable, all states eliminated."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from uwgraph.calibrate.column_noise import reliability
from uwgraph.calibrate.columns import rig_columns
from uwgraph.calibrate.parameters import Parameter
from uwgraph.graph.smooth import Smoothed
from uwgraph.types import FloatArray

RIG = gtsam.symbol("r", 0)
CLEAR = 0.9
"""Share of a column that is motion: of a dive with turns 0.99, of a straight run 0."""


@dataclass(frozen=True, eq=False)
class Information:
    """Of the parameters' changes from where the dive was linearised, each in units of its prior sigma; priors apart."""

    matrix: FloatArray
    """Shape (n, n)."""
    vector: FloatArray
    """Shape (n,): the change that the dive asks for is matrix^-1 vector."""


def rig_information(
    smoothed: Smoothed,
    parameters: Sequence[Parameter],
    from_reference: Collection[str] = (),
    quiet: Collection[int] = (),
) -> Information:
    """Marginal information of the parameters from a dive's measurements.

    ``from_reference`` names the streams that were made from the reference: the parameters of that sensor move them.
    Of the parameters ``quiet``, which nothing else has found in this motion, it says something only where their columns
    are motion for the most part (:data:`CLEAR`). Elimination is by QR, with the rig last; the step in the states that
    goes with it is not taken. What is noise in a column is no information: it is taken off in proportion.
    """
    linear = smoothed.problem.linearize(smoothed.solved.values)
    scale = np.array([p.prior for p in parameters])
    plain = rig_columns(smoothed, linear, parameters, from_reference)
    n = len(parameters)
    if not plain:
        return Information(np.zeros((n, n)), np.zeros(n))
    share = reliability(smoothed, linear, plain, parameters, from_reference)
    share[[i for i in quiet if share[i] < CLEAR]] = 0.0
    motion = np.sqrt(share)
    columns = {i: block * scale for i, block in plain.items()}
    augmented = gtsam.GaussianFactorGraph()
    for i in range(linear.size()):
        factor = linear.at(i)
        augmented.push_back(_with_rig(factor, columns[i]) if i in columns else factor)
    ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(augmented, [RIG])
    states = gtsam.Ordering()
    for k in range(ordering.size() - 1):
        states.push_back(ordering.at(k))
    _, left = augmented.eliminatePartialSequential(states, gtsam.EliminateQR)
    matrix, vector = np.zeros((n, n)), np.zeros(n)
    for i in range(left.size()):
        A, b = left.at(i).jacobian()
        matrix += A.T @ A
        vector += A.T @ b
    return Information(matrix * np.outer(motion, motion), vector * motion)


def _with_rig(factor: gtsam.GaussianFactor, columns: FloatArray) -> gtsam.JacobianFactor:
    A, b = factor.jacobian()
    keys = factor.keys()
    unit = gtsam.noiseModel.Unit.Create(len(b))
    if len(keys) == 1:
        return gtsam.JacobianFactor(keys[0], A, RIG, columns, b, unit)
    return gtsam.JacobianFactor(keys[0], A[:, :6], keys[1], A[:, 6:], RIG, columns, b, unit)
