"""The solution as people read it: local roll, pitch, heading and depth, and 1-sigma along north, east and down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwgraph.frames import R_n_local, geodetic_from_ned, rph_from_matrix
from uwgraph.types import FloatArray, Solution


@dataclass(frozen=True, eq=False)
class People:
    """Place, depth and attitude at every keyframe, with covariances; NaN covariances where there are none."""

    lat: FloatArray
    """Geodetic latitude, shape (K,), rad."""
    lon: FloatArray
    """Longitude, shape (K,), rad."""
    height: FloatArray
    """Above the sea surface, shape (K,), m; minus the depth."""
    rph: FloatArray
    """Roll, pitch, heading against the local vertical and true north, shape (K, 3), rad."""
    cov_p_n: FloatArray
    """Covariance of the position in n, shape (K, 3, 3), m^2."""
    cov_rph: FloatArray
    """Covariance of roll, pitch, heading, shape (K, 3, 3), rad^2."""

    @property
    def depth(self) -> FloatArray:
        """Below the sea surface along the local vertical, shape (K,), m."""
        return -self.height


def people(solution: Solution) -> People:
    """Turn body-frame tangents into what is read: the covariances are rotated with R_nb."""
    lat, lon, height = geodetic_from_ned(solution.origin, solution.p_n)
    R_lb = np.swapaxes(R_n_local(solution.origin, lat, lon), -1, -2) @ solution.R_nb
    rph = rph_from_matrix(R_lb)
    J = rph_jacobian(rph) @ R_lb
    return People(
        lat=lat,
        lon=lon,
        height=height,
        rph=rph,
        cov_p_n=congruence(solution.R_nb, solution.cov_pose[:, 3:, 3:]),
        cov_rph=congruence(J, solution.cov_pose[:, :3, :3]),
    )


def rph_jacobian(rph: FloatArray) -> FloatArray:
    """Derivative of roll, pitch, heading by a small rotation about the local north, east and down axes.

    Of R = Rz(heading) Ry(pitch) Rx(roll), from d(R) = [delta] R; shape (K, 3, 3). Singular at pitch = 90 deg.
    """
    _, pitch, heading = np.moveaxis(rph, -1, 0)
    c, s, zero = np.cos(heading), np.sin(heading), np.zeros_like(heading)
    rows = [
        [c / np.cos(pitch), s / np.cos(pitch), zero],
        [-s, c, zero],
        [c * np.tan(pitch), s * np.tan(pitch), zero + 1.0],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def congruence(A: FloatArray, cov: FloatArray) -> FloatArray:
    """A cov A^T for stacks of matrices."""
    out: FloatArray = A @ cov @ np.swapaxes(A, -1, -2)
    return out


def sigmas(cov: FloatArray) -> FloatArray:
    """Square roots of the diagonals, shape (K, n)."""
    return np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
