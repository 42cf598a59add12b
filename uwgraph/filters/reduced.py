"""A dive as the kinematic model sees it: Doppler log and gyro as inputs, everything else as numbers of its state.

Roll and pitch are taken from dead reckoning, and taken for true; so are lever arms turned by them. Where the log has
gaps the velocity is interpolated: the model has nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.lie import exp_so3
from uwgraph.errors import DataError
from uwgraph.filters.kinematic import Direct, InputNoise, Inputs, Kinematic, depth, fix, heading, levelled
from uwgraph.filters.state import Belief
from uwgraph.frames import ned_from_geodetic, rph_from_matrix, wrap_pi
from uwgraph.graph.initial import Initial
from uwgraph.graph.place import place_at
from uwgraph.graph.prepare import BodyDvl, Prepared
from uwgraph.graph.track import Track, body_velocity, dead_reckon
from uwgraph.sun.ephemeris import sun_direction_n
from uwgraph.sun.observation import SunObservation


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
    noise = _noise(prepared, dvl)
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


def _noise(prepared: Prepared, dvl: BodyDvl) -> InputNoise:
    """What the rig states; errors of scale and mounting are those of a velocity that hardly changes."""
    rig, imu = prepared.dive.rig.dvl, prepared.dive.rig.imu
    sigma = np.sqrt(np.median(np.trace(dvl.cov_b, axis1=1, axis2=2)) / 3.0)
    speed = np.median(np.linalg.norm(dvl.v_b, axis=1))
    return InputNoise(
        velocity_density=float(sigma * np.sqrt(np.median(np.diff(dvl.t_ns)) * 1e-9)),
        rate_density=imu.gyro_noise_density,
        velocity_bias_sigma=float(speed * np.hypot(rig.scale_sigma, np.radians(rig.misalignment_sigma_deg))),
        rate_bias_sigma=prepared.rest.sigma,
        rate_bias_walk=imu.gyro_bias_walk,
    )


def _inputs(prepared: Prepared, dvl: BodyDvl, track: Track, start_ns: int) -> Inputs:
    """From each ping to the next: the mean velocity along levelled axes, and what the gyro turns the heading by."""
    t_ns = dvl.t_ns[dvl.t_ns > start_ns]
    at = np.concatenate([[start_ns], t_ns])
    dt = np.diff(at)[:, None] * 1e-9
    R, gyro = track.rotation_at(at), prepared.imu.rotation_at(at)
    turned = exp_so3(-prepared.earth_rate_n * dt) @ R[:-1] @ np.swapaxes(gyro[:-1], 1, 2) @ gyro[1:]
    angle = wrap_pi(rph_from_matrix(turned)[:, 2] - rph_from_matrix(R[:-1])[:, 2])
    v = levelled(body_velocity(prepared, at), R)
    return Inputs(t_ns, np.column_stack([0.5 * (v[:-1] + v[1:]), angle / dt[:, 0]]))


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
