"""Smooth random fields on the sphere of directions, and what of the sky they cover."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class SphereField:
    """A Gaussian random field of mean 0 and variance 1: plane waves in space, taken on the unit sphere.

    Random Fourier features (Rahimi & Recht, NIPS 2007): homogeneous and isotropic, without grid or pole.
    """

    k: FloatArray
    """Wave vectors, shape (K, 3), rad per unit."""
    phase: FloatArray
    """Shape (K,), rad."""
    weight: FloatArray
    """Shape (K,)."""

    @classmethod
    def draw(cls, rng: np.random.Generator, size: float, octaves: int = 4, waves: int = 16) -> SphereField:
        """A field whose largest features are ``size`` [rad]; each octave has half the size and a third the variance."""
        octave = np.repeat(np.arange(octaves), waves)
        direction = rng.standard_normal((len(octave), 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        wavelength = 2.0 * size * 0.5**octave * rng.uniform(0.7, 1.4, len(octave))
        variance = 3.0**-octave
        return cls(
            k=direction * (2.0 * np.pi / wavelength)[:, None],
            phase=rng.uniform(0.0, 2.0 * np.pi, len(octave)),
            weight=np.sqrt(2.0 * variance / variance.sum()),
        )

    def __call__(self, d: FloatArray) -> FloatArray:
        """Values, shape (N,), in the directions ``d``, (N, 3)."""
        phases = (d @ self.k.T + self.phase).astype(np.float32)
        return np.asarray(np.cos(phases, out=phases) @ self.weight.astype(np.float32), dtype=np.float64)


def cap_directions(max_zenith: float, count: int) -> FloatArray:
    """Directions in l, shape (count, 3), even over the sky up to ``max_zenith`` [rad] from the zenith (Fibonacci)."""
    i = np.arange(count) + 0.5
    up = 1.0 - (1.0 - np.cos(max_zenith)) * i / count
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * i
    level = np.sqrt(1.0 - up * up)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), -up], axis=1)


def level_for_share(field: Callable[[FloatArray], FloatArray], share: float, max_zenith: float) -> float:
    """The value that ``field`` exceeds on a ``share`` of the sky up to ``max_zenith`` [rad]."""
    if share >= 1.0:
        return -np.inf
    return float(np.quantile(field(cap_directions(max_zenith, 10_000)), 1.0 - share)) if share > 0.0 else np.inf
