"""The loops over sigma points that matrix products cannot express, compiled.

A batch of M states is a pair of arrays: rotations R, shape (M, K, 3, 3), and numbers y, shape (M, n). The tangent has n
numbers; K of its triples, beginning at the indices ``rot``, are rotations: y is unused (zero) there.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uwgraph.types import FloatArray

Index = NDArray[np.int64]
SMALL = 1e-4
"""rad; below it the series of the rotation's coefficients are exact to rounding."""


@njit(cache=True)
def _exp(x: float, y: float, z: float, out: FloatArray) -> None:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    if angle < SMALL:
        a, b = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    c = 1.0 - b * square
    out[0, 0], out[0, 1], out[0, 2] = c + b * x * x, b * x * y - a * z, b * x * z + a * y
    out[1, 0], out[1, 1], out[1, 2] = b * x * y + a * z, c + b * y * y, b * y * z - a * x
    out[2, 0], out[2, 1], out[2, 2] = b * x * z - a * y, b * y * z + a * x, c + b * z * z


@njit(cache=True)
def _product(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """A B of 3 x 3 matrices: written out, for BLAS costs more than it saves here."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@njit(cache=True)
def _cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _between(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Rotation vector of A^T B, through the quaternion: exact up to half a turn."""
    m, q = np.empty((3, 3)), np.empty(4)
    _product(A.T, B, m)
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace > 0.0:
        q[0], q[1], q[2], q[3] = 1.0 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    elif m[0, 0] >= m[1, 1] and m[0, 0] >= m[2, 2]:
        q[0], q[1] = m[2, 1] - m[1, 2], 1.0 + m[0, 0] - m[1, 1] - m[2, 2]
        q[2], q[3] = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]
    elif m[1, 1] >= m[2, 2]:
        q[0], q[2] = m[0, 2] - m[2, 0], 1.0 - m[0, 0] + m[1, 1] - m[2, 2]
        q[1], q[3] = m[0, 1] + m[1, 0], m[1, 2] + m[2, 1]
    else:
        q[0], q[3] = m[1, 0] - m[0, 1], 1.0 - m[0, 0] - m[1, 1] + m[2, 2]
        q[1], q[2] = m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    if q[0] < 0.0:
        q = -q
    sine = np.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    scale = 2.0 / q[0] if sine < SMALL * q[0] else 2.0 * np.arctan2(sine, q[0]) / sine
    if sine < SMALL * q[0]:
        scale *= 1.0 - (sine / q[0]) ** 2 / 3.0
    for i in range(3):
        out[i] = scale * q[i + 1]


@njit(cache=True)
def plus(R: FloatArray, y: FloatArray, D: FloatArray, rot: Index) -> tuple[FloatArray, FloatArray]:
    """One state moved by M tangent vectors D, shape (M, n): R Exp(d) for rotations, y + d for numbers."""
    M, K = len(D), len(R)
    Rs, ys, E = np.empty((M, K, 3, 3)), y + D, np.empty((3, 3))
    for i in range(M):
        for k in range(K):
            a = rot[k]
            _exp(D[i, a], D[i, a + 1], D[i, a + 2], E)
            _product(R[k], E, Rs[i, k])
            ys[i, a : a + 3] = 0.0
    return Rs, ys


@njit(cache=True)
def minus(Rs: FloatArray, ys: FloatArray, R: FloatArray, y: FloatArray, rot: Index) -> FloatArray:
    """Tangent vectors from one state to M states, shape (M, n): the inverse of :func:`plus`."""
    D = ys - y
    for i in range(len(D)):
        for k in range(len(R)):
            _between(R[k], Rs[i, k], D[i, rot[k] : rot[k] + 3])
    return D


