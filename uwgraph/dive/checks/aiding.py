"""The sensors beside the IMU: units, signs, and agreement with each other; and what is missing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from uwgraph.dive.checks.finding import Finding, Level, Subject
from uwgraph.dive.clock_models import down_direction, gyro_heading
from uwgraph.dive.inertial_track import InertialTrack
from uwgraph.dive.model import Dive
from uwgraph.frames import matrix_from_rph
from uwgraph.types import FloatArray, Stream

DVL_VALID = 0.8
DVL_SPEED = 10.0
"""m/s."""
SLOPE_S = 10.0
"""Slopes are taken over this long: a second of clock offset does not matter then."""
GAIN = 2.0
"""By which factor a slope may differ from 1: signs and units are told apart, clocks and noise are not complained of."""


def check_dvl(subject: Subject) -> Iterator[Finding]:
    """Bottom lock, units, and direction against the reference."""
    dvl = subject.dive.dvl
    if dvl is None or len(dvl) == 0:
        return
    share = float(dvl.valid.mean())
    level: Level = "ok" if share >= DVL_VALID else "warning" if share > 0 else "error"
    remedy = "" if level == "ok" else "the position drifts with the IMU alone where the bottom is out of reach"
    yield Finding(level, "dvl", "bottom lock", f"{share:.0%} of the pings are valid", remedy, share, DVL_VALID)
    good = dvl.valid & np.isfinite(dvl.v_s).all(axis=1)
    if not good.any():
        return
    speed = float(np.median(np.linalg.norm(dvl.v_s[good], axis=1)))
    if speed > DVL_SPEED:
        remedy = "looks like cm/s or mm/s: divide by 100 or 1000"
        yield Finding("error", "dvl", "speed", f"the median speed is {speed:.3g} m/s", remedy, speed, DVL_SPEED)
    else:
        yield Finding("ok", "dvl", "speed", f"median speed {speed:.3g} m/s", value=speed, limit=DVL_SPEED)
    reference = subject.dive.reference
    if (
        subject.dive.imu is None
        or reference is None
        or not np.isfinite(reference.v_n).all()
        or not np.isfinite(reference.rph).all()
    ):
        return
    v_ref = np.einsum("nji,nj->ni", matrix_from_rph(reference.rph), reference.v_n)
    t, t_ref = _seconds(subject.dive, "dvl")[good], _seconds(subject.dive, "reference")
    v_dvl = dvl.v_s[good] @ subject.dive.rig.dvl.R_bs.T
    means = _common_means(t, v_dvl, t_ref, v_ref)
    if means is None:
        return
    ours, theirs = means
    gain = float(np.sum(ours * theirs) / np.sum(theirs**2)) if np.sum(theirs**2) > 0 else np.nan
    angle = float(np.arccos(np.clip(np.sum(ours * theirs) / (np.linalg.norm(ours) * np.linalg.norm(theirs)), -1, 1)))
    message = f"{gain:.3f} times the reference's body velocity, {np.degrees(angle):.1f} deg apart"
    if not 1 / GAIN < gain < GAIN or angle > np.radians(20):
        remedy = (
            "the velocity has the wrong sign (water track, or the bottom's velocity): negate it"
            if gain < 0
            else "check rig.dvl.rotation_deg and the units"
        )
        yield Finding("error", "dvl", "direction", message, remedy, gain, 1.0)
    else:
        yield Finding("ok", "dvl", "direction", message, value=gain, limit=1.0)


def check_depth(subject: Subject) -> Iterator[Finding]:
    """Sign and units, by itself and against the vertical speed of the DVL."""
    dive, track = subject.dive, subject.track
    if dive.depth is None or len(dive.depth) == 0:
        return
    middle = float(np.median(dive.depth.depth))
    if middle < -2.0:
        remedy = "depth is positive down: change the sign"
        yield Finding(
            "error", "depth", "sign", f"the median depth is {middle:.3g} m, above the sea", remedy, middle, -2.0
        )
        return
    if dive.dvl is None or track is None:
        return
    good = dive.dvl.valid & np.isfinite(dive.dvl.v_s).all(axis=1)
    t = _seconds(dive, "dvl")[good]
    inside = (t > track.t_s[0]) & (t < track.t_s[-1])
    if inside.sum() < 20:
        return
    t = t[inside]
    v_i = track.attitude(t).apply(dive.dvl.v_s[good][inside] @ dive.rig.dvl.R_bs.T)
    sinking = np.sum(v_i * down_direction(track, t), axis=1)
    slope = np.gradient(dive.depth.depth, dive.depth.t_s) if len(dive.depth) > 2 else np.zeros(len(dive.depth))
    means = _common_means(t, sinking[:, None], _seconds(dive, "depth"), slope[:, None])
    if means is None:
        return
    by_dvl, by_depth = means[0].ravel(), means[1].ravel()
    power = float(by_dvl @ by_dvl)
    gain = float(by_depth @ by_dvl) / power if power > 0 else np.nan
    sigma = float(np.sqrt(np.mean((by_depth - gain * by_dvl) ** 2) / power)) if power > 0 else np.inf
    if not sigma < 0.05 * max(abs(gain), 1.0):
        yield Finding("info", "depth", "vertical speed", "the depth changes too little to compare it with the DVL")
        return
    message = f"depth changes {gain:.3f} times as fast as the DVL says"
    if not 1 / GAIN < gain < GAIN:
        remedy = "depth is positive down: change the sign" if gain < 0 else "check the units (m, not ft, dbar or cm)"
        yield Finding("error", "depth", "vertical speed", message, remedy, gain, 1.0)
    else:
        yield Finding("ok", "depth", "vertical speed", message, value=gain, limit=1.0)


def check_headings(subject: Subject) -> Iterator[Finding]:
    """Heading changes of compass and reference against the gyro's."""
    dive, track = subject.dive, subject.track
    if track is None:
        return
    if dive.heading is not None:
        yield from _heading_changes(subject.dive, track, "heading", dive.heading.heading)
    if dive.reference is not None:
        yield from _heading_changes(subject.dive, track, "reference", dive.reference.rph[:, 2])


