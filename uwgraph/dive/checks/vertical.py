"""The vertical as the accelerometer sees it, and whether the gyro turns it the right way."""

from __future__ import annotations

import numpy as np

from uwgraph.types import FloatArray, Imu

WINDOW_S = 0.5
"""Averages of the specific force: waves turn the vehicle at this pace, turns and their centripetal force are slower."""
HUBER = 2.0


def mean_vectors(t_s: FloatArray, x: FloatArray, window_s: float) -> FloatArray:
    """Means over windows, shape (windows, 3); empty windows are left out."""
    count = max(int(t_s[-1] / window_s), 1)
    window = np.minimum((t_s / window_s).astype(np.int64), count - 1)
    samples = np.bincount(window, minlength=count)
    sums = np.stack([np.bincount(window, column, count) for column in x.T], axis=-1)
    return sums[samples > 0] / samples[samples > 0, None]


def gyro_gains(imu: Imu, R_bs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gain of each gyro axis against the accelerometer's vertical, and its sigma, each shape (3,).

    A direction u fixed in space turns as du/dt = -w x u in the body, so that du/dt = -sum_k gain_k w_k (e_k x u) with
    gains of 1. A gain is near 1 where the motion is gentle, -1 where an axis has the wrong sign, and near 0 where the
    specific force is not the vertical at all (multirotors).
    """
    force = mean_vectors(imu.t_s, imu.f_s @ R_bs.T, WINDOW_S)
    rate = mean_vectors(imu.t_s, imu.w_s @ R_bs.T, WINDOW_S)
    if len(force) < 10:
        return np.ones(3), np.full(3, np.inf)
    u = force / np.linalg.norm(force, axis=1, keepdims=True)
    turned = (u[2:] - u[:-2]) / (2 * WINDOW_S)
    w = 0.25 * rate[:-2] + 0.5 * rate[1:-1] + 0.25 * rate[2:]
    A = np.stack([-np.cross(w[:, [k]] * np.eye(3)[k], u[1:-1]) for k in range(3)], axis=-1).reshape(-1, 3)
    y = turned.ravel()
    weight = np.ones(len(y))
    for _ in range(10):
        root = np.sqrt(weight)
        gain = np.linalg.lstsq(A * root[:, None], y * root, rcond=None)[0]
        size = np.abs(y - A @ gain)
        scale = 1.4826 * float(np.median(size)) + np.finfo(float).tiny
        weight = np.minimum(1.0, HUBER * scale / np.maximum(size, HUBER * scale))
    information = np.diag(A.T @ A)
    return gain, scale / np.sqrt(np.maximum(information, 1e-30))
