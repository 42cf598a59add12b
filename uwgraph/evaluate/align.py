"""Bringing a solution onto a reference before comparing: not at all, by its first position, or by a turn as well.

A full SE(3) alignment is not offered: it hides exactly what an absolute heading reference improves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from uwgraph.errors import ConfigError
from uwgraph.evaluate.reference import ReferenceAt
from uwgraph.frames import matrix_from_rph
from uwgraph.types import FloatArray, Solution

Alignment = Literal["none", "origin", "yaw"]


def align(solution: Solution, truth: ReferenceAt, how: Alignment = "none") -> Solution:
    """The solution moved onto the reference.

    Parameters
    ----------
    how : {"none", "origin", "yaw"}
        ``origin`` shifts the first matched position onto the reference; ``yaw`` turns about the vertical of the
        dive's origin and shifts, least squares over all matched positions (Umeyama 1991, in the plane, no scale).
    """
    if how == "none":
        return solution
    matched = truth.has_position
    if not matched.any():
        return solution
    have, want = solution.p_n[matched], truth.p_n[matched]
    if how == "origin":
        return replace(solution, p_n=solution.p_n + _known(want[0] - have[0]))
    if how == "yaw":
        R = matrix_from_rph(np.array([0.0, 0.0, _turn(have, want)]))
        p_n = solution.p_n @ R.T
        shift = _known((want - p_n[matched]).mean(axis=0))
        return replace(solution, R_nb=R @ solution.R_nb, p_n=p_n + shift, v_n=solution.v_n @ R.T)
    raise ConfigError(f"unknown alignment {how!r}", where="alignment", remedy="use one of: none, origin, yaw")


def _turn(have: FloatArray, want: FloatArray) -> float:
    """Angle about down that turns the first track onto the second in the plane, rad."""
    a, b = have[:, :2] - have[:, :2].mean(axis=0), want[:, :2] - want[:, :2].mean(axis=0)
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    return float(np.arctan2(sine, np.sum(a * b)))


def _known(shift: FloatArray) -> FloatArray:
    """No shift along an axis that the reference does not know."""
    return np.nan_to_num(shift, nan=0.0)
