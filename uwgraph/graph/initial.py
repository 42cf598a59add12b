"""The first state: level from the accelerometer, heading from whoever knows it, position from the first fix.

Without any heading source the run is refused: a graph would converge to an arbitrary heading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwgraph.errors import InitialisationError
from uwgraph.frames import R_n_local, matrix_from_rph, ned_from_geodetic, wrap_pi
from uwgraph.graph.prepare import Prepared
from uwgraph.graph.settings import SmoothSettings
from uwgraph.graph.track import Track, dead_reckon
from uwgraph.sun.ephemeris import sun_direction_n
from uwgraph.time import isoformat
from uwgraph.types import FloatArray

LEVELLING_S = 10.0
LEVELLING_SIGMA = np.radians(5.0)
"""Loose on purpose: DVL and IMU together know the level better, and levelling used the same samples."""
UNKNOWN_HEADING_SIGMA = np.radians(20.0)
"""Prior where the heading's source is also a factor in the graph: only to keep the first linearisation honest."""
COURSE_MIN_M = 20.0
"""Shortest way between fixes that tells a course."""
UNKNOWN_POSITION_SIGMA = 1000.0


@dataclass(frozen=True, eq=False)
class Initial:
    """The first state and how sure it is."""

    t_ns: int
    R_nb: FloatArray
    p_n: FloatArray
    cov_rotation_b: FloatArray
    """Covariance of the rotation about the body axes, shape (3, 3), rad^2."""
    sigma_p: FloatArray
    """Shape (3,), m."""
    source: str
    """Who said so, for the log."""


def initial_state(prepared: Prepared, settings: SmoothSettings) -> Initial:
    """The first state from the reference or from the dive's own sensors.

    Raises
    ------
    InitialisationError
        When nothing tells the heading; the message lists what would.
    """
    if settings.initial == "reference":
        return _from_reference(prepared, settings)
    t0 = int(prepared.imu.t_ns[0])
    rp = level(prepared, t0)
    levelled = matrix_from_rph(np.array([rp[0], rp[1], 0.0]))
    cov_level = np.diag([LEVELLING_SIGMA, LEVELLING_SIGMA, 0.0]) ** 2
    track = dead_reckon(prepared, t0, levelled, np.zeros(3), levelled.T @ cov_level @ levelled, heading_aids=False)
    heading, sigma, source = _heading(prepared, settings, track)
    R = matrix_from_rph(np.array([rp[0], rp[1], heading]))
    cov_n = np.diag([LEVELLING_SIGMA, LEVELLING_SIGMA, sigma]) ** 2
    cov_b = R.T @ cov_n @ R
    turn = matrix_from_rph(np.array([0.0, 0.0, heading]))
    p, sigma_p, p_source = _position(prepared, settings, track, turn)
    return Initial(t0, R, p, cov_b, sigma_p, f"heading from {source}, position from {p_source}")


def level(prepared: Prepared, t0_ns: int) -> FloatArray:
    """Roll and pitch from the mean specific force over the first seconds, shape (2,), rad."""
    imu = prepared.imu
    end = t0_ns + round(LEVELLING_S * 1e9)
    index = (imu.t_ns[1:] > t0_ns) & (imu.t_ns[1:] <= end)
    f_0 = np.einsum("kij,kj->i", imu.rotation[:-1][index], imu.f_b[index]) / max(index.sum(), 1)
    k = int(np.argmax(index))
    f = imu.rotation[k].T @ f_0
    return np.array([np.arctan2(-f[1], -f[2]), np.arctan2(f[0], np.hypot(f[1], f[2]))])


def _from_reference(prepared: Prepared, settings: SmoothSettings) -> Initial:
    ref = prepared.reference
    if ref is None or not np.isfinite([*ref.rph[0], ref.lat[0], ref.lon[0], ref.height[0]]).all():
        raise InitialisationError(
            "the first state was to come from the reference, which has no full pose at its start within the IMU's span",
            where="reference",
            remedy="leave out --initial reference, or give the heading with --heading-deg",
        )
    origin = prepared.origin
    R = R_n_local(origin, ref.lat[0], ref.lon[0]) @ matrix_from_rph(ref.rph[0])
    point = ned_from_geodetic(origin, ref.lat[0], ref.lon[0], ref.height[0])
    p = point - R @ prepared.dive.rig.reference.l_b
    attitude = np.radians(settings.attitude_sigma_deg) ** 2 * np.eye(3)
    return Initial(int(ref.t_ns[0]), R, p, attitude, np.full(3, settings.position_sigma_m), "the reference")


