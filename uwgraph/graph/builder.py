"""The graph of a dive: which factor on which keyframe. Reads as a table of contents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from scipy.special import erf

import factors
from uwgraph.chi_square import chi2_quantile
from uwgraph.errors import ConfigError
from uwgraph.graph import moving
from uwgraph.graph.initial import Initial
from uwgraph.graph.models import depth_models, fix_models, heading_models
from uwgraph.graph.observed import Observed
from uwgraph.graph.place import Place, place_at
from uwgraph.graph.prepare import BodyImu, Prepared
from uwgraph.graph.relative import closures_at_keyframes, odometry_at_keyframes
from uwgraph.graph.settings import SmoothSettings
from uwgraph.graph.track import Track
from uwgraph.sun.ephemeris import sun_direction_n
from uwgraph.types import FloatArray, RelativePoses, TimeArray

DVL_CALIBRATION = gtsam.symbol("c", 0)
Timed = tuple[list[gtsam.NonlinearFactor], TimeArray]
"""Factors and when each was measured."""
NOTHING: Timed = ([], np.zeros(0, dtype=np.int64))
VELOCITY_SIGMA = 3.0
"""m/s, prior of the first velocity: it only keeps a dive without DVL regular."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Native factors, the bulk factors that are linearised in NumPy, and the first guess."""

    keyframes: TimeArray
    graph: gtsam.NonlinearFactorGraph
    bulk: Sequence[factors.CalibratedDisplacements]
    values: gtsam.Values
    counts: Mapping[str, int]
    """Factors of each kind, in the order in which they stand in the graph."""
    measured_ns: Mapping[str, TimeArray] = field(default_factory=dict)
    """When each factor of a kind was measured, on average, where that is an instant of its own, shape (count,)."""

    def error(self, values: gtsam.Values) -> float:
        return float(self.graph.error(values)) + sum(b.error(values) for b in self.bulk)

    def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        linear = self.graph.linearize(values)
        for block in self.bulk:
            for factor in block.linearize(values):
                linear.push_back(factor)
        return linear

    def plus(self, kind: str, new: Sequence[gtsam.NonlinearFactor], values: gtsam.Values) -> Problem:
        """The problem with native factors of one more kind at the end of its graph, and another first guess."""
        graph = gtsam.NonlinearFactorGraph(self.graph)
        for factor in new:
            graph.push_back(factor)
        return replace(self, graph=graph, values=values, counts={**self.counts, kind: len(new)})

    def ordering(self, linear: gtsam.GaussianFactorGraph) -> gtsam.Ordering:
        """COLAMD with the quantities of the whole dive last: everything is connected to them."""
        if not self.values.exists(DVL_CALIBRATION):
            return gtsam.Ordering.ColamdGaussianFactorGraph(linear)
        return gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(linear, [DVL_CALIBRATION])


def build(
    prepared: Prepared,
    settings: SmoothSettings,
    initial: Initial,
    keyframes: TimeArray,
    track: Track,
    closures: RelativePoses | None = None,
    more: Sequence[Observed] = (),
) -> Problem:
    """The graph of a prepared dive, with ``track`` as the first guess and the place of linearisation.

    ``closures`` are believed as they are: those that were accepted. ``more`` are measurements at keyframes' moments.
    """
    place = place_at(prepared, keyframes, track)
    loss = Losses(settings)
    graph = gtsam.NonlinearFactorGraph()
    counts: dict[str, int] = {}
    measured_ns: dict[str, TimeArray] = {}

    def add(kind: str, new: Sequence[gtsam.NonlinearFactor], t_ns: TimeArray | None = None) -> None:
        for factor in new:
            graph.push_back(factor)
        if new:
            counts[kind] = len(new)
        if t_ns is not None:
            measured_ns[kind] = t_ns

    add("prior", _priors(prepared, initial, track))
    bias = _mean_bias(track)
    add("imu", _imu(prepared, keyframes, place, bias))
    native, bulk = _dvl(prepared, settings, keyframes, track, loss)
    add("dvl", native)
    add("depth", *_depth(prepared, keyframes, track, place, loss))
    add("fixes", *_fixes(prepared, keyframes, track, loss))
    add("heading", *_heading(prepared, keyframes, track, place, loss))
    add("sun", *_sun(prepared, keyframes, track, place, loss))
    if settings.odometry and prepared.odometry is not None:
        add("odometry", odometry_at_keyframes(prepared.odometry, keyframes, track).factors(loss(6)))
    if closures is not None:
        add("closures", closures_at_keyframes(closures, keyframes, track).factors())
    for kind, new in _more(more, keyframes, loss, calibrated=bool(bulk)).items():
        add(kind, new)
    values = _first_guess(keyframes, track, place, bias)
    for block in bulk:
        counts["dvl"] = len(block)
        values.insert(DVL_CALIBRATION, np.zeros(factors.CALIBRATION_DIM))
        graph.push_back(_calibration_prior(prepared))
    return Problem(keyframes, graph, bulk, values, counts, measured_ns)


