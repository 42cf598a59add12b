"""The light of the sky: radiance, polarization, the sun's disc, clouds, and what hides the sky.

Directions ``d`` are unit vectors from the eye in the local level frame l (north, east, down), shape (N, 3). Stokes
vectors are (I, Q, U) about the horizontal axis X = up x d with Y = d x X, so that Q > 0 is polarized horizontally.
The unit of radiance is that of the clear zenith; irradiance is in the same unit times steradian.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from uwgraph.types import FloatArray

UP: Final = np.array([0.0, 0.0, -1.0])
SUN_RADIUS: Final = float(np.radians(0.2666))


@dataclass(frozen=True)
class CieSky:
    """Gradation (a, b) and indicatrix (c, d, e) of a CIE standard general sky (ISO 15469:2004)."""

    a: float
    b: float
    c: float
    d: float
    e: float

    def gradation(self, cos_zenith: FloatArray) -> FloatArray:
        """phi(Z) = 1 + a exp(b / cos Z), of directions above the horizon."""
        return np.asarray(1.0 + self.a * np.exp(self.b / np.maximum(cos_zenith, 1e-3)))

    def indicatrix(self, gamma: FloatArray) -> FloatArray:
        """f(gamma) = 1 + c (exp(d gamma) - exp(d pi / 2)) + e cos^2 gamma, gamma the angle from the sun."""
        f = 1.0 + self.c * (np.exp(self.d * gamma) - np.exp(self.d * np.pi / 2.0)) + self.e * np.cos(gamma) ** 2
        return np.asarray(f)

    def relative_radiance(self, cos_zenith: FloatArray, gamma: FloatArray, sun_zenith: float) -> FloatArray:
        """Radiance over that of the zenith."""
        at_zenith = self.indicatrix(np.asarray(sun_zenith)) * self.gradation(np.ones(()))
        return np.asarray(self.indicatrix(gamma) * self.gradation(cos_zenith) / at_zenith)


_GRADATION = {1: (4.0, -0.7), 2: (1.1, -0.8), 3: (0.0, -1.0), 4: (-1.0, -0.55), 5: (-1.0, -0.32), 6: (-1.0, -0.15)}
_INDICATRIX = {
    1: (0.0, -1.0, 0.0),
    2: (2.0, -1.5, 0.15),
    3: (5.0, -2.5, 0.30),
    4: (10.0, -3.0, 0.45),
    5: (16.0, -3.0, 0.30),
    6: (24.0, -2.8, 0.15),
}
_GROUPS = ((1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2), (3, 3), (3, 4),
           (4, 2), (4, 3), (4, 4), (5, 4), (5, 5), (6, 5), (6, 6))  # fmt: skip
CIE_SKIES: Final = {i: CieSky(*_GRADATION[g], *_INDICATRIX[f]) for i, (g, f) in enumerate(_GROUPS, start=1)}
"""The fifteen types: 1 to 6 overcast, 7 to 10 partly cloudy, 11 to 15 clear (12: clear, low turbidity)."""


class Layer(Protocol):
    """Something before the sky: it lets a part of the light through and adds its own."""

    def over(self, stokes: FloatArray, d_l: FloatArray, s_l: FloatArray) -> FloatArray:
        """Stokes vectors (N, 3) of the sky with the layer before it."""


@dataclass(frozen=True, eq=False)
class Sky:
    """A sky with its sun; ``sky.stokes(d_l)`` is what an eye in air sees."""

    s_l: FloatArray
    """Unit vector to the sun in l, shape (3,)."""
    cie: CieSky = CIE_SKIES[12]
    dop_max: float = 0.75
    """Degree of polarization that is nowhere exceeded."""
    neutral_angle: float = float(np.radians(15.0))
    """How far Babinet's and Arago's points are from the sun and the antisun on the horizon, rad; 0: at them."""
    sun_irradiance: float = 0.0
    """Of the direct beam on a plane normal to it; about 20 on a clear day."""
    sun_radius: float = SUN_RADIUS
    """Radius of the disc, rad; a renderer may widen it to its pixels, the irradiance stays."""
    layers: tuple[Layer, ...] = ()
    """Clouds and occluders, from far to near."""

    @property
    def sun_zenith(self) -> float:
        """Rad."""
        return float(np.arccos(np.clip(-self.s_l[2], -1.0, 1.0)))

    def stokes(self, d_l: FloatArray) -> FloatArray:
        """(I, Q, U) about the horizontal axis, shape (N, 3); zero below the horizon."""
        seen = self.background(d_l)
        seen[:, 0] += self._disc(d_l)
        for layer in self.layers:
            seen = layer.over(seen, d_l, self.s_l)
        seen[-d_l[:, 2] <= 0.0] = 0.0
        return seen

    def background(self, d_l: FloatArray) -> FloatArray:
        """The cloudless sky without the sun's disc, shape (N, 3)."""
        gamma = angle_between(d_l, self.s_l)
        radiance = self.cie.relative_radiance(-d_l[:, 2], gamma, self.sun_zenith)
        polarization = self.dop_max * sky_polarization(d_l, self.s_l, self.neutral_angle)
        return np.column_stack([radiance, radiance * polarization.real, radiance * polarization.imag])

    def _disc(self, d_l: FloatArray) -> FloatArray:
        solid_angle = 2.0 * np.pi * (1.0 - np.cos(self.sun_radius))
        on_disc = d_l @ self.s_l > np.cos(self.sun_radius)
        return np.where(on_disc, self.sun_irradiance / solid_angle, 0.0)


def horizontal_axis(d_l: FloatArray) -> FloatArray:
    """X = up x d, unit, shape (N, 3); east where d is the zenith."""
    x = np.column_stack([d_l[:, 1], -d_l[:, 0], np.zeros(len(d_l))])
    norm = np.linalg.norm(x, axis=1)
    x[norm < 1e-12] = (0.0, 1.0, 0.0)
    x /= np.where(norm < 1e-12, 1.0, norm)[:, None]
    return x


def angle_between(d: FloatArray, s: FloatArray) -> FloatArray:
    """Angles [rad] between directions (N, 3) and one direction (3,)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(d, s), axis=1), d @ s))


def sky_polarization(d_l: FloatArray, s_l: FloatArray, neutral_angle: float) -> FloatArray:
    """(Q + i U) / I over the largest degree of polarization, complex, shape (N,).

    Rayleigh scattering, sin^2 gamma / (1 + cos^2 gamma) across the plane of scattering, and a small vertical part from
    light scattered twice out of the bright band at the horizon, which splits the neutral points (Berry, Dennis & Lee,
    New J. Phys. 6, 2004, 162). It vanishes at the zenith, and so the points close up when the sun is high.
    """
    single = rayleigh(d_l, s_l)
    second = np.sin(neutral_angle) ** 2 / (1.0 + np.cos(neutral_angle) ** 2)
    return np.asarray((single - second * (1.0 - d_l[:, 2] ** 2)) / (1.0 + second))


def rayleigh(d_l: FloatArray, s_l: FloatArray) -> FloatArray:
    """(Q + i U) / I of light from ``s_l`` (3,) scattered once by small particles, complex, shape (N,)."""
    x = horizontal_axis(d_l)
    y = np.cross(d_l, x)
    across = np.cross(d_l, s_l)  # along the e-vector, |across| = sin gamma
    e = (across * x).sum(axis=1) + 1j * (across * y).sum(axis=1)
    return np.asarray(e * e / (1.0 + (d_l @ s_l) ** 2))
