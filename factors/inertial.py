"""Inertial samples between keyframes, preintegrated on the rotating Earth.

Samples are means over (t_{i-1}, t_i]. A few consecutive samples make one integration step, which GTSAM integrates
exactly as a constant rate w and force f (its Galilean backend). What a constant leaves out is put into f and w:

    w <- w + (w x M_w) / T,    f <- f + (w x M_f + f x M_w) / T

with the step's first moments M_x = int (t - T/2) x dt: the coning and sculling terms of a rate and a force that change
linearly (Savage, "Strapdown inertial navigation integration algorithm design", 1998). Attitude and velocity are then of
fourth order in the sampling interval.

GTSAM's default backend (``PreintegratedCombinedMeasurements``) is of first order in the attitude, as it adds rotation
vectors in one tangent space: whence the Galilean one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.adapter import Loss, Measurement
from factors.lie import FloatArray, cumulative_rotation, exp_so3, skew
from factors.noise import robust

Pim = gtsam.PreintegratedCombinedMeasurementsG
TimeArray = NDArray[np.int64]

SAMPLES_PER_STEP = 4
"""More is faster and less exact: see the accuracy tests."""


@dataclass(frozen=True)
class ImuNoise:
    """Noise of an IMU as densities."""

    gyro_noise_density: float
    """rad/s/sqrt(Hz), the angle random walk."""
    accel_noise_density: float
    """m/s^2/sqrt(Hz), the velocity random walk."""
    gyro_bias_walk: float
    """rad/s^2/sqrt(Hz)."""
    accel_bias_walk: float
    """m/s^3/sqrt(Hz)."""
    integration_sigma: float = 1e-5
    """m/sqrt(s), position noise of the integration itself: small, and there to keep the covariance regular."""

    @cached_property
    def covariances(self) -> tuple[FloatArray, ...]:
        """Squared densities as matrices, in the order of the fields, shape (3, 3) each."""
        densities = (
            self.gyro_noise_density,
            self.accel_noise_density,
            self.gyro_bias_walk,
            self.accel_bias_walk,
            self.integration_sigma,
        )
        return tuple(density**2 * np.eye(3) for density in densities)


def preintegration_params(
    noise: ImuNoise, gravity_n: ArrayLike, earth_rate_n: ArrayLike, p_n: ArrayLike = (0.0, 0.0, 0.0)
) -> gtsam.PreintegrationCombinedParams:
    """Parameters of the preintegration at a place.

    Parameters
    ----------
    gravity_n
        Gravity at the place, centrifugal force included, shape (3,), m/s^2, in n.
    earth_rate_n
        Rotation of n against inertial space, shape (3,), rad/s.
    p_n
        The place, shape (3,), m. GTSAM adds the centrifugal force of turning about the origin of n, which gravity
        already has: what it will add at ``p_n`` is taken off beforehand (5 mGal at 10 km).
    """
    w = np.asarray(earth_rate_n, dtype=np.float64)
    params = gtsam.PreintegrationCombinedParams(_gravitation(gravity_n, w, p_n))
    params.setOmegaCoriolis(w)
    gyro, accel, gyro_walk, accel_walk, integration = noise.covariances
    params.setGyroscopeCovariance(gyro)
    params.setAccelerometerCovariance(accel)
    params.setBiasOmegaCovariance(gyro_walk)
    params.setBiasAccCovariance(accel_walk)
    params.setIntegrationCovariance(integration)
    return params


def _gravitation(gravity_n: ArrayLike, earth_rate_n: ArrayLike, p_n: ArrayLike) -> FloatArray:
    """Gravity without the centrifugal force of turning about the origin of n."""
    w = np.asarray(earth_rate_n, dtype=np.float64)
    p = np.asarray(p_n, dtype=np.float64)
    centrifugal: FloatArray = w * (w @ p) - p * (w @ w)
    return np.asarray(gravity_n, dtype=np.float64) + centrifugal


@dataclass(frozen=True, eq=False)
class Steps:
    """Integration steps of constant force and rate, in keyframe intervals."""

    dt: FloatArray
    """Durations, shape (S,), s."""
    f_b: FloatArray
    """Specific force, shape (S, 3), m/s^2."""
    w_b: FloatArray
    """Angular rate against inertial space, shape (S, 3), rad/s."""
    first: NDArray[np.intp]
    """Index of the first step of each interval, and S at the end, shape (K,)."""


def integration_steps(
    t_ns: TimeArray,
    f_b: FloatArray,
    w_b: FloatArray,
    keyframe_t_ns: TimeArray,
    bias: gtsam.imuBias.ConstantBias | None = None,
    samples_per_step: int = SAMPLES_PER_STEP,
) -> Steps:
    """Cut samples at the keyframes and join them into steps with coning and sculling accounted for.

    A sample in which a keyframe falls is split along the straight line through its neighbours, so that both parts
    together are still the sample.

    Parameters
    ----------
    t_ns, f_b, w_b
        Stamps, shape (N,), specific force and rate in the body frame, shape (N, 3); means over (t_{i-1}, t_i].
    keyframe_t_ns
        Shape (K,), increasing, inside the samples' time.
    bias
        Approximate bias, which the second-order terms are computed without; the steps still contain it.

    Raises
    ------
    ValueError
        When stamps do not increase or the samples do not cover the keyframes.
    """
    if len(t_ns) < 2 or np.any(np.diff(t_ns) <= 0) or np.any(np.diff(keyframe_t_ns) <= 0):
        raise ValueError("IMU stamps (two at least) and keyframe stamps must increase")
    edges = np.concatenate([[2 * t_ns[0] - t_ns[1]], t_ns])
    if keyframe_t_ns[0] < edges[0] or keyframe_t_ns[-1] > edges[-1]:
        raise ValueError(
            f"the IMU covers {edges[0]} to {edges[-1]} ns, the keyframes {keyframe_t_ns[0]} to {keyframe_t_ns[-1]} ns"
        )

    def seconds(t: TimeArray) -> FloatArray:
        return np.asarray((t - edges[0]) * 1e-9)

    inside = edges[(edges > keyframe_t_ns[0]) & (edges < keyframe_t_ns[-1])]
    cuts = np.sort(np.concatenate([inside, keyframe_t_ns]), kind="stable")
    cuts = cuts[np.concatenate([[True], np.diff(cuts) > 0])]
    sample = np.searchsorted(edges, cuts[1:]) - 1
    interval = np.searchsorted(keyframe_t_ns, cuts[1:]) - 1
    first_piece = np.searchsorted(cuts, keyframe_t_ns)
    starts = np.flatnonzero((np.arange(len(sample)) - first_piece[interval]) % samples_per_step == 0)

    cut_s, edge_s = seconds(cuts), seconds(edges)
    dt = np.diff(cut_s)
    piece_mid = 0.5 * (cut_s[1:] + cut_s[:-1])
    sample_mid = 0.5 * (edge_s[1:] + edge_s[:-1])
    step_cuts = np.append(cut_s[starts], cut_s[-1])
    T = np.diff(step_cuts)
    step_mid = np.repeat(0.5 * (step_cuts[1:] + step_cuts[:-1]), np.diff(np.append(starts, len(dt))))

    def mean_and_moment(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope = np.gradient(x, sample_mid, axis=0)[sample]
        piece = x[sample] + slope * (piece_mid - sample_mid[sample])[:, None]
        mean = np.add.reduceat(piece * dt[:, None], starts) / T[:, None]
        moment = piece * (dt * (piece_mid - step_mid))[:, None] + slope * (dt**3 / 12.0)[:, None]
        return mean, np.add.reduceat(moment, starts) / T[:, None]

    (f, M_f), (w, M_w) = mean_and_moment(f_b), mean_and_moment(w_b)
    b = gtsam.imuBias.ConstantBias() if bias is None else bias
    f_true, w_true = f - b.accelerometer(), w - b.gyroscope()
    return Steps(
        dt=T,
        f_b=f + np.cross(w_true, M_f) + np.cross(f_true, M_w),
        w_b=w + np.cross(w_true, M_w),
        first=np.searchsorted(starts, first_piece),
    )


def preintegrate(
    params: gtsam.PreintegrationCombinedParams | Sequence[gtsam.PreintegrationCombinedParams],
    t_ns: TimeArray,
    f_b: FloatArray,
    w_b: FloatArray,
    keyframe_t_ns: TimeArray,
    bias: gtsam.imuBias.ConstantBias,
    samples_per_step: int = SAMPLES_PER_STEP,
) -> list[Pim]:
    """Preintegrated measurements of every keyframe interval, K - 1 of them.

    Parameters
    ----------
    params
        One for all, or one per interval: see :func:`preintegration_params`.
    bias
        Bias to linearise about.

    The other parameters and the errors are those of :func:`integration_steps`.
    """
    steps = integration_steps(t_ns, f_b, w_b, keyframe_t_ns, bias, samples_per_step)
    intervals = len(keyframe_t_ns) - 1
    each = params if isinstance(params, Sequence) else [params] * intervals
    f, w, dt = list(steps.f_b), list(steps.w_b), steps.dt.tolist()
    return [
        _integrate(p, zip(f[a:b], w[a:b], dt[a:b], strict=True), bias)
        for p, a, b in zip(each, steps.first[:-1].tolist(), steps.first[1:].tolist(), strict=True)
    ]


def _integrate(
    params: gtsam.PreintegrationCombinedParams,
    steps: zip[tuple[FloatArray, FloatArray, float]],
    bias: gtsam.imuBias.ConstantBias,
) -> Pim:
    pim = Pim(params, bias)
    for f, w, dt in steps:
        pim.integrateMeasurement(f, w, dt)
    return pim


def imu_factor(keys: Sequence[int], pim: Pim, loss: Loss | None = None) -> gtsam.NonlinearFactor:
    """Factor on pose, velocity at i; pose, velocity at j; bias at i, bias at j (the order of ``keys``)."""
    pose_i, v_i, pose_j, v_j, bias_i, bias_j = keys
    factor = gtsam.GalileanCombinedImuFactor(pose_i, v_i, pose_j, v_j, bias_i, bias_j, pim)
    return factor if loss is None else factor.cloneWithNewNoiseModel(robust(factor.noiseModel(), loss))


def rotation_history(
    t_ns: TimeArray, w_b: FloatArray, at_t_ns: TimeArray, samples_per_step: int = SAMPLES_PER_STEP
) -> FloatArray:
    """Rotation from the body at each of ``at_t_ns`` (increasing) to the body at the first, shape (M, 3, 3).

    For rotation against n, take the gyro bias and the Earth rate off ``w_b`` as far as they are known. Errors are those
    of :func:`integration_steps`.
    """
    steps = integration_steps(t_ns, np.zeros_like(w_b), w_b, at_t_ns, samples_per_step=samples_per_step)
    return cumulative_rotation(exp_so3(steps.w_b * steps.dt[:, None]))[steps.first]


@dataclass(frozen=True, eq=False)
class InertialMotion(Measurement):
    """Inertial samples of one keyframe interval, integrated afresh at every bias.

    The lowered factor corrects for a change of bias to first order, so the two agree to second order in that change.
    """

    variables = ("Pose3", "Vector", "Pose3", "Vector", "ConstantBias", "ConstantBias")

    steps: Steps
    """The interval's integration steps."""
    imu: ImuNoise
    gravity_n: FloatArray
    """Gravity at ``p_n``, centrifugal force included, shape (3,), m/s^2."""
    earth_rate_n: FloatArray
    """Shape (3,), rad/s."""
    p_n: FloatArray = field(default_factory=lambda: np.zeros(3))
    """The place whose gravity it is, shape (3,), m."""
    bias: gtsam.imuBias.ConstantBias = field(default_factory=gtsam.imuBias.ConstantBias)
    """Bias that the lowered factor is linearised about."""

    def predict(
        self, pose: gtsam.Pose3, v_n: FloatArray, bias: gtsam.imuBias.ConstantBias
    ) -> tuple[gtsam.Pose3, FloatArray]:
        """Pose and velocity at the end, by way of the inertial frame that coincides with n at the start."""
        omega = self.earth_rate_n
        R, p = pose.rotation().matrix(), pose.translation()
        v = v_n + np.cross(omega, p)
        gravitation = _gravitation(self.gravity_n, omega, self.p_n)
        elapsed = 0.0
        for f, w, dt in zip(self.steps.f_b, self.steps.w_b, self.steps.dt, strict=True):
            first, second = _velocity_and_position_integrals(bias.correctGyroscope(w), dt)
            f = bias.correctAccelerometer(f)
            g = exp_so3(omega * elapsed) @ gravitation
            g_first, g_second = _velocity_and_position_integrals(omega, dt)
            p = p + v * dt + R @ second @ f + g_second @ g
            v = v + R @ first @ f + g_first @ g
            R = R @ exp_so3(bias.correctGyroscope(w) * dt)
            elapsed += dt
        to_n = exp_so3(-omega * elapsed)
        return gtsam.Pose3(gtsam.Rot3(to_n @ R), to_n @ p), to_n @ v - np.cross(omega, to_n @ p)

    def residual(
        self,
        pose_i: gtsam.Pose3,
        v_i: FloatArray,
        pose_j: gtsam.Pose3,
        v_j: FloatArray,
        bias_i: gtsam.imuBias.ConstantBias,
        bias_j: gtsam.imuBias.ConstantBias,
    ) -> FloatArray:
        """Log (SE_2(3): rotation, position, velocity) from state j to its prediction, then bias i - bias j, (15,)."""
        predicted = gtsam.NavState(*self.predict(pose_i, v_i, bias_i))
        motion = gtsam.NavState.Logmap(gtsam.NavState(pose_j, v_j).between(predicted))
        return np.concatenate([motion, bias_i.vector() - bias_j.vector()])

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Gaussian.Covariance(self.pim().residualCovariance())

    def pim(self) -> Pim:
        """The samples preintegrated by GTSAM."""
        steps = zip(self.steps.f_b, self.steps.w_b, self.steps.dt.tolist(), strict=True)
        params = preintegration_params(self.imu, self.gravity_n, self.earth_rate_n, self.p_n)
        return _integrate(params, steps, self.bias)

    def lowered(self, keys: Sequence[int], loss: Loss | None = None) -> gtsam.NonlinearFactor:
        return imu_factor(keys, self.pim(), loss)


def _velocity_and_position_integrals(w: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """int Exp(w t) dt and its integral over (0, dt), shape (3, 3) each, by six terms in w dt."""
    W, term = skew(w) * dt, np.eye(3)
    first, second = np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(6):
        first = first + term / (k + 1)
        second = second + term / ((k + 1) * (k + 2))
        term = term @ W / (k + 1)
    return first * dt, second * dt**2
