"""Bringing a solution onto a reference before comparing: not at all, by its first position, by a turn, or rigidly.

Every alignment hides something. ``origin`` hides a constant offset, ``yaw`` a constant error of heading as well, and
``se3`` a constant tilt on top: exactly what an absolute heading reference improves. None is the default.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from uwgraph.errors import ConfigError
from uwgraph.evaluate.reference import ReferenceAt, known_rows
from uwgraph.frames import matrix_from_rph
from uwgraph.types import FloatArray, Solution

Alignment = Literal["none", "origin", "yaw", "se3"]

HIDES = {
    "origin": "a constant offset of position",
    "yaw": "a constant error of heading and of position",
    "se3": "a constant error of heading, tilt and position",
}
"""What each alignment takes away from the errors."""


def align(solution: Solution, truth: ReferenceAt, how: Alignment = "none") -> Solution:
    """The solution moved onto the reference, by least squares over all matched positions, without scale.

    Parameters
    ----------
    how : {"none", "origin", "yaw", "se3"}
        ``origin`` shifts the first matched position onto the reference; ``yaw`` turns about the vertical of the
        dive's origin and shifts; ``se3`` turns about any axis and shifts (Umeyama 1991), which needs heights.

    Raises
    ------
    ConfigError
        When there is no such alignment, or the positions do not determine it.
    """
    if how not in get_args(Alignment):
        raise ConfigError(
            f"unknown alignment {how!r}", where="alignment", remedy=f"use one of: {', '.join(get_args(Alignment))}"
        )
    matched = known_rows(truth.p_n if how == "se3" else truth.p_n[:, :2]) & known_rows(solution.p_n[:, :2])
    if how == "none" or (how != "se3" and not matched.any()):
        return solution
    have, want = solution.p_n[matched], truth.p_n[matched]
    if how == "origin":
        return replace(solution, p_n=solution.p_n + _known(want[0] - have[0]))
    R = matrix_from_rph(np.array([0.0, 0.0, _turn(have, want)])) if how == "yaw" else _rotation(have, want)
    p_n = solution.p_n @ R.T
    shift = _known((want - p_n[matched]).mean(axis=0))
    return replace(solution, R_nb=R @ solution.R_nb, p_n=p_n + shift, v_n=solution.v_n @ R.T)


def _turn(have: FloatArray, want: FloatArray) -> float:
    """Angle about down that turns the first track onto the second in the plane, rad."""
    a, b = have[:, :2] - have[:, :2].mean(axis=0), want[:, :2] - want[:, :2].mean(axis=0)
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    return float(np.arctan2(sine, np.sum(a * b)))


def _rotation(have: FloatArray, want: FloatArray) -> FloatArray:
    """Rotation of the first track onto the second, shape (3, 3) (Umeyama 1991, eq. 40 to 43, without scale)."""
    flaw = "too few positions with heights are matched"
    if len(have) >= 3:
        U, spread, Vt = np.linalg.svd((want - want.mean(axis=0)).T @ (have - have.mean(axis=0)))
        if spread[1] > 1e-9 * spread[0]:
            R: FloatArray = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))]) @ Vt
            return R
        flaw = "the track is straight: nothing tells its roll"
    raise ConfigError(f"se3 is not determined: {flaw}", where="alignment", remedy="align by yaw, origin, or not at all")


def _known(shift: FloatArray) -> FloatArray:
    """No shift along an axis that the reference does not know."""
    return np.nan_to_num(shift, nan=0.0)