@njit(cache=True)
def propagate(
    Rs: FloatArray,
    ys: FloatArray,
    step: FloatArray,
    earth: FloatArray,
    drift_at: int,
    decay: FloatArray,
) -> None:
    """Move M inertial states by one step of constant rate and specific force, in place.

    Parameters
    ----------
    step
        dt, specific force (3), rate (3): shape (7,).
    earth
        Gravity (3) and rotation of n (3), shape (6,), in n.
    drift_at
        Where the gyro's Markov drift stands in y; negative where there is none.
    decay
        What is left of the gyro's and the accelerometer's Markov drift after the step, shape (2,).

    The body turns by Exp((w - b) dt) and n by Exp(omega dt). Over one step the force is integrated through the turn to
    second order: v += R (I + W/2 + W^2/6) f dt, p += R (I/2 + W/6 + W^2/24) f dt^2. What n turns meanwhile, under the
    force R f and under the velocity that it gains, is omega x (3/2 R f + g) dt^2 of v, and a third of it times dt of p.
    """
    dt, drifting = step[0], drift_at >= 0
    E, N, RE = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    w, f, Wf, WWf, turn, first, second, pull = np.empty((8, 3))
    _exp(-earth[3] * dt, -earth[4] * dt, -earth[5] * dt, N)
    for i in range(len(Rs)):
        y, R = ys[i], Rs[i, 0]
        for j in range(3):
            f[j] = step[1 + j] - y[12 + j]
            w[j] = (step[4 + j] - y[9 + j] - (y[drift_at + j] if drifting else 0.0)) * dt
        _cross(w, f, Wf)
        _cross(w, Wf, WWf)
        _cross(earth[3:], y[6:9], turn)
        for j in range(3):
            push = earth[j] - 2.0 * turn[j]
            first[j], second[j] = push, 0.5 * push
            for k in range(3):
                first[j] += R[j, k] * (f[k] + Wf[k] / 2.0 + WWf[k] / 6.0)
                second[j] += R[j, k] * (f[k] / 2.0 + Wf[k] / 6.0 + WWf[k] / 24.0)
        for j in range(3):
            pull[j] = 1.5 * first[j] - 0.5 * earth[j]
        _cross(earth[3:], pull, turn)
        for j in range(3):
            y[3 + j] += (y[6 + j] + (second[j] - turn[j] * dt / 3.0) * dt) * dt
            y[6 + j] += (first[j] - turn[j] * dt) * dt
            y[12 + j] *= decay[1]
            if drifting:
                y[drift_at + j] *= decay[0]
        _exp(w[0], w[1], w[2], E)
        _product(R, E, RE)
        _product(N, RE, R)


@njit(cache=True)
def _skew(v: FloatArray, out: FloatArray) -> None:
    """The matrix [v]x."""
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]


@njit(cache=True)
def transition(
    R: FloatArray, y: FloatArray, step: FloatArray, earth: FloatArray, drift_at: int, decay: FloatArray
) -> FloatArray:
    """Derivative of :func:`propagate` at one state with body rotation R, shape (n, n), to third order in the step."""
    dt, drifting, n = step[0], drift_at >= 0, len(y)
    F = np.eye(n)
    w, f, Wf, WWf, pushed, E = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))
    W, WW, block, turned, f_x = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for j in range(3):
        f[j] = step[1 + j] - y[12 + j]
        w[j] = (step[4 + j] - y[9 + j] - (y[drift_at + j] if drifting else 0.0)) * dt
    _cross(w, f, Wf)
    _cross(w, Wf, WWf)
    _skew(w, W)
    _skew(f, f_x)
    _product(W, W, WW)
    _exp(-w[0], -w[1], -w[2], E)
    F[0:3, 0:3] = E
    for order in range(2):  # velocity, then position
        row = 6 - 3 * order
        a, b, c = (1.0, 0.5, 1.0 / 6.0) if order == 0 else (0.5, 1.0 / 6.0, 1.0 / 24.0)
        t = dt if order == 0 else dt * dt
        for j in range(3):
            pushed[j] = a * f[j] + b * Wf[j] + c * WWf[j]
        _skew(pushed, block)
        _product(R, block, turned)
        F[row : row + 3, 0:3] = -t * turned
        _product(R, f_x, turned)
        F[row : row + 3, 9:12] = (b * t * dt) * turned
        for i in range(3):
            for j in range(3):
                block[i, j] = a * (i == j) + b * W[i, j] + c * WW[i, j]
        _product(R, block, turned)
        F[row : row + 3, 12:15] = -t * turned
    for i in range(3):
        for j in range(3):
            F[i, 9 + j] = -dt * ((i == j) - W[i, j] / 2.0 + WW[i, j] / 6.0)
    _skew(earth[3:], block)
    for i in range(3):
        F[3 + i, 6 + i] = dt
        for j in range(3):
            F[6 + i, 6 + j] -= 2.0 * dt * block[i, j]
            F[3 + i, 6 + j] -= dt * dt * block[i, j]
        F[12 + i, 12 + i] = decay[1]
        if drifting:
            F[0:9, drift_at + i] = F[0:9, 9 + i]
            F[drift_at + i, drift_at + i] = decay[0]
    return F


def compile_all() -> None:
    """Compile every kernel now, or load it from the cache of a former run: some seconds once on a machine."""
    rot, R, y = np.zeros(1, dtype=np.int64), np.eye(3)[None], np.zeros(15)
    step, earth, decay = np.full(7, 0.01), np.zeros(6), np.ones(2)
    Rs, ys = plus(R, y, np.zeros((2, 15)), rot)
    propagate(Rs, ys, step, earth, -1, decay)
    minus(Rs, ys, R, y, rot)
    transition(R[0], y, step, earth, -1, decay)
