"""The core types: frozen dataclasses of arrays, one array per column.

This file imports nothing of ours, and everything else may import it.

Names carry frames (see the package docstring): ``n`` navigation (NED), ``b`` body (FRD, origin at the IMU), ``s`` the
sensor named by the type. Times are int64 nanoseconds UTC, angles radians, everything else SI.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
TimeArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
StrArray = NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class Stream:
    """Samples of one sensor in time order; every array's first axis is the sample."""

    t_ns: TimeArray
    """Stamps, shape (N,), int64 nanoseconds UTC."""

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def t_s(self) -> FloatArray:
        """Seconds since the first sample, shape (N,)."""
        return (self.t_ns - self.t_ns[:1]).astype(np.float64) * 1e-9

    def select(self, index: Any) -> Self:
        """The samples that a slice, a mask or an index array picks."""
        picked = {f.name: getattr(self, f.name)[index] for f in fields(self) if f.name not in self.scalars()}
        return replace(self, **picked)

    @classmethod
    def scalars(cls) -> tuple[str, ...]:
        """Names of the fields that belong to the whole stream, not to a sample."""
        return ()


@dataclass(frozen=True, eq=False)
class Imu(Stream):
    """Inertial samples; the sample at t_i is the mean over (t_{i-1}, t_i]."""

    f_s: FloatArray
    """Specific force in the sensor frame, shape (N, 3), m/s^2; (0, 0, -g) at rest for an FRD sensor."""
    w_s: FloatArray
    """Angular rate against inertial space in the sensor frame, shape (N, 3), rad/s."""


@dataclass(frozen=True, eq=False)
class Dvl(Stream):
    """Velocity over the ground from a Doppler log, instantaneous at its stamp."""

    v_s: FloatArray
    """Velocity of the DVL over the bottom in the instrument frame, shape (N, 3), m/s."""
    cov_s: FloatArray
    """Covariance of ``v_s``, shape (N, 3, 3); NaN where the log has none (the rig's sigma is then used)."""
    valid: BoolArray
    """Whether the bottom was locked, shape (N,)."""


@dataclass(frozen=True, eq=False)
class Depth(Stream):
    """Depth of the depth sensor below the sea surface, along the local vertical."""

    depth: FloatArray
    """Metres, positive down, shape (N,)."""
    sigma: FloatArray
    """1-sigma in metres, shape (N,); NaN where the log has none (the rig's sigma is then used)."""


@dataclass(frozen=True, eq=False)
class Fixes(Stream):
    """Positions on the ellipsoid from GNSS, USBL, gravity matching and the like."""

    lat: FloatArray
    """Geodetic latitude, shape (N,), rad."""
    lon: FloatArray
    """Longitude, shape (N,), rad."""
    height: FloatArray
    """Ellipsoidal height, shape (N,), m; NaN where the fix is horizontal only."""
    cov_n: FloatArray
    """Covariance (north, east, down), shape (N, 3, 3), m^2; infinite variance on what is not measured."""
    source: StrArray
    """gnss, usbl, gravity, ..., shape (N,)."""


@dataclass(frozen=True, eq=False)
class Heading(Stream):
    """Heading of the body's x axis, clockwise from north."""

    heading: FloatArray
    """Shape (N,), rad."""
    sigma: FloatArray
    """1-sigma, shape (N,), rad; NaN where the log has none."""
    reference: str = "true"
    """``true`` or ``magnetic``."""

    @classmethod
    def scalars(cls) -> tuple[str, ...]:
        return ("reference",)


@dataclass(frozen=True, eq=False)
class Sun(Stream):
    """Sun directions in the body frame, each with its rank-2 information matrix."""

    information_b: FloatArray
    """Information of s_b, shape (N, 3, 3), rad^-2: zero along s_b, chi-square with 2 degrees of freedom."""
    s_b: FloatArray
    """Unit vector to the sun, shape (N, 3)."""
    cov_b: FloatArray
    """Covariance of ``s_b``, shape (N, 3, 3), rad^2; NaN where not stated."""
    method: StrArray
    """gradient, polarization, simulated, ..., shape (N,)."""
    quality: FloatArray
    """0 to 1, shape (N,)."""
    flags: TimeArray
    """Bit flags of the front end, shape (N,); 0 when good."""


@dataclass(frozen=True, eq=False)
class Gravity(Stream):
    """Gravimeter samples, m/s^2."""

    value: FloatArray
    """Shape (N,), m/s^2."""
    sigma: FloatArray
    """Shape (N,), m/s^2."""
    kind: str = "anomaly"
    """``gravity`` (measured) or ``anomaly`` (free-air)."""

    @classmethod
    def scalars(cls) -> tuple[str, ...]:
        return ("kind",)


@dataclass(frozen=True, eq=False)
class Images(Stream):
    """Image files of one camera."""

    file: StrArray
    """Paths relative to the camera's folder, shape (N,)."""
    camera: str = "camera"
    """Name of the camera: its folder under ``images/``."""

    @classmethod
    def scalars(cls) -> tuple[str, ...]:
        return ("camera",)


@dataclass(frozen=True, eq=False)
class Altitude(Stream):
    """Distance from an echo sounder to the bottom, along the sensor's z axis."""

    altitude: FloatArray
    """Metres, shape (N,)."""
    sigma: FloatArray
    """1-sigma in metres, shape (N,); NaN where the log has none (the rig's sigma is then used)."""


