"""From per-pixel normals to one rank-2 information on the sun's direction.

Every optical method gives per pixel a vector that should be orthogonal to the sun. The weighted sum of their outer
products, freed from the noise's own contribution, has the sun as its smallest eigenvector. Neighbouring pixels do not
err independently (blur, waves), so the covariance comes from the scores summed over blocks (the sandwich estimator:
White 1980; Cameron & Miller 2015 for clusters), never from the count of pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uwgraph.types import FloatArray

FLOOR = np.radians(0.05)
"""1-sigma of the direction that no image goes below, rad: camera calibration and model."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Eigenvectors of a 3x3 scatter matrix with the sun as the smallest."""

    s: FloatArray
    """Eigenvector of the smallest eigenvalue, shape (3,), sign as it came."""
    E: FloatArray
    """The other two, as columns, shape (3, 2)."""
    curvature: FloatArray
    """Their eigenvalues less the smallest, shape (2,)."""
    eigenvalues: FloatArray
    """In growing order, shape (3,)."""

    @classmethod
    def of(cls, M: FloatArray) -> Spectrum:
        values, vectors = np.linalg.eigh(M)
        return cls(vectors[:, 0], vectors[:, 1:], values[1:] - values[0], values)


def block_numbers(shape: tuple[int, ...], pixels: NDArray[np.intp], blocks: int) -> NDArray[np.intp]:
    """Number of the square block that each pixel (flat index, (N,)) of an image of ``shape`` (H, W) belongs to.

    There are ``blocks`` along the longer side; some of the numbers may be empty.
    """
    side = -(-max(shape) // blocks)
    row, column = np.divmod(pixels, shape[1])
    return np.asarray(row // side * blocks + column // side, dtype=np.intp)


def block_sandwich(scores: FloatArray, blocks: NDArray[np.intp], curvature: FloatArray) -> FloatArray:
    """Covariance (K, K) of the parameters: H^-1 (sum_B u_B u_B^T) H^-1, u_B the sum of ``scores`` (N, K) in block B.

    Parameters
    ----------
    scores : shape (N, K)
        Half the derivative of the objective with respect to the parameters, pixel by pixel.
    blocks : shape (N,)
        Number of the block each pixel belongs to, counted from 0.
    curvature : shape (K,) or (K, K)
        Half the second derivative of the objective.
    """
    count = int(blocks.max()) + 1
    u = np.stack([np.bincount(blocks, scores[:, k], count) for k in range(scores.shape[1])], axis=1)
    H_inv = np.linalg.inv(np.diag(curvature) if curvature.ndim == 1 else curvature)
    cov: FloatArray = H_inv @ (u.T @ u) @ H_inv
    return cov


def rank2(E: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(Lambda, covariance), each (3, 3), of a covariance (2, 2) along the tangent columns of E (3, 2)."""
    information = E @ np.linalg.inv(cov) @ E.T
    covariance = E @ cov @ E.T
    return (information + information.T) / 2.0, (covariance + covariance.T) / 2.0
