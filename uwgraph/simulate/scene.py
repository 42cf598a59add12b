"""The settings of a simulated view of the sky, and the sky, sea and water that they describe."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from uwgraph.dive.rig import Finite, NonNegative, Positive, Settings
from uwgraph.simulate.cover import Clouds, Clutter, Occluder, Shape
from uwgraph.simulate.noise import Noise
from uwgraph.simulate.sea import Sea
from uwgraph.simulate.sky import CIE_SKIES, Layer, Sky
from uwgraph.simulate.water import Water
from uwgraph.types import FloatArray

Share = Annotated[float, Field(ge=0.0, le=1.0)]


class OccluderSettings(Settings):
    """One body before the sky."""

    shape: Shape = "hull"
    share: Share = 0.3
    """Of the sky up to 75 degrees from the zenith."""
    brightness: NonNegative = 0.2
    clutter: Clutter = "none"
    dop: Share = 0.5
    """Degree of polarization of the clutter."""


class Scene(Settings):
    """The light of a place; radiance is in units of the clear zenith's."""

    sky: Annotated[int, Field(ge=1, le=15)] = 12
    """CIE type: 1 to 6 overcast, 7 to 10 partly cloudy, 11 to 15 clear."""
    dop_max: Share = 0.75
    neutral_deg: Annotated[float, Field(ge=0.0, le=40.0)] = 15.0
    """Neutral points from sun and antisun, were the sun on the horizon."""
    sun: NonNegative = 20.0
    """Irradiance of the direct beam; 0 for an overcast sky, which then should not be polarized either."""
    clouds: Share = 0.0
    cloud_brightness: NonNegative = 2.0
    cloud_size_deg: Positive = 20.0
    occluders: tuple[OccluderSettings, ...] = ()
    wind: NonNegative = 3.0
    """m/s; 0 is a flat sea."""
    wind_from_deg: Finite = 220.0
    swell_height: NonNegative = 0.0
    """Significant height, m."""
    swell_period: Positive = 8.0
    swell_from_deg: Finite = 260.0
    n: Annotated[float, Field(gt=1.0, le=1.5)] = 1.34
    """Refractive index of the water."""
    attenuation: NonNegative = 0.398
    """Beam attenuation c, 1/m (Petzold 1972: clear ocean 0.151, coastal 0.398, harbour 2.19)."""
    albedo: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.55
    """Scattering over attenuation (0.25, 0.55, 0.83 there)."""
    vignetting: Share = 0.3
    """Light lost in the image's corners."""
    exposure_s: NonNegative = 0.005
    samples: Annotated[int, Field(ge=1, le=64)] = 1
    """Rays per pixel, spread over its area and over the exposure."""

    def sky_at(self, s_l: FloatArray, seed: int, sun_radius: float) -> Sky:
        """The sky with the sun in direction ``s_l``; clouds and occluders stay where they are as the sun moves."""
        return Sky(
            s_l=s_l,
            cie=CIE_SKIES[self.sky],
            dop_max=self.dop_max,
            neutral_angle=float(np.radians(self.neutral_deg)),
            sun_irradiance=self.sun,
            sun_radius=sun_radius,
            layers=_layers(self, seed),
        )

    def sea(self, seed: int) -> Sea:
        return _sea(self, seed)

    @property
    def water(self) -> Water:
        scattering = self.albedo * self.attenuation
        return Water(absorption=self.attenuation - scattering, scattering=scattering)


@lru_cache(maxsize=8)
def _layers(scene: Scene, seed: int) -> tuple[Layer, ...]:
    layers: list[Layer] = []
    if scene.clouds > 0.0:
        size = float(np.radians(scene.cloud_size_deg))
        layers.append(Clouds.draw(Noise.of(seed, "clouds").rng, scene.clouds, scene.cloud_brightness, size))
    for number, body in enumerate(scene.occluders):
        rng = Noise.of(seed, f"occluder {number}").rng
        layers.append(Occluder.draw(rng, body.shape, body.share, body.brightness, body.clutter, body.dop))
    return tuple(layers)


@lru_cache(maxsize=8)
def _sea(scene: Scene, seed: int) -> Sea:
    return Sea.draw(
        Noise.of(seed, "sea").rng,
        wind=scene.wind,
        wind_from=float(np.radians(scene.wind_from_deg)),
        swell_height=scene.swell_height,
        swell_period=scene.swell_period,
        swell_from=float(np.radians(scene.swell_from_deg)),
    )