class Losses:
    """The robust loss for a residual of m dimensions: it bends at the same quantile whatever m is."""

    def __init__(self, settings: SmoothSettings) -> None:
        self.kind = settings.loss
        self.quantile = float(erf(settings.loss_width / np.sqrt(2.0)))

    def __call__(self, m: int) -> gtsam.noiseModel.mEstimator.Huber | gtsam.noiseModel.mEstimator.Cauchy | None:
        if self.kind == "none":
            return None
        width = float(np.sqrt(chi2_quantile(self.quantile, m)))
        estimator = gtsam.noiseModel.mEstimator
        return estimator.Huber.Create(width) if self.kind == "huber" else estimator.Cauchy.Create(width)


def _priors(prepared: Prepared, initial: Initial, track: Track) -> list[gtsam.NonlinearFactor]:
    imu = prepared.dive.rig.imu
    pose = gtsam.Pose3(gtsam.Rot3(initial.R_nb), initial.p_n)
    cov = np.zeros((6, 6))
    cov[:3, :3] = initial.cov_rotation_b
    cov[3:, 3:] = initial.R_nb.T @ np.diag(initial.sigma_p**2) @ initial.R_nb
    bias_sigma = np.repeat([imu.accel_bias_sigma, imu.gyro_bias_sigma], 3)
    no_bias = gtsam.imuBias.ConstantBias(np.zeros(3), -prepared.rest.bias_gyro)
    velocity = track.velocity_at(np.array([initial.t_ns]))[0]
    noise = gtsam.noiseModel
    return [
        gtsam.PriorFactorPose3(X(0), pose, noise.Gaussian.Covariance(cov)),
        gtsam.PriorFactorVector(V(0), velocity, noise.Isotropic.Sigma(3, VELOCITY_SIGMA)),
        gtsam.PriorFactorConstantBias(B(0), no_bias, noise.Diagonal.Sigmas(bias_sigma)),
    ]


def _mean_bias(track: Track) -> gtsam.imuBias.ConstantBias:
    """The track's mean bias: samples are preintegrated about it."""
    gyro = np.broadcast_to(track.bias_gyro, (len(track.t_ns), 3)).mean(axis=0)
    return gtsam.imuBias.ConstantBias(np.zeros(3), gyro)


def _imu(
    prepared: Prepared, keyframes: TimeArray, place: Place, bias: gtsam.imuBias.ConstantBias
) -> list[gtsam.NonlinearFactor]:
    rig = prepared.dive.rig.imu
    noise = factors.ImuNoise(rig.gyro_noise_density, rig.accel_noise_density, rig.gyro_bias_walk, rig.accel_bias_walk)
    gravity, p_n = (0.5 * (x[1:] + x[:-1]) for x in (place.gravity_n, place.p_n))
    params = [
        factors.preintegration_params(noise, g, prepared.earth_rate_n, p) for g, p in zip(gravity, p_n, strict=True)
    ]
    imu = prepared.imu
    pims = factors.preintegrate(params, imu.t_ns[1:], imu.f_b, imu.w_b, keyframes, bias)
    return [factors.imu_factor((X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1)), pim) for k, pim in enumerate(pims)]


