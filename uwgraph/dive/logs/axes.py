"""Axes by name: what turns vectors, matrices and attitudes to our forward-right-down and north-east-down."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.dive.layout import full_from_upper
from uwgraph.types import FloatArray

_FORWARD, _RIGHT, _DOWN = np.eye(3)
_DIRECTIONS: Final = {
    "f": _FORWARD,
    "r": _RIGHT,
    "d": _DOWN,
    "b": -_FORWARD,
    "l": -_RIGHT,
    "u": -_DOWN,
    "n": _FORWARD,
    "e": _RIGHT,
    "s": -_FORWARD,
    "w": -_RIGHT,
}


def turn(axes: str) -> FloatArray:
    """Matrix to FRD (or NED) of the axes that the letters name, shape (3, 3): ``flu``, ``enu``."""
    return np.stack([_DIRECTIONS[letter] for letter in axes], axis=-1)


def turned_covariance(upper: FloatArray, axes: str) -> FloatArray:
    """Covariances in FRD or NED, shape (N, 3, 3), of xx, xy, xz, yy, yz, zz in ``axes``, shape (N, 6)."""
    R = turn(axes)
    cov: FloatArray = R @ full_from_upper(upper) @ R.T
    return cov


def turned_attitude(xyzw: FloatArray, axes: str, world: str) -> FloatArray:
    """R_nb, shape (N, 3, 3), of quaternions of ``axes`` against ``world``, shape (N, 4), none of length zero."""
    R: FloatArray = turn(world) @ Rotation.from_quat(xyzw).as_matrix() @ turn(axes).T
    return R
