"""One clock and one frame: the dive's streams as the graph takes them.

Time offsets of the rig are applied, sensor axes become body axes, missing sigmas are filled in, invalid samples go.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from factors.lie import cumulative_rotation, exp_so3
from uwgraph.dive import Dive
from uwgraph.dive.checks.presence import too_slow
from uwgraph.errors import DataError
from uwgraph.frames import earth_rate_n
from uwgraph.graph.pings import contradicted
from uwgraph.graph.rest import Rest, bias_at_start, rest_at_start
from uwgraph.types import (
    NOT_MEASURED,
    Depth,
    Fixes,
    FloatArray,
    Heading,
    Imu,
    Origin,
    Reference,
    RelativePoses,
    Sun,
    TimeArray,
)

UNMEASURED = 1e-2 * NOT_MEASURED
"""Variance from which on a direction counts as not measured."""
S = TypeVar("S", Sun, Reference, Depth, Fixes, Heading)
W = TypeVar("W", Depth, Heading)


@dataclass(frozen=True, eq=False)
class BodyImu:
    """The IMU in body axes, and the rotation it implies."""

    t_ns: TimeArray
    """Edges of the samples, shape (N + 1,): sample i is the mean over (t_i, t_{i+1}]."""
    f_b: FloatArray
    """Specific force, shape (N, 3)."""
    w_b: FloatArray
    """Angular rate, shape (N, 3)."""

    @cached_property
    def rotation(self) -> FloatArray:
        """Rotation body(t_k) to body(t_0) against inertial space, shape (N + 1, 3, 3)."""
        dt = np.diff(self.t_ns) * 1e-9
        return cumulative_rotation(exp_so3(self.w_b * dt[:, None]))

    @cached_property
    def velocity(self) -> FloatArray:
        """Specific force integrated in the axes of body(t_0), shape (N + 1, 3), m/s; gravity is not taken off."""
        dt = np.diff(self.t_ns) * 1e-9
        R_mid = 0.5 * (self.rotation[:-1] + self.rotation[1:])
        steps = (R_mid @ self.f_b[:, :, None])[..., 0] * dt[:, None]
        return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    def rotation_at(self, t_ns: TimeArray) -> FloatArray:
        """Rotation body(t) to body(t_0) against inertial space at any times inside, shape (M, 3, 3)."""
        k = np.clip(np.searchsorted(self.t_ns, t_ns, side="right") - 1, 0, len(self.w_b) - 1)
        dt = (np.asarray(t_ns) - self.t_ns[k]) * 1e-9
        R: FloatArray = self.rotation[k] @ exp_so3(self.w_b[k] * dt[:, None])
        return R


@dataclass(frozen=True, eq=False)
class BodyDvl:
    """Bottom velocity of the DVL in body axes."""

    t_ns: TimeArray
    v_b: FloatArray
    """Shape (N, 3), m/s: of the DVL, not of the body origin."""
    cov_b: FloatArray
    """Shape (N, 3, 3)."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A dive ready for the graph."""

    dive: Dive
    imu: BodyImu
    """The bias at rest is already taken off its rates."""
    rest: Rest
    dvl: BodyDvl | None
    depth: Depth | None
    fixes: Fixes | None
    heading: Heading | None
    sun: Sun | None
    reference: Reference | None
    odometry: RelativePoses | None = None
    """Verified steps only."""
    closures: RelativePoses | None = None
    """All of them, also those beyond the IMU's span."""
    refused_pings: int = 0
    """Doppler pings left out, since they contradict their neighbours."""

    @property
    def origin(self) -> Origin:
        return self.dive.origin

    @cached_property
    def earth_rate_n(self) -> FloatArray:
        return earth_rate_n(self.origin)


