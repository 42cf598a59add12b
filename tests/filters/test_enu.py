"""Our errors in the order, axes and units of the INS literature."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.filters.enu import ENU_FROM_NED, enu_covariance, enu_jacobian
from uwgraph.frames import R_n_local, geodetic_from_ned
from uwgraph.types import FloatArray, Origin

ORIGIN = Origin(lat=0.75, lon=-2.1)
R_NB = Rotation.from_euler("ZYX", [2.0, -0.3, 0.4]).as_matrix()
P_N, V_N = np.array([12_000.0, -8_000.0, 300.0]), np.array([1.5, -0.7, 0.2])


def local(R: FloatArray, p: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Attitude and velocity in the local axes of the place, and the place."""
    place = np.array([float(x) for x in geodetic_from_ned(ORIGIN, p)])
    C = ENU_FROM_NED @ R_n_local(ORIGIN, place[0], place[1]).T
    return C @ R, C @ v, place


def errors(d: FloatArray) -> FloatArray:
    """What the document calls errors of the estimate, where d leads to the truth."""
    C_est, v_est, place_est = local(R_NB, P_N, V_N)
    C_true, v_true, place_true = local(R_NB @ Rotation.from_rotvec(d[:3]).as_matrix(), P_N + d[3:6], V_N + d[6:])
    phi = Rotation.from_matrix(C_true @ C_est.T).as_rotvec()
    return np.concatenate([phi, v_est - v_true, place_est - place_true])


def test_jacobian_is_that_of_the_frames():
    steps = np.repeat([1e-5, 10.0, 1e-3], 3)
    numeric = np.column_stack(
        [(errors(s * e) - errors(-s * e)) / (2 * s) for s, e in zip(steps, np.eye(9), strict=True)]
    )
    J = enu_jacobian(ORIGIN, R_NB, P_N, V_N)
    scale = np.repeat([1.0, 1.0, 6.4e6, 6.4e6, 1.0], [3, 3, 1, 1, 1])[:, None]  # rad of latitude as m
    np.testing.assert_allclose(scale * J, scale * numeric, atol=2e-8, rtol=1e-6)


def test_at_the_origin_it_is_a_change_of_axes_signs_and_units():
    cov = enu_covariance(ORIGIN, np.eye(3), np.zeros(3), np.zeros(3), np.diag(np.arange(1.0, 10.0) ** 2))
    sigma = np.sqrt(np.diag(cov))
    np.testing.assert_allclose(sigma[[3, 4, 5]], [8.0, 7.0, 9.0])
    np.testing.assert_allclose(sigma[:3], [2.0, 1.0, 3.0], rtol=1e-6)
    assert sigma[6] * 6.37e6 == pytest.approx(4.0, rel=0.01)
    assert sigma[7] * 6.39e6 * np.cos(ORIGIN.lat) == pytest.approx(5.0, rel=0.01)
    assert sigma[8] == pytest.approx(6.0)


def test_heading_and_velocity_errors_keep_the_sign_of_their_correlation():
    d = np.array([0, 0, 1e-3, 0, 0, 0, 0, 1e-2, 0])  # the truth points more to the right and goes more to the east
    cov = enu_covariance(ORIGIN, np.eye(3), np.zeros(3), np.zeros(3), np.outer(d, d))
    assert cov[2, 3] == pytest.approx(1e-5)  # up is minus down, and estimated minus true


def test_round_trip():
    A = np.random.default_rng(0).normal(size=(9, 9)) * np.repeat([1e-3, 1.0, 0.1], 3)[:, None]
    P = A @ A.T
    back = np.linalg.inv(enu_jacobian(ORIGIN, R_NB, P_N, V_N))
    cov = enu_covariance(ORIGIN, R_NB, P_N, V_N, P)
    sigma = np.sqrt(np.diag(P))
    np.testing.assert_allclose(back @ cov @ back.T / np.outer(sigma, sigma), P / np.outer(sigma, sigma), atol=1e-9)
