"""Errors as the INS literature in east, north, up writes them, from the errors of our states.

In this order: phi_E, phi_N, phi_U [rad], dv_E, dv_N, dv_U [m/s], dL, dlambda [rad], dh [m], in the local axes of the
place. phi turns the estimated attitude into the true one, C_true = (1 + [phi x]) C_estimated; errors of velocity and
position are estimated minus true. So phi' = -omega_in x phi + ... - C eps and dv' = f x phi + ... + C nabla.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from factors.lie import skew
from uwgraph.frames import WGS84, R_n_local, geodetic_from_ned
from uwgraph.types import FloatArray, Origin

ENU_FROM_NED: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def enu_jacobian(origin: Origin, R_nb: FloatArray, p_n: FloatArray, v_n: FloatArray) -> FloatArray:
    """J, shape (9, 9): J d are the errors above of a state whose tangent d leads to the truth.

    d is that of :class:`uwgraph.filters.ins.Ins`: rotation of the body, position and velocity in n.
    """
    lat, lon, height = (float(x) for x in geodetic_from_ned(origin, p_n))
    C = ENU_FROM_NED @ R_n_local(origin, lat, lon).T
    geodetic = _geodetic_from_enu(lat, height) @ C
    # the local axes turn with the place
    axes = np.array([[-1.0, 0.0, 0.0], [0.0, np.cos(lat), 0.0], [0.0, np.sin(lat), 0.0]]) @ geodetic
    J = np.zeros((9, 9))
    J[:3, :3], J[:3, 3:6] = C @ R_nb, -axes
    J[3:6, 3:6], J[3:6, 6:] = -skew(C @ v_n) @ axes, -C
    J[6:, 3:6] = -geodetic
    return J


def enu_covariance(origin: Origin, R_nb: FloatArray, p_n: FloatArray, v_n: FloatArray, P: FloatArray) -> FloatArray:
    """Covariance of the errors above from that of a state's first nine numbers, shape (9, 9)."""
    J = enu_jacobian(origin, R_nb, p_n, v_n)
    cov: FloatArray = J @ P @ J.T
    return cov


def _geodetic_from_enu(lat: float, height: float) -> FloatArray:
    """Derivative of latitude, longitude and height by metres east, north and up."""
    a, e2 = WGS84.semimajor_axis, WGS84.first_eccentricity**2
    across = a / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
    along = across**3 * (1.0 - e2) / a**2
    return np.array(
        [[0.0, 1.0 / (along + height), 0.0], [1.0 / ((across + height) * np.cos(lat)), 0.0, 0.0], [0.0, 0.0, 1.0]]
    )
