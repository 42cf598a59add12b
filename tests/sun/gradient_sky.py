"""A small clear sky to look at: CIE S 011 type 12, hidden sectors, a flat surface, shot noise."""

from __future__ import annotations

import numpy as np

from uwgraph.camera.model import Camera
from uwgraph.camera.sensor import Sensor
from uwgraph.sun.observation import azimuth_in_level, level_axes
from uwgraph.sun.surface import radiance_factor
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

SENSOR = Sensor(white=4000.0, gain=2.4, read_noise=3.0)


def fisheye(view_deg: float = 160.0, pixels: int = 360, R_bs: FloatArray | None = None) -> Camera:
    f, c = pixels / np.radians(view_deg), (pixels - 1) / 2.0
    camera = Camera("fisheye", (f, f), (c, c), (pixels, pixels))
    return camera if R_bs is None else Camera("fisheye", (f, f), (c, c), (pixels, pixels), R_bs=R_bs)


def sun_at(azimuth: float, zenith: float, up_b: FloatArray) -> FloatArray:
    bow, starboard, up = level_axes(up_b)
    horizontal = np.cos(azimuth) * bow + np.sin(azimuth) * starboard
    return np.asarray(np.sin(zenith) * horizontal + np.cos(zenith) * up)


def sky_image(
    view: View,
    s_b: FloatArray,
    *,
    hidden: float = 0.0,
    hidden_from: float = 0.0,
    gradation: float = 1.0,
    level: float = 3000.0,
    rng: np.random.Generator | None = None,
) -> FloatArray:
    """Counts (H, W); ``hidden`` is the share of the azimuth circle, clockwise from ``hidden_from``, that is dark.

    ``gradation`` 0 leaves a sky that depends on the angle from the sun alone. No ``rng``, no noise.
    """
    a = view.sky_rays()
    seen = np.nan_to_num(a @ view.up_b, nan=-1.0) > 0.02
    cos_z, gamma = a[seen] @ view.up_b, np.arccos(np.clip(a[seen] @ s_b, -1.0, 1.0))
    L = 1.0 + 10.0 * (np.exp(-3.0 * gamma) - np.exp(-1.5 * np.pi)) + 0.45 * np.cos(gamma) ** 2
    L = L * (1.0 - gradation * np.exp(-0.32 / cos_z))
    if view.in_water:
        L = L * radiance_factor(cos_z, view.n)
    L = L * level / np.quantile(L, 0.99)
    L[np.mod(azimuth_in_level(a[seen], view.up_b) - hidden_from, 2.0 * np.pi) < 2.0 * np.pi * hidden] = 0.0
    counts = np.zeros(len(a))
    counts[seen] = L
    if rng is not None:
        counts = rng.poisson(counts * SENSOR.gain) / SENSOR.gain
        counts = np.rint(counts + rng.standard_normal(len(counts)) * SENSOR.read_noise / SENSOR.gain)
    return np.asarray(counts.reshape(view.camera.size[::-1]))


def azimuth_error_deg(s_b: FloatArray, truth_b: FloatArray, up_b: FloatArray) -> float:
    d = float(azimuth_in_level(s_b, up_b) - azimuth_in_level(truth_b, up_b))
    return float(np.degrees((d + np.pi) % (2.0 * np.pi) - np.pi))
