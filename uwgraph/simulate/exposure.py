"""From Stokes images to the counts of a sensor."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.sensor import Sensor
from uwgraph.types import FloatArray

SONY: Final = (90.0, 45.0, 135.0, 0.0)
"""Polarizer angles [deg] of the 2 x 2 cell, row by row, of Sony's division-of-focal-plane sensors."""


def behind_polarizer(stokes: FloatArray, angle: float) -> FloatArray:
    """Radiance (H, W) behind a polarizer at ``angle`` [rad] from image x towards image y (Malus)."""
    S0, S1, S2 = np.moveaxis(stokes, -1, 0)
    return np.asarray(0.5 * (S0 + S1 * np.cos(2.0 * angle) + S2 * np.sin(2.0 * angle)))


def mosaic(stokes: FloatArray, layout: tuple[float, float, float, float] = SONY) -> FloatArray:
    """Radiance (H, W) behind a mosaic of polarizers, angles of ``layout`` in degrees from image x towards image y."""
    seen = np.empty(stokes.shape[:2])
    for number, angle in enumerate(layout):
        cell = np.s_[number // 2 :: 2, number % 2 :: 2]
        seen[cell] = behind_polarizer(stokes[cell], float(np.radians(angle)))
    return seen


def auto_scale(
    radiance: FloatArray, white: float, most: float = np.inf, level: float = 0.8, quantile: float = 0.95
) -> float:
    """Counts per unit of radiance, at most ``most``, that bring a quantile of lit pixels to ``level`` of ``white``."""
    lit = radiance[radiance > 0.0]
    return min(level * white / float(np.quantile(lit, quantile)), most) if len(lit) else min(1.0, most)


def expose(
    radiance: FloatArray, sensor: Sensor, scale: float, bits: int, rng: np.random.Generator | None
) -> NDArray[Any]:
    """Counts (H, W), uint8 for up to 8 bits and uint16 above.

    Parameters
    ----------
    radiance : array, shape (H, W)
    sensor : Sensor
        Gain, black level and read noise.
    scale : float
        Counts per unit of radiance.
    bits : int
        Of the converter: counts end at 2^bits - 1.
    rng : Generator or None
        Of shot and read noise; None for an ideal sensor that only rounds.
    """
    electrons = np.maximum(radiance, 0.0) * scale * sensor.gain
    if rng is not None:
        well = 2.0 * 2.0**bits * sensor.gain  # what is far over the range need not be drawn
        electrons = rng.poisson(np.minimum(electrons, well)) + sensor.read_noise * rng.standard_normal(radiance.shape)
    counts = np.rint(sensor.black + electrons / sensor.gain)
    return np.clip(counts, 0.0, 2.0**bits - 1.0).astype(np.uint8 if bits <= 8 else np.uint16)
