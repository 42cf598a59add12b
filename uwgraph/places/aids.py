"""What is known of two images besides their pixels: rotation, soundings, distance, the slope of the floor.

Each is a whitened residual of the two-view problem: R (body b to body a), c (from camera a to camera b) and the plane
pi (pi . X = 1 for its points X, seen from camera a), all in the body axes of a.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from uwgraph.dive.rig import AltitudeRig
from uwgraph.places.motion import rotation_vector
from uwgraph.types import Altitude, FloatArray

RELIEF: Final = 0.02
"""How far the floor under the sounder is at least off the plane that the camera sees, 1-sigma, parts of the range."""
ANY_SLOPE: Final = float(np.radians(15.0))
"""How far a floor and the vehicle usually lie from level together, 1-sigma, rad."""
STEEPEST: Final = 0.5
"""Cosine: no plane that is tilted by more from across the direction to the floor is the floor."""
TILTED: Final = 3.0
"""A plane that is tilted by more sigma than this is not the floor, unless the sounder's spot on it is in the image."""
BESIDE: Final = float(np.cos(np.radians(10.0)))
"""Cosine of the angle between a point of the image and the spot that the sounder meets, where both see the same."""


@dataclass(frozen=True, eq=False)
class Sounding:
    """A distance to the floor."""

    range: float
    """m."""
    sigma: float
    """m."""
    l_b: FloatArray
    """Place of the sounder in the body, shape (3,), m."""
    axis_b: FloatArray
    """Unit vector along its beam, shape (3,)."""

    def short_of(self, plane: FloatArray, l_camera: FloatArray, ahead: float = 1.0) -> float:
        """By which part of itself the range is too short for the plane ``plane . X = ahead`` seen from the camera."""
        return ahead - float(plane @ (self.l_b + self.range * self.axis_b - l_camera))

    def seen_by(self, rays: FloatArray, l_camera: FloatArray) -> bool:
        """Whether rays (N, 3) of a camera go close to the spot that is sounded."""
        spot = self.l_b + self.range * self.axis_b - l_camera
        return bool(np.any(rays @ spot > BESIDE * np.linalg.norm(spot)))


@dataclass(frozen=True, eq=False)
class Aids:
    """Everything of one pair; None for what is not known."""

    R_ab: FloatArray | None = None
    """Rotation body b to body a, as the gyro says, shape (3, 3)."""
    rotation_sigma: float = np.radians(0.5)
    """rad per axis."""
    sounding_a: Sounding | None = None
    sounding_b: Sounding | None = None
    length: tuple[float, float] | None = None
    """How far the body went, and its 1-sigma, m."""
    down_a: FloatArray | None = None
    """Unit vector down in the body axes of a, shape (3,)."""
    slope_sigma: float = np.radians(5.0)
    """How much the floor slopes, rad."""

    @property
    def soundings(self) -> bool:
        return self.sounding_a is not None or self.sounding_b is not None

    @property
    def floor(self) -> FloatArray:
        """Where the floor is expected from the body of a, unit vector (3,)."""
        if self.down_a is not None:
            return self.down_a
        sounding = self.sounding_a or self.sounding_b
        return np.array([0.0, 0.0, 1.0]) if sounding is None else sounding.axis_b

    def flattest(self, rays: FloatArray, l_b: FloatArray) -> float:
        """Least cosine between the normal of a floor that rays (N, 3) of the camera at l_b meet and :attr:`floor`.

        A slope is a floor where the sounder meets what the camera sees. Elsewhere, before a camera that looks ahead,
        it may be a wall, whose distance the sounder does not tell.
        """
        if self.sounding_a is None or self.sounding_a.seen_by(rays, l_b):
            return STEEPEST
        sigma = ANY_SLOPE if self.down_a is None else self.slope_sigma
        return max(STEEPEST, float(np.cos(TILTED * sigma)))

    def of_rotation(self, R: FloatArray) -> FloatArray:
        """Whitened residual of the rotation, shape (3,) or (0,)."""
        if self.R_ab is None:
            return np.zeros(0)
        return rotation_vector(self.R_ab.T @ R) / self.rotation_sigma

    def of_slope(self, plane: FloatArray) -> FloatArray:
        """Whitened residual of the tilt of a floor, shape (3,); loose where the vertical is not known."""
        sigma = ANY_SLOPE if self.down_a is None else self.slope_sigma
        normal = plane / np.linalg.norm(plane)
        return np.asarray((normal - self.floor * (normal @ self.floor)) / sigma)

    def of_soundings(
        self, R: FloatArray, c: FloatArray, plane: FloatArray, l_b: FloatArray, relief: float = RELIEF
    ) -> FloatArray:
        """Whitened residuals of the ranges at both moments, shape (0 to 2,); ``relief`` in parts of the range."""
        seen = ((self.sounding_a, plane, 1.0), (self.sounding_b, R.T @ plane, 1.0 - float(plane @ c)))
        return np.array([
            s.short_of(pi, l_b, ahead) / np.hypot(s.sigma / s.range, relief) for s, pi, ahead in seen if s is not None
        ])  # fmt: skip

    def of_length(self, R: FloatArray, c: FloatArray, l_b: FloatArray) -> FloatArray:
        """Whitened residual of the distance that the body went, shape (1,) or (0,)."""
        if self.length is None:
            return np.zeros(0)
        length, sigma = self.length
        return np.array([(np.linalg.norm(body_translation(R, c, l_b)) - length) / sigma])

    def scale(self, R: FloatArray, c: FloatArray, floor: FloatArray | None, l_b: FloatArray) -> float | None:
        """What c and the floor (or None) are to be multiplied by to be metres; None where nothing tells."""
        if floor is not None:
            seen = ((self.sounding_a, floor), (self.sounding_b, R.T @ floor / (1.0 - floor @ c)))
            found = [pi @ (s.l_b + s.range * s.axis_b - l_b) for s, pi in seen if s is not None]
            if found and np.mean(found) > 0.0:
                return float(np.mean(found))
        if self.length is not None and np.linalg.norm(c) > 1e-9:
            return _scale_to_length(c, l_b - R @ l_b, max(self.length))  # not zero, where the vehicle stands still
        return None


