"""Rotations as arrays: what the measurement models share, vectorised over leading axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def skew(v: ArrayLike) -> FloatArray:
    """Cross-product matrices [v]x, shape (..., 3, 3), of vectors, shape (..., 3)."""
    v = np.asarray(v, dtype=np.float64)
    W = np.zeros((*v.shape, 3))
    W[..., 2, 1] = v[..., 0]
    W[..., 0, 2] = v[..., 1]
    W[..., 1, 0] = v[..., 2]
    return W - np.swapaxes(W, -1, -2)


def exp_so3(phi: ArrayLike) -> FloatArray:
    """Rotation matrices, shape (..., 3, 3), of rotation vectors, shape (..., 3), rad (Rodrigues)."""
    phi = np.asarray(phi, dtype=np.float64)
    angle = np.linalg.norm(phi, axis=-1)[..., None, None]
    W = skew(phi)
    half = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    R: FloatArray = np.eye(3) + np.sinc(angle / np.pi) * W + half * (W @ W)
    return R


def cumulative_rotation(dR: FloatArray) -> FloatArray:
    """Running products I, dR_0, dR_0 dR_1, ..., shape (N + 1, 3, 3), of N increments.

    Two levels of about sqrt(N) steps, each vectorised over sqrt(N) chains.
    """
    N = len(dR)
    length = max(1, int(np.sqrt(N)))
    chains = -(-N // length)
    padded = np.broadcast_to(np.eye(3), (chains * length, 3, 3)).copy()
    padded[:N] = dR
    inner = padded.reshape(chains, length, 3, 3)
    for k in range(1, length):
        inner[:, k] = inner[:, k - 1] @ inner[:, k]
    start = np.broadcast_to(np.eye(3), (chains, 3, 3)).copy()
    for c in range(1, chains):
        start[c] = start[c - 1] @ inner[c - 1, -1]
    products = (start[:, None] @ inner).reshape(-1, 3, 3)[:N]
    return np.concatenate([np.eye(3)[None], products])
