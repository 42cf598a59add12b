"""The wind-roughened sea surface: a sum of many travelling waves, and swell.

Heights eta are metres upwards, slopes their gradient to the north and to the east; time is in seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.types import FloatArray

GRAVITY: Final = 9.81
_SURFACE_TENSION: Final = 7.3e-5  # over density, m^3/s^2
_SHORTEST_M: Final = 0.02
_SPREAD: Final = 5
"""Swell is this many waves, a little apart in period and direction, so that it comes in groups."""


@dataclass(frozen=True, eq=False)
class Sea:
    """Waves eta = sum a_j cos(k_j . (x, y) - omega_j t + phase_j)."""

    k: FloatArray
    """Wave vectors (north, east), shape (K, 2), rad/m."""
    amplitude: FloatArray
    """Shape (K,), m."""
    phase: FloatArray
    """Shape (K,), rad."""

    @classmethod
    def draw(
        cls,
        rng: np.random.Generator,
        wind: float,
        wind_from: float = 0.0,
        swell_height: float = 0.0,
        swell_period: float = 8.0,
        swell_from: float = 0.0,
        waves: int = 160,
    ) -> Sea:
        """A sea under ``wind`` [m/s] from ``wind_from`` [rad], with swell of significant height [m] and period [s].

        The slope variances are Cox & Munk's (J. Opt. Soc. Am. 44, 838, 1954), clean surface, spread evenly over the
        logarithm of the wavelength from the peak of a grown sea to 2 cm (the saturation range of Phillips, 1958).
        """
        k_wind, a_wind = _wind_waves(rng, wind, wind_from, waves)
        k_swell, a_swell = _swell(rng, swell_height, swell_period, swell_from)
        k, amplitude = np.concatenate([k_wind, k_swell]), np.concatenate([a_wind, a_swell])
        kept = amplitude > 0.0
        return cls(k[kept], amplitude[kept], rng.uniform(0.0, 2.0 * np.pi, kept.sum()))

    @property
    def omega(self) -> FloatArray:
        """Angular frequencies in deep water, with surface tension, shape (K,), rad/s."""
        k = np.linalg.norm(self.k, axis=1)
        return np.asarray(np.sqrt(GRAVITY * k + _SURFACE_TENSION * k**3))

    def height(self, xy: FloatArray, t: float) -> FloatArray:
        """eta, shape (N,), at places (N, 2) (north, east) [m]."""
        return self.at(np.zeros(2), t).height(xy)

    def slope(self, xy: FloatArray, t: float) -> FloatArray:
        """d eta / d (north, east), shape (N, 2)."""
        return self.at(np.zeros(2), t).slope(xy)

    def at(self, place: FloatArray, t: float) -> Patch:
        """The surface around ``place`` [m] at one moment, for coordinates relative to it."""
        phase = np.mod(self.k @ place - self.omega * t + self.phase, 2.0 * np.pi)
        return Patch(*(x.astype(np.float32) for x in (self.k, self.amplitude, phase)))


@dataclass(frozen=True, eq=False)
class Patch:
    """A frozen piece of sea in single precision, which kilometres of travel would not leave exact."""

    k: NDArray[np.float32]
    amplitude: NDArray[np.float32]
    phase: NDArray[np.float32]

    def height(self, xy: FloatArray) -> FloatArray:
        """eta, shape (N,), at places (N, 2) relative to the patch's own."""
        return np.asarray(np.cos(self._phases(xy)) @ self.amplitude, dtype=np.float64)

    def slope(self, xy: FloatArray) -> FloatArray:
        """Shape (N, 2)."""
        return np.asarray(np.sin(self._phases(xy)) @ (-self.amplitude[:, None] * self.k), dtype=np.float64)

    def long(self, wavelength: float) -> Patch:
        """Only the waves longer than ``wavelength`` [m]."""
        kept = np.linalg.norm(self.k, axis=1) < 2.0 * np.pi / wavelength
        return Patch(self.k[kept], self.amplitude[kept], self.phase[kept])

    def _phases(self, xy: FloatArray) -> NDArray[np.float32]:
        phases: NDArray[np.float32] = xy.astype(np.float32) @ self.k.T
        phases += self.phase
        return phases


def cox_munk(wind: float) -> tuple[float, float]:
    """Slope variances along and across the wind, clean surface; the offset fades out below 1 m/s."""
    return 0.00316 * wind, 0.003 * min(wind, 1.0) + 0.00192 * wind


def _wind_waves(rng: np.random.Generator, wind: float, wind_from: float, waves: int) -> tuple[FloatArray, FloatArray]:
    if wind <= 0.0:
        return np.zeros((0, 2)), np.zeros(0)
    k_peak = GRAVITY * (0.88 / wind) ** 2  # Pierson & Moskowitz
    k_last = 2.0 * np.pi / _SHORTEST_M
    stratum = (np.arange(waves) + rng.uniform(0.0, 1.0, waves)) / waves
    k = min(k_peak, 0.2 * k_last) ** (1.0 - stratum) * k_last**stratum
    off_wind = np.pi * (rng.permutation(waves) + 0.5) / waves - np.pi / 2.0
    slope_variance = _with_moments(off_wind, *cox_munk(wind))
    amplitude = np.sqrt(2.0 * slope_variance) / k
    return k[:, None] * _toward(wind_from + np.pi + off_wind), amplitude


def _with_moments(off_wind: FloatArray, along: float, across: float) -> FloatArray:
    """Variances, one for each direction, whose projections along and across the wind add up to those asked for."""
    basis = np.stack([np.cos(off_wind) ** 2, np.sin(off_wind) ** 2])
    variance: FloatArray = np.linalg.solve(basis @ basis.T, [along, across]) @ basis
    return variance


def _swell(rng: np.random.Generator, height: float, period: float, swell_from: float) -> tuple[FloatArray, FloatArray]:
    """Amplitudes with m_0 = sum a^2 / 2 = (height / 4)^2."""
    periods = period * (1.0 + 0.08 * np.linspace(-1.0, 1.0, _SPREAD))
    toward = swell_from + np.pi + np.radians(10.0) * rng.uniform(-1.0, 1.0, _SPREAD)
    k = (2.0 * np.pi / periods) ** 2 / GRAVITY
    return k[:, None] * _toward(toward), np.full(_SPREAD, height / 4.0 * np.sqrt(2.0 / _SPREAD))


def _toward(azimuth: FloatArray) -> FloatArray:
    return np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
