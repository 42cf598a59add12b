"""Light under water: lamps that move with the vehicle, daylight, and what the water takes and adds.

The image formation of Jaffe (IEEE J. Ocean. Eng. 15, 1990) with point lamps: light that the floor reflects, light
scattered back by the water, and a halo of light scattered forward. All places are in body axes from the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from uwgraph.simulate.floor_model import Lamp, Murk
from uwgraph.simulate.floor_noise import Single
from uwgraph.types import FloatArray

_STEPS: Final = 12
_NEAREST_M: Final = 0.05
_HALO_PX: Final = 12.0


@dataclass(frozen=True, eq=False)
class Light:
    """Lamps and water for one camera; colours in the order blue, green, red."""

    lamps: Sequence[Lamp]
    aside: Single
    """From the camera that the lamps' places refer to, shape (3,), m."""
    attenuation: Single
    scattering: Single
    daylight: Single
    """Irradiance at the depth of the floor."""
    forward: float

    @classmethod
    def at(cls, lamps: Sequence[Lamp], water: Murk, depth: float, aside: FloatArray | None = None) -> Light:
        """That of a place ``depth`` [m] below the surface, for a camera that sits ``aside`` [m, b] of the first one."""
        bgr = slice(None, None, -1)
        diffuse = np.array(water.diffuse_attenuation[bgr], dtype=np.float32)
        return cls(
            lamps,
            aside=np.zeros(3, np.float32) if aside is None else aside.astype(np.float32),
            attenuation=np.array(water.attenuation[bgr], dtype=np.float32) * np.float32(water.turbidity),
            scattering=np.array(water.scattering[bgr], dtype=np.float32) * np.float32(water.turbidity),
            daylight=(water.daylight * np.exp(-diffuse * max(depth, 0.0))).astype(np.float32),
            forward=water.forward,
        )

    def of_lamp(self, lamp: Lamp, X: Single, normal: Single | None = None) -> tuple[Single, Single]:
        """Irradiance by a lamp in clear water, and the way from it [m], at places (3, ...) of unit ``normal``.

        Without a normal, that of a surface across the light.
        """
        place, towards = np.array(lamp.place, np.float32) - self.aside, np.array(lamp.towards, np.float32)
        towards /= np.linalg.norm(towards)
        x, y, z = (X[k] - place[k] for k in range(3))
        way = np.maximum(np.sqrt(x * x + y * y + z * z), np.float32(_NEAREST_M))
        beam = np.maximum(x * towards[0] + y * towards[1] + z * towards[2], np.float32(0.0)) / way
        light = np.float32(lamp.power) * beam**lamp.beam / (way * way)
        if normal is not None:
            light *= np.maximum(-(x * normal[0] + y * normal[1] + z * normal[2]), np.float32(0.0)) / way
        return light, way

    def reflected(self, albedo: Single, X: Single, r: Single, normal: Single) -> Single:
        """Radiance (H, W, 3) that arrives from a floor of ``albedo`` (H, W, 3) at X (3, H, W), ``r`` [m] away."""
        lit = [self.of_lamp(lamp, X, normal) for lamp in self.lamps]
        radiance = np.empty_like(albedo)
        for k, c in enumerate(self.attenuation):
            E = self.daylight[k] * np.exp(-c * r)
            for light, way in lit:
                E += light * np.exp(-c * (way + r))
            radiance[..., k] = albedo[..., k] * E
        return radiance * np.float32(1.0 / np.pi)

    def scattered(self, d: Single, r: Single) -> Single:
        """Radiance (h, w, 3) from the water along rays ``d`` (3, h, w) that end after ``r`` [m]: midpoint rule."""
        total = np.zeros((*r.shape, 3), dtype=np.float32)
        length = r / np.float32(_STEPS)
        for step in range(_STEPS):
            s = length * np.float32(step + 0.5)
            lit = [self.of_lamp(lamp, d * s) for lamp in self.lamps]
            for k, c in enumerate(self.attenuation):
                E = self.daylight[k] * np.exp(-c * s)
                for light, way in lit:
                    E += light * np.exp(-c * (way + s))
                total[..., k] += self.scattering[k] * E * length
        return total

    def halo(self, radiance: Single, r: float) -> Single:
        """With part of the light scattered forward on a way of ``r`` [m]."""
        share = 1.0 - np.exp(-self.forward * float(self.attenuation.mean()) * r)
        if share < 1e-3:
            return radiance
        size = (radiance.shape[1], radiance.shape[0])
        coarse = cv2.resize(radiance, (max(size[0] // 4, 1), max(size[1] // 4, 1)), interpolation=cv2.INTER_AREA)
        wide = cv2.resize(cv2.GaussianBlur(coarse, (0, 0), _HALO_PX / 4.0), size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(cv2.addWeighted(radiance, 1.0 - share, wide, share, 0.0), dtype=np.float32)