def _dvl(
    prepared: Prepared, settings: SmoothSettings, keyframes: TimeArray, track: Track, loss: Losses
) -> tuple[list[gtsam.NonlinearFactor], list[factors.CalibratedDisplacements]]:
    """Displacement factors: native ones, or one bulk factor with the instrument's calibration as a variable."""
    dvl, rig = prepared.dvl, prepared.dive.rig.dvl
    if dvl is None:
        return [], []
    R_keys = track.rotation_at(keyframes)
    calibrated = settings.dvl_calibration and (rig.scale_sigma > 0.0 or rig.misalignment_sigma_deg > 0.0)
    measured = factors.displacements(
        dvl.t_ns,
        dvl.v_b,
        dvl.cov_b,
        track.rotation_at(dvl.t_ns),
        keyframes,
        R_keys,
        l_b=np.zeros(3) if calibrated else rig.l_b,
        max_gap_s=rig.max_gap_s,
    )
    measured = replace(
        measured, d_start=measured.d_start + bend_between_pings(prepared.imu, rig.l_b, dvl.t_ns, keyframes)
    )
    k = np.flatnonzero(measured.valid).tolist()
    if not calibrated:
        robust = loss(3)
        return measured.lowered([(X(i), X(i + 1)) for i in k], k, robust), []
    R_mid = np.swapaxes(R_keys[:-1], 1, 2) @ track.rotation_at((keyframes[1:] + keyframes[:-1]) // 2)
    block = factors.CalibratedDisplacements(
        [X(i) for i in k],
        [X(i + 1) for i in k],
        DVL_CALIBRATION,
        measured.d_start[k],
        measured.dR[k] @ rig.l_b - rig.l_b,
        R_mid[k],
        measured.cov_start[k],
        loss(3),
    )
    return [], [block]


def bend_between_pings(imu: BodyImu, l_b: FloatArray, pings: TimeArray, keyframes: TimeArray) -> FloatArray:
    """How the DVL's way between pings bends, in the axes of each interval's first keyframe, shape (K - 1, 3)."""
    around = np.gradient(imu.rotation @ l_b, (imu.t_ns - imu.t_ns[0]) * 1e-9, axis=0) if l_b.any() else 0.0
    bend_g = factors.inertial_bend(imu.t_ns, imu.velocity + around, pings, keyframes)
    R_gb = imu.rotation_at(keyframes[:-1])
    bend: FloatArray = (np.swapaxes(R_gb, 1, 2) @ bend_g[:, :, None])[..., 0]
    return bend


def _calibration_prior(prepared: Prepared) -> gtsam.NonlinearFactor:
    rig = prepared.dive.rig.dvl
    floor = 1e-9
    sigmas = np.maximum([rig.scale_sigma, *[np.radians(rig.misalignment_sigma_deg)] * 3], floor)
    zero = np.zeros(factors.CALIBRATION_DIM)
    return gtsam.PriorFactorVector(DVL_CALIBRATION, zero, gtsam.noiseModel.Diagonal.Sigmas(sigmas))


def _depth(prepared: Prepared, keyframes: TimeArray, track: Track, place: Place, loss: Losses) -> Timed:
    if prepared.depth is None:
        return NOTHING
    lever = prepared.dive.rig.depth.l_b
    at = moving.depths(prepared.depth, keyframes, track, lever)
    return _lowered(at, depth_models(at.value, at.spread, place.select(at.keyframe), lever), loss(1)), at.t_ns


def _fixes(prepared: Prepared, keyframes: TimeArray, track: Track, loss: Losses) -> Timed:
    if prepared.fixes is None:
        return NOTHING
    lever = prepared.dive.rig.fixes.l_b
    at, R_local = moving.fixes(prepared.fixes, prepared.origin, keyframes, track, lever)
    return _lowered(at, fix_models(at.value, at.spread, R_local, lever), loss(3)), at.t_ns


def _heading(prepared: Prepared, keyframes: TimeArray, track: Track, place: Place, loss: Losses) -> Timed:
    if prepared.heading is None:
        return NOTHING
    at = moving.headings(prepared.heading, keyframes, track)
    return _lowered(at, heading_models(at.value, at.spread, place.select(at.keyframe)), loss(1)), at.t_ns


def _sun(prepared: Prepared, keyframes: TimeArray, track: Track, place: Place, loss: Losses) -> Timed:
    if prepared.sun is None:
        return NOTHING
    at = moving.suns(prepared.sun, keyframes, track)
    k = at.keyframe
    s_n = sun_direction_n(prepared.origin, at.t_ns, place.lat[k], place.lon[k])
    robust = loss(2)
    return factors.sun_scatter_factors([X(i) for i in k.tolist()], at.spread, s_n, robust), at.t_ns


def _more(
    more: Sequence[Observed], keyframes: TimeArray, loss: Losses, *, calibrated: bool
) -> dict[str, list[gtsam.NonlinearFactor]]:
    """Factors of anybody's own measurements, by kind; ``calibrated``: the Doppler log's calibration is a variable.

    Raises
    ------
    ConfigError
        When a measurement is of a part of the state that the graph does not have.
    """
    new: dict[str, list[gtsam.NonlinearFactor]] = {}
    for observed in more:
        k = int(np.searchsorted(keyframes, observed.t_ns))
        keys = {"pose": X(k), "velocity": V(k), "bias": B(k)} | ({"dvl": DVL_CALIBRATION} if calibrated else {})
        unknown = [role for role in observed.roles if role not in keys]
        if unknown:
            raise ConfigError(
                f"the graph has no variable {unknown[0]!r} for it",
                where=f"measurements of kind {observed.kind!r}",
                remedy=f"use roles out of {', '.join(keys)}; 'dvl' is there where the dive's calibration is estimated",
            )
        factor = observed.model.lowered([keys[role] for role in observed.roles], loss(len(observed.whitener)))
        new.setdefault(observed.kind, []).append(factor)
    return new


def _lowered(
    at: moving.AtKeyframes, models: Sequence[factors.Measurement], robust: factors.adapter.Loss | None
) -> list[gtsam.NonlinearFactor]:
    """Native factors of measurements of the keyframes' poses."""
    return [model.lowered((X(k),), robust) for k, model in zip(at.keyframe.tolist(), models, strict=True)]


def _first_guess(keyframes: TimeArray, track: Track, place: Place, bias: gtsam.imuBias.ConstantBias) -> gtsam.Values:
    values = gtsam.Values()
    v_n = track.velocity_at(keyframes)
    for k, (R, p, v) in enumerate(zip(place.R_nb, place.p_n, v_n, strict=True)):
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3(R), p))
        values.insert(V(k), v)
        values.insert(B(k), bias)
    return values
