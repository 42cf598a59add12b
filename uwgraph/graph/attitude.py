"""The first guess of the attitude: gyro, held by gravity and by whatever knows the heading.

A MEMS gyro alone turns a degree a minute, and after an hour no Gauss-Newton step finds back. This is a plain
multiplicative Kalman filter of attitude and gyro bias (Markley, "Attitude error representations for Kalman filtering",
2003) in steps of some seconds; the graph starts from it and owes it nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from factors.lie import exp_so3, skew
from factors.noise import sqrt_information
from uwgraph.frames import gravity_n
from uwgraph.graph.prepare import BodyImu, Prepared
from uwgraph.sun.ephemeris import sun_direction_n
from uwgraph.types import FloatArray, TimeArray

STEP_S = 5.0
LEVEL_SIGMA = 0.02
"""rad; the mean specific force over a step as a plumb line."""
LEVEL_TOLERANCE = 0.3
"""m/s^2; a step whose mean specific force differs more from gravity is no plumb line."""


@dataclass(frozen=True, eq=False)
class Aid:
    """A direction known in both frames: S (z_b - R_nb^T u_n) is zero but for unit noise."""

    S: FloatArray
    """Square root of the information, shape (m, 3)."""
    z_b: FloatArray
    """As measured, shape (3,); zero where S measures what is across it."""
    u_n: FloatArray
    """As known, shape (3,)."""


@dataclass(frozen=True, eq=False)
class Attitude:
    """Attitude and gyro bias on a grid of times."""

    t_ns: TimeArray
    R_nb: FloatArray
    bias_gyro: FloatArray


def aided_attitude(
    prepared: Prepared,
    t_ns: TimeArray,
    R_start: FloatArray,
    cov_b: FloatArray,
    v_b: FloatArray,
    heading_aids: bool = True,
) -> Attitude:
    """Filter forward from a known attitude over a grid of times.

    Parameters
    ----------
    t_ns, v_b
        The grid, shape (M,), and the velocity in the body there, shape (M, 3), m/s.
    R_start, cov_b
        Attitude at the grid's start and the covariance of its error in the body, shape (3, 3) each.
    heading_aids
        Whether sun and compass are used.
    """
    imu, rig = prepared.imu, prepared.dive.rig.imu
    C = imu.rotation_at(t_ns)
    dR = np.swapaxes(C[:-1], 1, 2) @ C[1:]
    dt = np.diff(t_ns) * 1e-9
    earth = exp_so3(-prepared.earth_rate_n * dt[:, None])
    force_b = _mean_force(imu, t_ns, C)
    g_n = gravity_n(prepared.origin, np.zeros(3))
    aids = _aids(prepared, t_ns) if heading_aids else {}

    R, bias, P = R_start, np.zeros(3), np.zeros((6, 6))
    P[:3, :3], P[3:, 3:] = cov_b, prepared.rest.sigma**2 * np.eye(3)
    walk = np.repeat([rig.gyro_noise_density**2, rig.gyro_bias_walk**2], 3)
    attitudes, biases = [R], [bias]
    for k, step in enumerate(dt):
        v_before = R @ v_b[k]
        R = earth[k] @ R @ dR[k] @ exp_so3(-bias * step)
        F = np.eye(6)
        F[:3, :3], F[:3, 3:] = dR[k].T, -step * np.eye(3)
        P = F @ P @ F.T + np.diag(walk * step)
        plumb = _plumb(force_b[k], (R @ v_b[k + 1] - v_before) / step - g_n)
        R, bias, P = _update(R, bias, P, [*plumb, *aids.get(k + 1, ())])
        attitudes.append(R)
        biases.append(bias)
    return Attitude(t_ns, np.array(attitudes), np.array(biases))


def _update(
    R: FloatArray, bias: FloatArray, P: FloatArray, aids: Sequence[Aid]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    if not aids:
        return R, bias, P
    seen = [R.T @ a.u_n for a in aids]
    residual = np.concatenate([a.S @ (a.z_b - u) for a, u in zip(aids, seen, strict=True)])
    H = np.zeros((len(residual), 6))
    H[:, :3] = np.vstack([a.S @ skew(u) for a, u in zip(aids, seen, strict=True)])
    K = np.linalg.solve(H @ P @ H.T + np.eye(len(H)), H @ P).T
    correction = K @ residual
    P = P - K @ H @ P
    return R @ exp_so3(correction[:3]), bias + correction[3:], 0.5 * (P + P.T)


def _mean_force(imu: BodyImu, t_ns: TimeArray, C: FloatArray) -> FloatArray:
    """Mean specific force over each step in the body axes at its end, shape (M - 1, 3)."""
    velocity = np.column_stack([np.interp(t_ns - t_ns[0], imu.t_ns - t_ns[0], v) for v in imu.velocity.T])
    mean = np.diff(velocity, axis=0) / (np.diff(t_ns) * 1e-9)[:, None]
    force: FloatArray = (np.swapaxes(C[1:], 1, 2) @ mean[:, :, None])[..., 0]
    return force


def _plumb(force_b: FloatArray, expected_n: FloatArray) -> list[Aid]:
    """The mean specific force as a plumb line, if it is as long as expected."""
    size, expected = np.linalg.norm(force_b), np.linalg.norm(expected_n)
    if abs(size - expected) > LEVEL_TOLERANCE:
        return []
    return [Aid(np.eye(3) / LEVEL_SIGMA, force_b / size, expected_n / expected)]


def _aids(prepared: Prepared, t_ns: TimeArray) -> dict[int, list[Aid]]:
    """Sun and compass at the grid's times: the last sample within each step, turned to the step's end by the gyro."""
    aids: dict[int, list[Aid]] = {}
    imu, origin = prepared.imu, prepared.origin
    if prepared.sun is not None:
        sun = prepared.sun.select(prepared.sun.flags == 0)
        k, last = _last_in_step(sun.t_ns, t_ns)
        dR = np.swapaxes(imu.rotation_at(t_ns[k]), 1, 2) @ imu.rotation_at(sun.t_ns[last])
        information = dR @ sun.information_b[last] @ np.swapaxes(dR, 1, 2)
        s_n = sun_direction_n(origin, sun.t_ns[last], origin.lat, origin.lon)
        for i, L, s in zip(k.tolist(), information, s_n, strict=True):
            aids.setdefault(i, []).append(Aid(sqrt_information(L), np.zeros(3), s))
    if prepared.heading is not None:
        k, last = _last_in_step(prepared.heading.t_ns, t_ns)
        psi, sigma = prepared.heading.heading[last], prepared.heading.sigma[last]
        right = np.stack([-np.sin(psi), np.cos(psi), np.zeros_like(psi)], axis=-1)
        for i, u, s in zip(k.tolist(), right, sigma.tolist(), strict=True):
            aids.setdefault(i, []).append(Aid(np.array([[1.0 / s, 0.0, 0.0]]), np.zeros(3), u))
    return aids


def _last_in_step(stamps: TimeArray, t_ns: TimeArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Grid points whose step before has samples, and the index of the last sample in it."""
    count = np.searchsorted(stamps, t_ns, side="right")
    k = np.flatnonzero(np.diff(count) > 0) + 1
    return k, count[k] - 1
