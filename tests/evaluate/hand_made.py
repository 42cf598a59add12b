"""A curved dive whose solution and reference are written down by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.frames import R_n_local, geodetic_from_ned, matrix_from_rph, rph_from_matrix
from uwgraph.time import NS
from uwgraph.types import FloatArray, Origin, Reference, Solution

ORIGIN = Origin(np.radians(43.1), np.radians(5.9))
START = 1_654_678_800 * NS + 123_456_789


def truth(n: int = 400, period_s: float = 1.0, offset_s: float = 0.0) -> Solution:
    """A dive that turns, dives and rolls, with a 10 cm, 1 mrad covariance that is not isotropic."""
    t = np.arange(n) * period_s + offset_s
    p_n = np.stack([300 * np.sin(t / 90), 200 * np.sin(t / 60), 20 + 5 * np.sin(t / 40)], axis=1)
    v_n = np.stack([300 / 90 * np.cos(t / 90), 200 / 60 * np.cos(t / 60), 5 / 40 * np.cos(t / 40)], axis=1)
    heading = np.unwrap(np.arctan2(v_n[:, 1], v_n[:, 0]))
    rph = np.stack([0.1 * np.sin(t / 7), 0.2 * np.sin(t / 11), heading], axis=1)
    lat, lon, _ = geodetic_from_ned(ORIGIN, p_n)
    sigma = np.array([1e-3, 2e-3, 5e-3, 0.1, 0.2, 0.05])
    return Solution(
        origin=ORIGIN,
        t_ns=START + np.rint(t * NS).astype(np.int64),
        R_nb=R_n_local(ORIGIN, lat, lon) @ matrix_from_rph(rph),
        p_n=p_n,
        v_n=v_n,
        bias_gyro=np.full((n, 3), 1e-6),
        bias_accel=np.full((n, 3), 1e-3),
        cov_pose=np.tile(np.diag(sigma**2), (n, 1, 1)),
        cov_v=np.tile(np.eye(3) * 1e-4, (n, 1, 1)),
        cov_bias=np.tile(np.eye(6) * 1e-8, (n, 1, 1)),
        info={"runtime_s": 1.5},
    )


def as_reference(solution: Solution) -> Reference:
    """The same dive as somebody else's solution."""
    lat, lon, height = geodetic_from_ned(solution.origin, solution.p_n)
    R_ln = np.swapaxes(R_n_local(solution.origin, lat, lon), -1, -2)
    return Reference(
        t_ns=solution.t_ns,
        lat=lat,
        lon=lon,
        height=height,
        rph=rph_from_matrix(R_ln @ solution.R_nb),
        v_n=np.einsum("kij,kj->ki", R_ln, solution.v_n),
    )


def shifted(solution: Solution, ned: FloatArray) -> Solution:
    return replace(solution, p_n=solution.p_n + ned)


def turned(solution: Solution, angle: float) -> Solution:
    """Turned about the vertical of the origin."""
    R = matrix_from_rph(np.array([0.0, 0.0, angle]))
    return replace(solution, R_nb=R @ solution.R_nb, p_n=solution.p_n @ R.T, v_n=solution.v_n @ R.T)


def disturbed(solution: Solution, rng: np.random.Generator) -> Solution:
    """Every pose moved by a draw from its own covariance: truth = estimate.retract(xi)."""
    root = np.linalg.cholesky(solution.cov_pose)
    xi = np.einsum("kij,kj->ki", root, rng.standard_normal((len(solution), 6)))
    R_est = solution.R_nb @ np.swapaxes(Rotation.from_rotvec(xi[:, :3]).as_matrix(), -1, -2)
    return replace(solution, R_nb=R_est, p_n=solution.p_n - np.einsum("kij,kj->ki", R_est, xi[:, 3:]))
