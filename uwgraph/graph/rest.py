"""The start of a dive tells the gyro bias: a rest on deck or at the quay for nothing, a camera while it moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.types import FloatArray, RelativePoses, TimeArray

REST_SPEED = 0.05
"""m/s; a DVL that reads less is at rest."""
REST_RATE = 2e-3
"""rad/s; at rest the mean rates of consecutive seconds differ by less."""
REST_SIGMA = 1e-3
"""rad/s; how well a rest tells the bias, vibration included."""
REST_SECONDS = 2
SEEN_S = 30.0
"""How much of visual odometry tells the bias."""
POSSIBLE = 5.0
"""Sigmas of the rig; a mean rate beyond is a motion, not a bias."""


@dataclass(frozen=True, eq=False)
class Rest:
    """What the start of a dive says of the gyro bias."""

    bias_gyro: FloatArray
    """Shape (3,), rad/s; zero where the vehicle does not rest."""
    sigma: float
    """1-sigma of it, rad/s."""


def rest_at_start(
    t_ns: TimeArray, w_b: FloatArray, speed_t_ns: TimeArray, speed: FloatArray, bias_sigma: float
) -> Rest:
    """Mean rate over the seconds at the start in which it stays the same and the DVL reads no speed.

    Without a DVL there is no rest: a steady turn looks the same to the IMU.

    Parameters
    ----------
    t_ns, w_b
        Edges of the IMU's samples, shape (N + 1,), and rates, shape (N, 3), rad/s.
    speed_t_ns, speed
        Stamps and speed over the ground of the DVL, shape (P,) each, m/s.
    bias_sigma
        1-sigma that the rig states for the bias, rad/s.
    """
    none = Rest(np.zeros(3), bias_sigma)
    if bias_sigma < REST_SIGMA:
        return none
    rates: list[FloatArray] = []
    for second in range(int((t_ns[-1] - t_ns[0]) * 1e-9)):
        begin, end = t_ns[0] + np.array([second, second + 1]) * 1_000_000_000
        rate = w_b[slice(*np.searchsorted(t_ns[1:], [begin, end], side="right"))]
        pings = speed[(speed_t_ns > begin) & (speed_t_ns <= end)]
        if not len(rate) or not len(pings) or (pings > REST_SPEED).any():
            break
        rates.append(rate.mean(axis=0))
        if np.abs(rates[-1] - rates[0]).max() > REST_RATE:
            rates.pop()
            break
    bias = np.mean(rates, axis=0) if len(rates) >= REST_SECONDS else np.zeros(3)
    if not bias.any() or np.linalg.norm(bias) > POSSIBLE * bias_sigma:
        return none
    return Rest(bias, REST_SIGMA)


def bias_at_start(odometry: RelativePoses, dR: FloatArray, bias_sigma: float) -> Rest:
    """Median rate that the gyro has and the first steps of visual odometry have not.

    Parameters
    ----------
    odometry
        Within the IMU's span.
    dR
        Rotation of the gyro over every step, shape (N, 3, 3).
    bias_sigma
        1-sigma that the rig states for the bias, rad/s.
    """
    none = Rest(np.zeros(3), bias_sigma)
    dt = (odometry.t_ns - odometry.from_ns) * 1e-9
    first = np.flatnonzero((odometry.t_ns - odometry.t_ns[:1]) * 1e-9 < SEEN_S)
    if bias_sigma < REST_SIGMA or len(first) < 2:
        return none
    more = (Rotation.from_rotvec(odometry.rotvec[first]).inv() * Rotation.from_matrix(dR[first])).as_rotvec()
    rate = more / dt[first, None]
    bias = np.median(rate, axis=0)
    scatter = 1.4826 * np.median(np.abs(rate - bias), axis=0).max() / np.sqrt(len(first))
    if np.linalg.norm(bias) > POSSIBLE * bias_sigma:
        return none
    return Rest(bias, max(REST_SIGMA, 3.0 * float(scatter)))