def _heading_changes(dive: Dive, track: InertialTrack, name: str, heading: FloatArray) -> Iterator[Finding]:
    t = _seconds(dive, name)
    use = np.isfinite(heading) & (t > track.t_s[0] + SLOPE_S) & (t < track.t_s[-1] - SLOPE_S)
    if use.sum() < 20:
        return
    sampled = _every(t[use], SLOPE_S)
    theirs = np.diff(np.unwrap(heading[use])[sampled])
    ours = np.diff(np.unwrap(gyro_heading(track, t[use]))[sampled])
    power = float(ours @ ours)
    if max(power, float(theirs @ theirs)) < np.radians(20) ** 2:
        yield Finding("info", name, "heading changes", "the vehicle turns too little to compare it with the gyro")
        return
    gain = float(theirs @ ours) / power
    message = f"heading changes {gain:.3f} times as much as the gyro says"
    if not 1 / GAIN < gain < GAIN:
        remedy = "heading is clockwise from north in radians; or the gyro has the wrong sign, unit or frame"
        yield Finding("error", name, "heading changes", message, remedy, gain, 1.0)
    else:
        yield Finding("ok", name, "heading changes", message, value=gain, limit=1.0)


def check_sun(subject: Subject) -> Iterator[Finding]:
    """Unit vectors that point up, with an information matrix that a sun direction can have."""
    dive, track = subject.dive, subject.track
    sun = dive.sun
    if sun is None or len(sun) == 0:
        return
    off = float(np.abs(np.linalg.norm(sun.s_b, axis=1) - 1).max())
    if off > 1e-3:
        yield Finding("error", "sun", "unit vector", f"lengths are off by {off:.3g}", "divide by the length", off, 1e-3)
        return
    eigenvalues = np.linalg.eigvalsh(sun.information_b)
    top = np.maximum(eigenvalues[:, 2], 1e-300)
    along = np.einsum("ni,nij,nj->n", sun.s_b, sun.information_b, sun.s_b) / top
    bad = (eigenvalues[:, 0] < -1e-6 * top) | (along > 0.01) | (eigenvalues[:, 2] <= 0)
    if bad.any():
        message = f"{int(bad.sum())} information matrices are negative, empty or inform about the sun's own direction"
        remedy = "use the rank-2 information of the front end: zero along s_b, positive across"
        yield Finding("error", "sun", "information", message, remedy, float(bad.mean()), 0.0)
    else:
        single = float(np.mean(eigenvalues[:, 1] < 1e-6 * top))
        yield Finding("ok", "sun", "information", f"rank 2, {single:.0%} of rank 1", value=single)
    if track is None:
        return
    t = _seconds(dive, "sun")
    inside = (t >= track.t_s[0]) & (t <= track.t_s[-1])
    if not inside.any():
        return
    up = -track.attitude(t[inside]).inv().apply(down_direction(track, t[inside]))
    below = float(np.mean(np.sum(up * sun.s_b[inside], axis=1) < 0))
    if below > 0.01:
        remedy = "s_b points to the sun in the body frame (FRD, z down): change the sign or the camera's mounting"
        yield Finding("error", "sun", "above horizon", f"{below:.0%} point below the horizon", remedy, below, 0.01)
    else:
        yield Finding("ok", "sun", "above horizon", f"{below:.0%} point below the horizon", value=below, limit=0.01)


def _seconds(dive: Dive, name: str) -> FloatArray:
    """Stamps since the IMU's first, the rig's offset applied."""
    assert dive.imu is not None
    stream: Stream = getattr(dive, name)
    seconds: FloatArray = (stream.t_ns - dive.imu.t_ns[0]) * 1e-9 + getattr(dive.rig, name).time_offset_s
    return seconds


def _common_means(
    t_a: FloatArray, a: FloatArray, t_b: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Means of two signals over the windows of SLOPE_S that both fill; None when there are fewer than three."""
    window_a, window_b = (np.floor(t / SLOPE_S).astype(np.int64) for t in (t_a, t_b))
    common = np.intersect1d(_filled(window_a), _filled(window_b))
    if len(common) < 3:
        return None
    return (
        np.array([a[window_a == k].mean(axis=0) for k in common]),
        np.array([b[window_b == k].mean(axis=0) for k in common]),
    )


def _filled(window: NDArray[np.int64]) -> NDArray[np.int64]:
    """Windows with at least half of the usual number of samples."""
    numbers, counts = np.unique(window, return_counts=True)
    return numbers[counts >= max(2.0, 0.5 * float(np.median(counts)))]


def _every(t: FloatArray, period: float) -> NDArray[np.intp]:
    """Indices of samples about a period apart."""
    index: NDArray[np.intp] = np.unique(np.floor((t - t[0]) / period), return_index=True)[1]
    return index
