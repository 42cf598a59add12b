"""A dive as the kinematic model sees it: Doppler log and gyro as inputs, everything else as numbers of its state.

Roll and pitch are taken from dead reckoning, and taken for true; so are lever arms turned by them. Where a few pings
are missing the velocity is interpolated; where the log is lost the last one goes on and ages, and the gyro goes on as
ever.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.lie import exp_so3
from uwgraph.errors import DataError
from uwgraph.filters.kinematic import Direct, InputNoise, Inputs, Kinematic, depth, fix, heading, levelled
from uwgraph.filters.state import Belief
from uwgraph.frames import ned_from_geodetic, rph_from_matrix, wrap_pi
from uwgraph.graph.attitude import LEVEL_SIGMA, STEP_S
from uwgraph.graph.initial import Initial
from uwgraph.graph.place import place_at
from uwgraph.graph.prepare import BodyDvl, Prepared
from uwgraph.graph.track import Track, body_velocity, dead_reckon
from uwgraph.sun.ephemeris import sun_direction_n
from uwgraph.sun.observation import SunObservation
from uwgraph.types import BoolArray, FloatArray, TimeArray

LOST_PERIODS = 5.0
"""Time without a ping, in the log's periods, from which on it is lost."""
WALK_LAGS_S = 2.0 ** np.arange(7)
"""Over which the vehicle's changes of velocity are looked at."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """What a kinematic filter of a dive needs."""

    noise: InputNoise
    first: Belief
    inputs: Inputs
    measured: list[Direct]
    """By time."""


def reduced(prepared: Prepared, start: Initial) -> Reduced:
    """A prepared dive from its first state on.

    Raises
    ------
    DataError
        When there is no Doppler log after the first state.
    """
    # a track with the heading's aids would use them twice
    track = dead_reckon(prepared, start.t_ns, start.R_nb, start.p_n, start.cov_rotation_b, heading_aids=False)
    dvl = prepared.dvl
    if dvl is None or np.count_nonzero(dvl.t_ns > start.t_ns) < 2:
        raise DataError("nothing tells the velocity", where="dvl", remedy="the kinematic model needs a Doppler log")
    noise = _noise(prepared, dvl, track)
    cov_n = start.R_nb @ start.cov_rotation_b @ start.R_nb.T
    P = np.diag([*start.sigma_p**2, cov_n[2, 2]])
    psi = float(rph_from_matrix(start.R_nb)[2])
    first = Kinematic(noise).start(start.t_ns, start.p_n, psi, P)
    measured = [
        *_depths(prepared, track),
        *_fixes(prepared, track),
        *_headings(prepared, track),
        *_suns(prepared, track),
    ]
    return Reduced(noise, first, _inputs(prepared, dvl, track, start.t_ns), sorted(measured, key=lambda m: m.t_ns))


def _noise(prepared: Prepared, dvl: BodyDvl, track: Track) -> InputNoise:
    """What the rig states; errors of scale and mounting are those of a velocity that hardly changes."""
    rig, imu, rest = prepared.dive.rig.dvl, prepared.dive.rig.imu, prepared.rest
    sigma = np.sqrt(np.median(np.trace(dvl.cov_b, axis1=1, axis2=2)) / 3.0)
    speed = np.median(np.linalg.norm(dvl.v_b, axis=1))
    return InputNoise(
        velocity_density=float(sigma * np.sqrt(np.median(np.diff(dvl.t_ns)) * 1e-9)),
        rate_density=imu.gyro_noise_density,
        velocity_bias_sigma=float(speed * np.hypot(rig.scale_sigma, np.radians(rig.misalignment_sigma_deg))),
        sinking_bias_walk=float(speed * _tilt_walk(rest.sigma)),
        rate_bias_sigma=rest.sigma,
        rate_bias_walk=imu.gyro_bias_walk,
        velocity_walk=_velocity_walk(dvl.t_ns, _pinged(prepared, dvl, track)),
    )


def _tilt_walk(bias_sigma: float) -> float:
    """How the tilt of dead reckoning wanders by the gyro's bias, which levelling stops after a time T, rad/sqrt(s).

    That is when it tells the tilt as well as the gyro does: bias T = LEVEL_SIGMA sqrt(STEP_S / T).
    """
    T = (LEVEL_SIGMA * np.sqrt(STEP_S) / bias_sigma) ** (2.0 / 3.0)
    return float(bias_sigma * np.sqrt(T))


def _pinged(prepared: Prepared, dvl: BodyDvl, track: Track) -> FloatArray:
    """Velocity of the body origin along levelled axes at the pings, shape (N, 3)."""
    return levelled(body_velocity(prepared, dvl.t_ns), track.rotation_at(dvl.t_ns))


def _velocity_walk(t_ns: TimeArray, v: FloatArray) -> float:
    """Density of the random walk that the velocity, shape (N, 3), changes no faster than, m/s/sqrt(s).

    By its structure function: the largest of E |v(t + lag) - v(t)|^2 / lag over all lags, per axis.
    """
    t_s = (t_ns - t_ns[0]) * 1e-9
    densities = [0.0]
    for lag in WALK_LAGS_S[0.5 * t_s[-1] > WALK_LAGS_S]:
        later = np.searchsorted(t_s, t_s + lag)
        early = np.flatnonzero(later < len(t_s))
        later = later[early]
        change = np.sum((v[later] - v[early]) ** 2, axis=1) / 3.0
        densities.append(float(np.mean(change / (t_s[later] - t_s[early]))))
    return float(np.sqrt(max(densities)))


def _inputs(prepared: Prepared, dvl: BodyDvl, track: Track, start_ns: int) -> Inputs:
    """The mean velocity along levelled axes, and what the gyro turns the heading by.

    From each ping to the next, and from period to period where the log is lost, up to the end of the dive.
    """
    at, lost = _edges(dvl.t_ns, start_ns, int(prepared.imu.t_ns[-1]))
    dt = np.diff(at)[:, None] * 1e-9
    R, gyro = track.rotation_at(at), prepared.imu.rotation_at(at)
    turned = exp_so3(-prepared.earth_rate_n * dt) @ R[:-1] @ np.swapaxes(gyro[:-1], 1, 2) @ gyro[1:]
    angle = wrap_pi(rph_from_matrix(turned)[:, 2] - rph_from_matrix(R[:-1])[:, 2])
    v = levelled(body_velocity(prepared, at), R)
    last = np.maximum(np.searchsorted(dvl.t_ns, at[:-1], side="right") - 1, 0)
    held, ping_ns = _pinged(prepared, dvl, track)[last], dvl.t_ns[last]
    age_s = np.maximum(np.abs(at[:-1] - ping_ns), np.abs(at[1:] - ping_ns)) * 1e-9
    velocity = np.where(lost[:, None], held, 0.5 * (v[:-1] + v[1:]))
    return Inputs(at[1:], np.column_stack([velocity, angle / dt[:, 0]]), np.where(lost, age_s, 0.0))


def _edges(ping_ns: TimeArray, start_ns: int, end_ns: int) -> tuple[TimeArray, BoolArray]:
    """Start, pings and end, with stamps between where the log is lost, and which steps those are."""
    period = int(np.median(np.diff(ping_ns)))
    known = np.unique(np.concatenate([[start_ns], ping_ns[ping_ns > start_ns], [end_ns]]))
    gap = np.diff(known)
    steps = np.where(gap > LOST_PERIODS * period, -(-gap // period), 1)
    first = np.repeat(np.cumsum(steps) - steps, steps)
    share = (np.arange(len(first)) - first) / np.repeat(steps, steps)
    at = np.repeat(known[:-1], steps) + np.rint(share * np.repeat(gap, steps)).astype(np.int64)
    return np.append(at, known[-1]), np.repeat(steps > 1, steps)


def _depths(prepared: Prepared, track: Track) -> list[Direct]:
    stream = prepared.depth
    if stream is None:
        return []
    place = place_at(prepared, stream.t_ns, track)
    # from the sea surface to the plane of n, and from the sensor to the body's origin
    down = stream.depth + place.p_n[:, 2] - place.depth - (place.R_nb @ prepared.dive.rig.depth.l_b)[:, 2]
    return [depth(*row) for row in zip(stream.t_ns.tolist(), down.tolist(), stream.sigma.tolist(), strict=True)]


def _fixes(prepared: Prepared, track: Track) -> list[Direct]:
    stream = prepared.fixes
    if stream is None:
        return []
    m = np.where(np.isfinite(stream.height), 3, 2)
    p_n = ned_from_geodetic(prepared.origin, stream.lat, stream.lon, np.nan_to_num(stream.height))
    p_n = p_n - track.rotation_at(stream.t_ns) @ prepared.dive.rig.fixes.l_b
    each = zip(stream.t_ns.tolist(), p_n, stream.cov_n, m.tolist(), strict=True)
    return [fix(t, p[:k], cov[:k, :k]) for t, p, cov, k in each]


def _headings(prepared: Prepared, track: Track) -> list[Direct]:
    stream = prepared.heading
    if stream is None:
        return []
    north = place_at(prepared, stream.t_ns, track).R_local[:, :, 0]
    psi = stream.heading + np.arctan2(north[:, 1], north[:, 0])
    return [heading(*row) for row in zip(stream.t_ns.tolist(), psi.tolist(), stream.sigma.tolist(), strict=True)]


def _suns(prepared: Prepared, track: Track) -> list[Direct]:
    """Headings by the sun.

    The tilt errs by what the accelerometer's bias makes of gravity: the same for all of them, which together shall say
    no more of it than one.
    """
    if prepared.sun is None:
        return []
    stream = prepared.sun.select(prepared.sun.flags == 0)
    place = place_at(prepared, stream.t_ns, track)
    s_n = sun_direction_n(prepared.origin, stream.t_ns, place.lat, place.lon)
    tilt = prepared.dive.rig.imu.accel_bias_sigma / np.linalg.norm(place.gravity_n, axis=1) * np.sqrt(len(stream))
    each = zip(stream.t_ns.tolist(), stream.s_b, stream.information_b, place.R_nb, s_n, tilt, strict=True)
    headings = []
    for t, s_b, L, R, s, tilt_sigma in each:
        seen = SunObservation(t, s_b, L, np.linalg.pinv(L, hermitian=True), "", 1.0, up_b=-R[2])
        psi = seen.heading(float(np.arctan2(s[1], s[0])))
        headings.append(heading(t, psi, seen.heading_sigma(tilt_sigma), "sun"))
    return headings
