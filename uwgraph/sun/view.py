"""The circumstances of one image, and the sky that each of its pixels sees."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from uwgraph.camera.model import Camera
from uwgraph.sun.surface import to_air
from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class View:
    """Where a camera was, which way was up, and what the almanac says."""

    camera: Camera
    up_b: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    """Unit vector to the zenith in the body, shape (3,)."""
    n: float = 1.0
    """Refractive index of what the camera sits in: 1 in air, 1.33 to 1.35 in water."""
    tilt_sigma: float = 0.0
    """1-sigma of roll and of pitch behind ``up_b``, rad."""
    sun_zenith: float | None = None
    """Zenith angle of the apparent sun from time and place, rad; None where they are not known."""
    t_ns: int = 0
    """Nanoseconds UTC; 0 when not known."""

    @property
    def in_water(self) -> bool:
        return self.n > 1.0

    def binned(self, factor: int) -> View:
        """The view through pixels that are means of ``factor`` x ``factor``."""
        return replace(self, camera=_binned(self.camera, factor))

    def tilted(self, up_b: FloatArray) -> View:
        return replace(self, up_b=up_b)

    def body_rays(self) -> tuple[FloatArray, FloatArray]:
        """Rays outside the housing in b, (N, 3), and their derivative by the pixel, (N, 3, 2); cached."""
        return _body_rays(self.camera, self.n)

    def sky_rays(self) -> FloatArray:
        """Directions in the sky, in b, that the pixels see, shape (N, 3), row by row; NaN outside the window."""
        return self.above(self.body_rays()[0])

    def above(self, w_b: FloatArray) -> FloatArray:
        """Directions in the sky, in b, of rays (N, 3) outside the housing; NaN outside the window."""
        return to_air(w_b, self.up_b, self.n) if self.in_water else w_b


@lru_cache(maxsize=16)
def _binned(camera: Camera, factor: int) -> Camera:
    return camera.binned(factor) if factor > 1 else camera


@lru_cache(maxsize=16)
def _body_rays(camera: Camera, n: float) -> tuple[FloatArray, FloatArray]:
    return camera.outside(camera.pixels(), n)