@dataclass(frozen=True, eq=False)
class RelativePoses(Stream):
    """Motions of the body between two moments each, as a camera saw them: visual odometry, or places seen again.

    T is the pose of the body at ``t_ns`` seen from the body at ``from_ns``.
    """

    from_ns: TimeArray
    """The earlier moment, shape (N,)."""
    p: FloatArray
    """Translation of T in the body axes of ``from_ns``, shape (N, 3), m."""
    rotvec: FloatArray
    """Rotation vector of T (body at ``t_ns`` to body at ``from_ns``), shape (N, 3), rad."""
    cov: FloatArray
    """Covariance in the tangent at T, rotation then translation in the axes of the end body, shape (N, 6, 6).

    What was not measured (a monocular scale) has a variance of :data:`NOT_MEASURED` along its direction.
    """
    accepted: BoolArray
    """Whether the geometry was verified, shape (N,); the others are kept for the record."""
    reason: StrArray
    """How it was found, or why it was rejected, shape (N,)."""
    inliers: TimeArray
    """Matched points that agree, shape (N,)."""


NOT_MEASURED = 1e6
"""Variance, m^2 or rad^2, that stands for 'not measured'."""


@dataclass(frozen=True, eq=False)
class ClosureVerdicts(Stream):
    """What smoothing decided about every closure."""

    from_ns: TimeArray
    """The earlier moment, shape (N,)."""
    accepted: BoolArray
    """Whether the solution rests on it, shape (N,)."""
    reason: StrArray
    """Why, in words, shape (N,)."""
    weight: FloatArray
    """What its information was multiplied by in the end, 0 to 1, shape (N,)."""
    chi2_odometry: FloatArray
    """Squared Mahalanobis distance from what the dive says without closures, shape (N,); NaN where not computed."""
    chi2: FloatArray
    """Squared Mahalanobis distance from the final trajectory, its covariance left out; NaN where not computed."""


@dataclass(frozen=True, eq=False)
class Innovations(Stream):
    """What a filter made of every measurement, in the order in which it took them.

    Whitened by the noise that the rig or the log states: one unit is one stated sigma.
    """

    kind: StrArray
    """dvl, depth, fixes, heading, sun, closures, ..., shape (N,)."""
    dof: TimeArray
    """Dimension m of the measurement, shape (N,)."""
    whitened: FloatArray
    """Prediction minus measurement, shape (N, D); NaN beyond the measurement's own dimension."""
    nis: FloatArray
    """Squared Mahalanobis distance from the prediction with the noise that the filter believed, over m, shape (N,)."""
    accepted: BoolArray
    """Whether it was used, shape (N,); the gate refused the others."""
    noise: FloatArray
    """1-sigma that the filter believed along each axis, shape (N, D): 1 where it is the stated one; NaN beyond."""
    fading: FloatArray
    """What the predicted covariance was multiplied by, shape (N,): 1 where the filter trusted it."""


@dataclass(frozen=True, eq=False)
class Reference(Stream):
    """Somebody else's solution or the simulator's truth; NaN where a quantity is not known."""

    lat: FloatArray
    """Geodetic latitude, shape (N,), rad."""
    lon: FloatArray
    """Longitude, shape (N,), rad."""
    height: FloatArray
    """Height above the sea surface, shape (N,), m (negative when submerged)."""
    rph: FloatArray
    """Roll, pitch and true heading against the local NED frame, shape (N, 3), rad."""
    v_n: FloatArray
    """Velocity in the local north, east, down frame, shape (N, 3), m/s."""


@dataclass(frozen=True)
class Origin:
    """Where the navigation frame touches the WGS-84 ellipsoid (height 0)."""

    lat: float
    """Geodetic latitude, rad."""
    lon: float
    """Longitude, rad."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Every state and its covariance at every keyframe, and how the solver got there.

    Covariances of the pose are in GTSAM's tangent order: rotation then translation, both in the body frame.
    """

    origin: Origin
    t_ns: TimeArray
    """Keyframe stamps, shape (K,)."""
    R_nb: FloatArray
    """Rotation body to navigation, shape (K, 3, 3)."""
    p_n: FloatArray
    """Position of the body origin, shape (K, 3), m."""
    v_n: FloatArray
    """Velocity over the ground, shape (K, 3), m/s."""
    bias_gyro: FloatArray
    """Shape (K, 3), rad/s."""
    bias_accel: FloatArray
    """Shape (K, 3), m/s^2."""
    cov_pose: FloatArray
    """Shape (K, 6, 6); NaN where covariances were not asked for."""
    cov_v: FloatArray
    """Shape (K, 3, 3), navigation frame."""
    cov_bias: FloatArray
    """Shape (K, 6, 6), accelerometer then gyro (GTSAM's order)."""
    calibration: Mapping[str, Any] = field(default_factory=dict)
    """Quantities estimated once for the whole dive, with their 1-sigma."""
    closures: ClosureVerdicts | None = None
    """What was decided about every closure; None where there were none, or they were not asked for."""
    info: Mapping[str, Any] = field(default_factory=dict)
    """Iterations, errors, times, counts of measurements: what ``run.log`` tells."""

    def __len__(self) -> int:
        return len(self.t_ns)


def stream_fields(stream: Stream) -> Iterator[tuple[str, NDArray[Any]]]:
    """Name and array of every per-sample field of a stream."""
    for f in fields(stream):
        if f.name not in stream.scalars():
            yield f.name, getattr(stream, f.name)