@dataclass(frozen=True, eq=False)
class Known:
    """Where the aids of any pair come from; None for what the vehicle does not have."""

    rotation: Callable[[int, int], FloatArray | None] | None = None
    """(from_ns, t_ns) -> rotation body at t_ns to body at from_ns, shape (3, 3)."""
    sounding: Callable[[int], Sounding | None] | None = None
    """t_ns -> range to the floor."""
    length: Callable[[int, int], tuple[float, float] | None] | None = None
    """(from_ns, t_ns) -> distance gone and its 1-sigma, m."""
    down: Callable[[int], FloatArray | None] | None = None
    """t_ns -> unit vector down in the body, shape (3,)."""
    rotation_sigma: float = np.radians(0.5)
    """Of ``rotation``, rad per axis."""
    slope_sigma: float = np.radians(5.0)
    """How much the floor slopes, rad."""

    def aids(self, from_ns: int, t_ns: int) -> Aids:
        """What is known of the pair."""
        return Aids(
            R_ab=self.rotation and self.rotation(from_ns, t_ns),
            rotation_sigma=self.rotation_sigma,
            sounding_a=self.sounding and self.sounding(from_ns),
            sounding_b=self.sounding and self.sounding(t_ns),
            length=self.length and self.length(from_ns, t_ns),
            down_a=self.down and self.down(from_ns),
            slope_sigma=self.slope_sigma,
        )


def soundings_of(altitude: Altitude, rig: AltitudeRig, max_gap_s: float = 2.0) -> Callable[[int], Sounding | None]:
    """Ranges of a stream at any moment: linear between two samples that are not further apart than ``max_gap_s``."""
    use = np.isfinite(altitude.altitude) & (altitude.altitude > 0.0)
    stream = altitude.select(use)
    sigma = np.where(np.isfinite(stream.sigma) & (stream.sigma > 0.0), stream.sigma, rig.sigma)
    axis = rig.R_bs[:, 2]

    def at(t_ns: int) -> Sounding | None:
        after = int(np.searchsorted(stream.t_ns, t_ns))
        before = max(after - 1, 0)
        if after == len(stream):
            return None
        t0, t1 = stream.t_ns[before], stream.t_ns[after]
        if not t0 <= t_ns <= t1 or t1 - t0 > max_gap_s * 1e9:
            return None
        share = float(t_ns - t0) / float(max(t1 - t0, 1))
        value = (1.0 - share) * stream.altitude[before] + share * stream.altitude[after]
        return Sounding(float(value), float(max(sigma[before], sigma[after])), rig.l_b, axis)

    return at


def _scale_to_length(c: FloatArray, swing: FloatArray, length: float) -> float | None:
    """s with |s c + swing| = length; None where the camera's own swing about the body is as long, and s ambiguous."""
    squared, along = float(c @ c), float(c @ swing)
    rest = length**2 - float(swing @ swing)
    return None if rest <= 0.0 else (-along + float(np.sqrt(along**2 + squared * rest))) / squared


def body_translation(R: FloatArray, c: FloatArray, l_b: FloatArray) -> FloatArray:
    """Way of the body's origin, in the axes of a, for the way c of a camera at l_b."""
    return np.asarray(c + l_b - R @ l_b)
