"""What every optical method gives: one direction of the sun in the body, with its information and its doubts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntFlag
from typing import Final

import numpy as np

from uwgraph.frames import wrap_pi
from uwgraph.types import FloatArray, Sun


class SunFlag(IntFlag):
    """Why an observation must not be used; 0 when it may. The numbers are those of ``sun.parquet``."""

    DARK = 1
    """Hardly any light: counts at the noise of the sensor."""
    SATURATED = 2
    """Most of the sky in view is overexposed."""
    UNIFORM = 4
    """No structure above the noise: overcast, fog, a covered lens."""
    UNPOLARIZED = 8
    """Too little polarization for an angle."""
    SMALL_WINDOW = 16
    """Too little of the sky is in view or unmasked, or it covers too little of the azimuth circle."""
    NEAR_ZENITH = 32
    """The sun is too near the zenith to tell a heading."""
    NIGHT = 64
    """The almanac has the sun below the horizon, or too low."""
    AMBIGUOUS = 128
    """Two directions explain the image about as well."""
    SIGN = 256
    """The tests for the sense of the direction disagree."""
    MISFIT = 512
    """The sky does not follow the model: residuals far above the noise."""
    ZENITH_DISAGREES = 1024
    """The sun found is not at the height that time and place give: wrong camera, mosaic, tilt, time or place."""
    UNCERTAIN = 2048
    """The covariance is too large to be of use."""

    @classmethod
    def of(cls, doubts: Mapping[SunFlag, bool]) -> SunFlag:
        """The flags of the doubts that apply."""
        return cls(sum(flag for flag, applies in doubts.items() if applies))

    def names(self) -> tuple[str, ...]:
        """Lower-case names of the flags that are set."""
        return tuple(str(flag.name).lower() for flag in SunFlag if flag in self)


GOOD: Final = SunFlag(0)


@dataclass(frozen=True, eq=False)
class SunObservation:
    """The sun's direction in the body frame, from one image or one sweep."""

    t_ns: int
    """Nanoseconds UTC; 0 when the time is not known."""
    s_b: FloatArray
    """Unit vector to the (apparent) sun, shape (3,); NaN when nothing was found."""
    information_b: FloatArray
    """Rank-2 Lambda, shape (3, 3), rad^-2, zero along ``s_b``: s^T Lambda s is chi-square with 2 degrees."""
    cov_b: FloatArray
    """Covariance of ``s_b``, its pseudo-inverse, shape (3, 3), rad^2."""
    method: str
    """gradient, polarization, scattering."""
    quality: float
    """0 to 1: 1 for a sky that follows the model to the noise over a full view."""
    flags: SunFlag = GOOD
    up_b: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    """Unit vector to the zenith in the body that was used, shape (3,)."""
    other_b: FloatArray | None = None
    """The second mode, shape (3,), where two directions compete."""

    @property
    def ok(self) -> bool:
        return self.flags == 0

    @property
    def azimuth_b(self) -> float:
        """Azimuth of the sun in the levelled body, clockwise from the bow, rad."""
        return float(azimuth_in_level(self.s_b, self.up_b))

    @property
    def elevation(self) -> float:
        """Height of the sun above the horizon, rad."""
        return float(np.arcsin(np.clip(self.s_b @ self.up_b, -1.0, 1.0)))

    @property
    def azimuth_sigma(self) -> float:
        """1-sigma of the azimuth, and so of a heading from it, rad."""
        across = np.cross(self.up_b, self.s_b)
        norm = float(np.linalg.norm(across))
        if not np.isfinite(norm) or norm < 1e-9:
            return float("nan")
        across = across / norm
        return float(np.sqrt(across @ self.cov_b @ across)) / norm

    def heading_sigma(self, tilt_sigma: float) -> float:
        """1-sigma of a heading, rad: a tilt of the vertical by ``tilt_sigma`` turns the azimuth by tan(elevation)."""
        return float(np.hypot(self.azimuth_sigma, tilt_sigma * np.tan(abs(self.elevation))))

    def heading(self, sun_azimuth: float) -> float:
        """True heading [rad] where the almanac has the sun at ``sun_azimuth`` [rad, clockwise from north]."""
        return float(wrap_pi(sun_azimuth - self.azimuth_b))


def no_sun(method: str, flags: SunFlag, up_b: FloatArray, t_ns: int) -> SunObservation:
    """The observation of an image in which no direction was found."""
    lost = np.full(3, np.nan)
    return SunObservation(t_ns, lost, np.zeros((3, 3)), np.full((3, 3), np.nan), method, 0.0, flags, up_b)


def zenith_angle(d_b: FloatArray, up_b: FloatArray) -> float:
    """Angle of a direction (3,) from the zenith, rad."""
    return float(np.arccos(np.clip(d_b @ up_b, -1.0, 1.0)))


def tilted(up_b: FloatArray, tilt: FloatArray) -> FloatArray:
    """The zenith (3,) moved by a small vector ``tilt`` (3,) across it, rad."""
    moved = up_b + tilt
    up: FloatArray = moved / np.linalg.norm(moved)
    return up


def level_axes(up_b: FloatArray) -> FloatArray:
    """Rows bow, starboard, up of the levelled body, in b, shape (3, 3); the bow is x_b without its vertical part."""
    bow = np.array([1.0, 0.0, 0.0]) - up_b[0] * up_b
    bow = bow / np.linalg.norm(bow)
    return np.stack([bow, np.cross(bow, up_b), up_b])


def azimuth_in_level(d_b: FloatArray, up_b: FloatArray) -> FloatArray:
    """Azimuths [rad], shape (...), clockwise from the bow, of directions (..., 3) in the body."""
    bow, starboard, _ = level_axes(up_b)
    azimuth: FloatArray = np.arctan2(d_b @ starboard, d_b @ bow)
    return azimuth


def up_from_tilt(roll: float, pitch: float) -> FloatArray:
    """Unit vector to the zenith in the body, shape (3,), of roll and pitch [rad]."""
    return np.array([np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)])


def sun_stream(observations: Sequence[SunObservation]) -> Sun:
    """The observations as a stream of a dive, in time order; those without a direction are left out."""
    kept = sorted((o for o in observations if np.isfinite(o.s_b).all()), key=lambda o: o.t_ns)
    return Sun(
        np.array([o.t_ns for o in kept], dtype=np.int64),
        information_b=np.array([o.information_b for o in kept]).reshape(-1, 3, 3),
        s_b=np.array([o.s_b for o in kept]).reshape(-1, 3),
        cov_b=np.array([o.cov_b for o in kept]).reshape(-1, 3, 3),
        method=np.array([o.method for o in kept], dtype=np.str_),
        quality=np.array([o.quality for o in kept], dtype=np.float64),
        flags=np.array([int(o.flags) for o in kept], dtype=np.int64),
    )
