"""Seeded noise: one independent generator for each sensor, so that adding one sensor leaves the others as they were."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class Noise:
    """A source of Gaussian noise that can be silenced (for noise-free dives); ``rng`` itself never is."""

    rng: np.random.Generator
    silent: bool = False

    @classmethod
    def of(cls, seed: int, sensor: str, silent: bool = False) -> Noise:
        """The noise that belongs to a seed and a sensor's name."""
        return cls(np.random.default_rng([seed, zlib.crc32(sensor.encode())]), silent)

    def normal(self, sigma: float, shape: tuple[int, ...]) -> FloatArray:
        """Zero-mean Gaussian noise of 1-sigma ``sigma``."""
        return np.zeros(shape) if self.silent else sigma * self.rng.standard_normal(shape)
