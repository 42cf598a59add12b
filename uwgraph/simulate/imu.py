"""Inertial samples: the ideal means over each sample interval, and the errors that a grade of IMU adds to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from scipy.signal import lfilter

from uwgraph.dive.rig import ImuRig, NonNegative, Positive, Settings
from uwgraph.simulate.noise import Noise
from uwgraph.simulate.trajectory import Trajectory
from uwgraph.time import from_seconds
from uwgraph.types import FloatArray, Imu

_NODES: Final = 4
_CHUNK: Final = 50_000


class ImuGrade(Settings):
    """How good an IMU is. :meth:`stated` is the rig that tells the estimator all of it."""

    rig: ImuRig
    """White noise, start bias and bias walk that are drawn (unless ``ideal``)."""
    ideal: bool = False
    """Draw no noise at all, here and in the other sensors; the rig still states small densities."""
    gyro_instability: NonNegative = 0.0
    """rad/s, 1-sigma of a first-order Gauss-Markov part of the gyro bias."""
    accel_instability: NonNegative = 0.0
    """m/s^2, likewise of the accelerometer bias."""
    instability_time_s: Positive = 600.0
    """Correlation time of both."""
    gyro_step: NonNegative = 0.0
    """rad/s, quantisation of a sample; 0 for none."""
    accel_step: NonNegative = 0.0
    """m/s^2, likewise."""

    def stated(self, rate_hz: float) -> ImuRig:
        """The rig with the instability counted as start bias and walk, and quantisation as white noise.

        A Gauss-Markov bias of variance s^2 and time T walks like a density sqrt(2/T) s over times short against T.
        """
        walk = float(np.sqrt(2.0 / self.instability_time_s))
        white = float(np.sqrt(1.0 / (12.0 * rate_hz)))
        return add_noise(
            self.rig,
            {
                "gyro_noise_density": white * self.gyro_step,
                "accel_noise_density": white * self.accel_step,
                "gyro_bias_walk": walk * self.gyro_instability,
                "accel_bias_walk": walk * self.accel_instability,
                "gyro_bias_sigma": self.gyro_instability,
                "accel_bias_sigma": self.accel_instability,
            },
        )


NOISE_FIELDS: Final = (
    "gyro_noise_density",
    "accel_noise_density",
    "gyro_bias_walk",
    "accel_bias_walk",
    "gyro_bias_sigma",
    "accel_bias_sigma",
)


def add_noise(rig: ImuRig, extra: Mapping[str, float]) -> ImuRig:
    """The rig with independent noise added to each of ``NOISE_FIELDS``: variances add."""
    return rig.model_copy(update={name: float(np.hypot(getattr(rig, name), extra[name])) for name in NOISE_FIELDS})


GradeName = Literal["fog", "mems", "noise_free"]
GRADES: Mapping[str, ImuGrade] = MappingProxyType(
    {
        # fibre-optic: bias 0.2 deg/h, angle random walk 0.01 deg/sqrt(h)
        "fog": ImuGrade(
            rig=ImuRig(
                gyro_noise_density=np.radians(0.01) / 60.0,
                accel_noise_density=2e-4,
                gyro_bias_walk=1e-9,
                accel_bias_walk=1e-7,
                gyro_bias_sigma=1e-6,
                accel_bias_sigma=5e-4,
            )
        ),
        # bias 20 deg/h, angle random walk 0.3 deg/sqrt(h)
        "mems": ImuGrade(
            rig=ImuRig(
                gyro_noise_density=np.radians(0.3) / 60.0,
                accel_noise_density=1e-3,
                gyro_bias_walk=2e-7,
                accel_bias_walk=2e-5,
                gyro_bias_sigma=np.radians(20.0) / 3600.0,
                accel_bias_sigma=2e-2,
            )
        ),
        "noise_free": ImuGrade(
            rig=ImuRig(
                gyro_noise_density=1e-7,
                accel_noise_density=1e-6,
                gyro_bias_walk=1e-10,
                accel_bias_walk=1e-9,
                gyro_bias_sigma=1e-7,
                accel_bias_sigma=1e-6,
            ),
            ideal=True,
        ),
    }
)
"""Named grades; the tactical and consumer ends of what vehicles carry, and none at all."""


def grade_of(grade: GradeName | ImuGrade) -> ImuGrade:
    """The grade itself, or the one of that name."""
    return grade if isinstance(grade, ImuGrade) else GRADES[grade]


@dataclass(frozen=True, eq=False)
class ImuErrors:
    """What is added to ideal samples, shape (N, 3) each, in the sensor frame."""

    accel: FloatArray
    gyro: FloatArray
    accel_bias: FloatArray
    """The slow part of ``accel``, m/s^2."""
    gyro_bias: FloatArray
    """The slow part of ``gyro``, rad/s."""


def ideal_imu(trajectory: Trajectory, rig: ImuRig, rate_hz: float) -> Imu:
    """Means of specific force and angular rate over (t_{i-1}, t_i], by Gauss-Legendre quadrature of the truth."""
    count = int(np.floor(trajectory.duration_s * rate_hz + 1e-9))
    step = 1.0 / rate_hz
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    f_s, w_s = np.empty((count, 3)), np.empty((count, 3))
    for first in range(0, count, _CHUNK):
        chunk = slice(first, min(first + _CHUNK, count))
        middle = (np.arange(chunk.start, chunk.stop) + 0.5) * step
        f_b, w_b = trajectory.inertial(middle[:, None] + 0.5 * step * node)
        f_s[chunk] = np.einsum("k,nkj->nj", 0.5 * weight, f_b) @ rig.R_bs
        w_s[chunk] = np.einsum("k,nkj->nj", 0.5 * weight, w_b) @ rig.R_bs
    stamps = from_seconds(np.arange(1, count + 1) * step, trajectory.start_ns) - rig.time_offset_ns
    return Imu(stamps, f_s=f_s, w_s=w_s)


def imu_errors(grade: ImuGrade, dt: FloatArray, noise: Noise) -> ImuErrors:
    """Errors of samples that last ``dt`` [s], shape (N,): white noise of variance density^2/dt, and the bias."""
    rig = grade.rig
    accel_bias = _bias(rig.accel_bias_sigma, rig.accel_bias_walk, grade.accel_instability, grade, dt, noise)
    gyro_bias = _bias(rig.gyro_bias_sigma, rig.gyro_bias_walk, grade.gyro_instability, grade, dt, noise)
    white = 1.0 / np.sqrt(dt)[:, None]
    return ImuErrors(
        accel=accel_bias + white * noise.normal(rig.accel_noise_density, (len(dt), 3)),
        gyro=gyro_bias + white * noise.normal(rig.gyro_noise_density, (len(dt), 3)),
        accel_bias=accel_bias,
        gyro_bias=gyro_bias,
    )


def with_errors(imu: Imu, errors: ImuErrors, grade: ImuGrade) -> Imu:
    """The samples with errors added, quantised."""
    return Imu(
        imu.t_ns,
        f_s=_quantise(imu.f_s + errors.accel, grade.accel_step),
        w_s=_quantise(imu.w_s + errors.gyro, grade.gyro_step),
    )


def _bias(
    start_sigma: float, walk: float, instability: float, grade: ImuGrade, dt: FloatArray, noise: Noise
) -> FloatArray:
    """Start bias, random walk and Gauss-Markov part, shape (N, 3)."""
    n = len(dt)
    start = noise.normal(start_sigma, (1, 3))
    steps = np.sqrt(dt)[:, None] * noise.normal(walk, (n, 3))
    keep = float(np.exp(-np.median(dt) / grade.instability_time_s))
    drive = noise.normal(instability, (n, 3))
    drive[1:] *= np.sqrt(1.0 - keep**2)
    bias: FloatArray = start + np.cumsum(steps, axis=0) + lfilter([1.0], [1.0, -keep], drive, axis=0)
    return bias


def _quantise(values: FloatArray, step: float) -> FloatArray:
    return values if step == 0.0 else step * np.round(values / step)