def prepare(dive: Dive) -> Prepared:
    """Bring every stream to the IMU's clock and the body's axes.

    Raises
    ------
    DataError
        When there is no IMU or one that is too slow, or a magnetic heading without a declination.
    """
    if dive.imu is None or len(dive.imu) < 2:
        raise DataError("the dive has no IMU samples", where="imu", remedy="smoothing needs imu.parquet or imu.csv")
    slow = too_slow(dive.imu)
    if slow is not None:
        raise DataError(slow.message, where="imu", remedy=slow.remedy)
    rig = dive.rig
    raw = body_imu(dive.imu, rig.imu.R_bs, rig.imu.time_offset_ns)
    span = (raw.t_ns[0], raw.t_ns[-1])
    dvl, refused = _without_contradicted(_body_dvl(dive, span), raw, rig.dvl.l_b)
    odometry = _verified(_seen(dive.odometry, rig.visual.time_offset_ns))
    rest = _rest(raw, dvl, odometry, rig.imu.gyro_bias_sigma)
    imu = replace(raw, w_b=raw.w_b - rest.bias_gyro)
    return Prepared(
        dive=dive,
        imu=imu,
        rest=rest,
        dvl=dvl,
        depth=_inside(_filled(dive.depth, rig.depth.sigma, rig.depth.time_offset_ns), span),
        fixes=_inside(_fixes(dive), span),
        heading=_inside(_heading(dive), span),
        sun=_inside(_sun(dive), span),
        reference=_inside(_shifted(dive.reference, rig.reference.time_offset_ns), span),
        odometry=odometry,
        closures=_seen(dive.closures, rig.visual.time_offset_ns),
        refused_pings=refused,
    )


def body_imu(imu: Imu, R_bs: FloatArray, offset_ns: int) -> BodyImu:
    """The IMU in body axes, with the edge before the first sample put a period earlier: the first or the usual one."""
    t = imu.t_ns + offset_ns
    first = t[0] - min(int(np.median(np.diff(t))), int(t[1] - t[0]))
    return BodyImu(np.concatenate([[first], t]), imu.f_s @ R_bs.T, imu.w_s @ R_bs.T)


def _rest(imu: BodyImu, dvl: BodyDvl | None, odometry: RelativePoses | None, bias_sigma: float) -> Rest:
    if dvl is not None:
        return rest_at_start(imu.t_ns, imu.w_b, dvl.t_ns, np.linalg.norm(dvl.v_b, axis=1), bias_sigma)
    if odometry is not None:
        odometry = odometry.select((odometry.from_ns >= imu.t_ns[0]) & (odometry.t_ns <= imu.t_ns[-1]))
        dR = np.swapaxes(imu.rotation_at(odometry.from_ns), 1, 2) @ imu.rotation_at(odometry.t_ns)
        return bias_at_start(odometry, dR, bias_sigma)
    return Rest(np.zeros(3), bias_sigma)