def _heading(prepared: Prepared, settings: SmoothSettings, track: Track) -> tuple[float, float, str]:
    """Heading at the start, its prior sigma, and its source; ``track`` was reckoned with heading zero."""
    if settings.heading_deg is not None:
        return np.radians(settings.heading_deg), np.radians(settings.heading_sigma_deg), "the user's word"
    if prepared.heading is not None:
        turn = track.heading_at(prepared.heading.t_ns[:10])
        return _circular_mean(prepared.heading.heading[:10] - turn), UNKNOWN_HEADING_SIGMA, "the compass"
    if prepared.sun is not None and (prepared.sun.flags == 0).any():
        return _sun_heading(prepared, track), UNKNOWN_HEADING_SIGMA, "the sun"
    course = _course_heading(prepared, track)
    if course is not None:
        return course, UNKNOWN_HEADING_SIGMA, "the course over the fixes"
    raise InitialisationError(
        "nothing in this dive tells the heading at the start",
        where=f"at {isoformat(track.t_ns[0])}",
        remedy="give it with --heading-deg, or add a heading or sun stream, or position fixes with DVL over "
        f"{COURSE_MIN_M:.0f} m, or start from a reference with --initial reference",
    )


def _sun_heading(prepared: Prepared, track: Track) -> float:
    sun = prepared.sun
    assert sun is not None
    head = sun.select(np.flatnonzero(sun.flags == 0)[:10])
    lat, lon = prepared.origin.lat, prepared.origin.lon
    s_n = sun_direction_n(prepared.origin, head.t_ns, lat, lon)
    seen = np.einsum("kij,kj->ki", track.rotation_at(head.t_ns), head.s_b)
    azimuth = np.arctan2(s_n[:, 1], s_n[:, 0]) - np.arctan2(seen[:, 1], seen[:, 0])
    return _circular_mean(azimuth)


def _course_heading(prepared: Prepared, track: Track) -> float | None:
    """Yaw that turns the dead-reckoned way onto the fixes (two-dimensional least squares)."""
    fixes = prepared.fixes
    if fixes is None or prepared.dvl is None:
        return None
    known = np.isfinite(np.diagonal(fixes.cov_n, axis1=1, axis2=2)[:, :2]).all(axis=1)
    fixes = fixes.select(known)
    if len(fixes) < 2:
        return None
    seen = ned_from_geodetic(prepared.origin, fixes.lat, fixes.lon, np.zeros(len(fixes)))[:, :2]
    way = track.position_at(fixes.t_ns)[:, :2]
    a, b = way - way.mean(axis=0), seen - seen.mean(axis=0)
    spread = np.sqrt((b**2).sum(axis=1).max())
    noise = np.sqrt(np.diagonal(fixes.cov_n, axis1=1, axis2=2)[:, :2].max())
    if spread < max(COURSE_MIN_M, 4.0 * noise) / 2.0:
        return None
    return float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))


def _position(
    prepared: Prepared, settings: SmoothSettings, track: Track, turn: FloatArray
) -> tuple[FloatArray, FloatArray, str]:
    """Position at the start from the first fix, else from the origin; depth from the depth sensor.

    ``turn`` rotates the track, which was reckoned with heading zero, to the heading found.
    """
    rig = prepared.dive.rig
    p = np.zeros(3)
    sigma = np.full(3, settings.position_sigma_m)
    source = "the origin of the dive"
    if prepared.fixes is not None:
        first = prepared.fixes.select(slice(0, 1))
        height = np.nan_to_num(first.height)
        fix = ned_from_geodetic(prepared.origin, first.lat, first.lon, height)[0]
        p[:2] = (fix - turn @ track.point_at(first.t_ns, rig.fixes.l_b)[0])[:2]
        sigma[:] = UNKNOWN_POSITION_SIGMA
        source = f"the first fix ({first.source[0]})"
    if prepared.depth is not None:
        p[2] = prepared.depth.depth[0] - track.point_at(prepared.depth.t_ns[:1], rig.depth.l_b)[0, 2]
        sigma[2] = UNKNOWN_POSITION_SIGMA
    return p, sigma, source


def _circular_mean(angles: FloatArray) -> float:
    return float(wrap_pi(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean())))
