"""The noise and the range of an image sensor, in counts of the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uwgraph.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Sensor:
    """Linear sensor: counts = black + electrons / gain, clipped at ``white``."""

    white: float
    """Counts from which on a pixel counts as saturated."""
    black: float = 0.0
    """Counts of no light."""
    gain: float = 1.0
    """Electrons per count."""
    read_noise: float = 3.0
    """Electrons, 1-sigma."""

    @classmethod
    def of(cls, image: NDArray[Any]) -> Sensor:
        """A plain guess for an image: white at 98 % of the type's range, a full well of 10 000 electrons.

        12 bits in a 16-bit file are recognised by their maximum.
        """
        full = 1.0
        if np.issubdtype(image.dtype, np.integer):
            full = float(np.iinfo(image.dtype).max)
            if image.dtype == np.uint16 and image.size and int(image.max()) <= 4095:
                full = 4095.0
        return cls(white=0.98 * full, gain=10_000.0 / full)

    def variance(self, counts: FloatArray) -> FloatArray:
        """Variance of one pixel, counts^2: shot noise, read noise and rounding."""
        electrons = np.maximum(counts - self.black, 0.0) * self.gain
        rounding = 1.0 / 12.0 if self.white > 1.0 else 0.0
        variance: FloatArray = (electrons + self.read_noise**2) / self.gain**2 + rounding
        return variance

    def saturated(self, counts: NDArray[Any]) -> BoolArray:
        return np.asarray(counts >= self.white)