def seen_velocity(odometry: RelativePoses | None) -> tuple[TimeArray, FloatArray]:
    """Mean velocity in the body over every step of visual odometry whose length is known, at its middle."""
    if odometry is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    known = odometry.select(np.trace(odometry.cov[:, 3:, 3:], axis1=1, axis2=2) < UNMEASURED)
    middle, first = np.unique(known.from_ns + (known.t_ns - known.from_ns) // 2, return_index=True)
    return middle, (known.p / ((known.t_ns - known.from_ns) * 1e-9)[:, None])[first]


def _body_dvl(dive: Dive, span: tuple[int, int]) -> BodyDvl | None:
    if dive.dvl is None:
        return None
    rig = dive.rig.dvl
    t = dive.dvl.t_ns + rig.time_offset_ns
    keep = dive.dvl.valid & np.isfinite(dive.dvl.v_s).all(axis=1) & (t >= span[0]) & (t <= span[1])
    if not keep.any():
        return None
    cov_s = dive.dvl.cov_s[keep]
    cov_s = np.where(np.isfinite(cov_s).all(axis=(1, 2), keepdims=True), cov_s, rig.sigma**2 * np.eye(3))
    R = rig.R_bs
    return BodyDvl(t[keep], rig.scale * dive.dvl.v_s[keep] @ R.T, rig.scale**2 * R @ cov_s @ R.T)


def _without_contradicted(dvl: BodyDvl | None, imu: BodyImu, l_b: FloatArray) -> tuple[BodyDvl | None, int]:
    """The pings that agree with their neighbours, and how many do not."""
    if dvl is None:
        return None, 0
    velocity = np.column_stack([np.interp(dvl.t_ns - imu.t_ns[0], imu.t_ns - imu.t_ns[0], v) for v in imu.velocity.T])
    k = np.clip(np.searchsorted(imu.t_ns, dvl.t_ns) - 1, 0, len(imu.w_b) - 1)
    v_b = dvl.v_b - np.cross(imu.w_b[k], l_b)
    u_g = (imu.rotation_at(dvl.t_ns) @ v_b[:, :, None])[..., 0] - velocity
    wrong = contradicted(dvl.t_ns, u_g, np.sqrt(np.diagonal(dvl.cov_b, axis1=1, axis2=2).max(axis=1)))
    return BodyDvl(dvl.t_ns[~wrong], dvl.v_b[~wrong], dvl.cov_b[~wrong]), int(wrong.sum())


def _shifted(stream: S | None, offset_ns: int) -> S | None:
    return None if stream is None else replace(stream, t_ns=stream.t_ns + offset_ns)


def _filled(stream: W | None, sigma: float, offset_ns: int) -> W | None:
    if stream is None:
        return None
    filled = np.where(np.isfinite(stream.sigma), stream.sigma, sigma)
    return replace(stream, t_ns=stream.t_ns + offset_ns, sigma=filled)


def _fixes(dive: Dive) -> Fixes | None:
    if dive.fixes is None:
        return None
    cov = dive.fixes.cov_n
    cov = np.where(np.isnan(cov).any(axis=(1, 2), keepdims=True), dive.rig.fixes.sigma**2 * np.eye(3), cov)
    return replace(dive.fixes, t_ns=dive.fixes.t_ns + dive.rig.fixes.time_offset_ns, cov_n=cov)


def _heading(dive: Dive) -> Heading | None:
    rig = dive.rig.heading
    stream = _filled(dive.heading, np.radians(rig.sigma_deg), rig.time_offset_ns)
    if stream is not None and rig.rotation_deg[2]:
        stream = replace(stream, heading=stream.heading - np.radians(rig.rotation_deg[2]))
    if stream is None or stream.reference == "true":
        return stream
    if rig.declination_deg is None:
        raise DataError(
            "the heading is magnetic and the declination is not given",
            where="heading",
            remedy="set rig.heading.declination_deg in dive.yaml, or take heading off its list of streams",
        )
    return replace(stream, heading=stream.heading + np.radians(rig.declination_deg), reference="true")


def _sun(dive: Dive) -> Sun | None:
    sun, R = _shifted(dive.sun, dive.rig.sun.time_offset_ns), dive.rig.sun.R_bs
    if sun is None or not any(dive.rig.sun.rotation_deg):
        return sun
    return replace(sun, information_b=R @ sun.information_b @ R.T, s_b=sun.s_b @ R.T, cov_b=R @ sun.cov_b @ R.T)


def _seen(stream: RelativePoses | None, offset_ns: int) -> RelativePoses | None:
    return None if stream is None else replace(stream, t_ns=stream.t_ns + offset_ns, from_ns=stream.from_ns + offset_ns)


def _verified(stream: RelativePoses | None) -> RelativePoses | None:
    if stream is None or not stream.accepted.any():
        return None
    return stream.select(stream.accepted)


def _inside(stream: S | None, span: tuple[int, int]) -> S | None:
    """The samples within the IMU's span; None when none is left."""
    if stream is None:
        return None
    kept = stream.select((stream.t_ns >= span[0]) & (stream.t_ns <= span[1]))
    return kept if len(kept) else None
