"""Clouds, and bodies that hide the sky: canopy, hulls, walls, sectors, dark or bright, polarized wrongly if asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from uwgraph.simulate.fields import SphereField, level_for_share
from uwgraph.simulate.sky import angle_between, rayleigh
from uwgraph.types import FloatArray

Shape = Literal["sector", "hull", "wall", "canopy"]
Clutter = Literal["none", "random", "false_sun"]
SKY_IN_VIEW: Final = float(np.radians(75.0))
"""Shares are of the sky up to this zenith angle."""


@dataclass(frozen=True, eq=False)
class Clouds:
    """Broken cloud with soft edges: it hides the blue sky, is lit by the sun from behind, and hardly polarizes."""

    cover: SphereField
    level: float
    """The field's value at a cloud's edge."""
    texture: SphereField
    brightness: float
    """Radiance over that of the clear zenith."""
    edge: float = 0.25
    """Softness, in standard deviations of the field."""
    kept: float = 0.1
    """Share of the degree of polarization that light keeps through cloud."""

    @classmethod
    def draw(cls, rng: np.random.Generator, share: float, brightness: float, size: float) -> Clouds:
        """Clouds of ``size`` [rad] over a ``share`` of the sky."""
        cover = SphereField.draw(rng, size)
        return cls(cover, level_for_share(cover, share, SKY_IN_VIEW), SphereField.draw(rng, 0.5 * size), brightness)

    def over(self, stokes: FloatArray, d_l: FloatArray, s_l: FloatArray) -> FloatArray:
        opacity = 1.0 / (1.0 + np.exp(np.clip((self.level - self.cover(d_l)) / self.edge * 4.0, -50.0, 50.0)))
        silver_lining = 1.0 + 1.5 * np.exp(-angle_between(d_l, s_l) / np.radians(15.0))
        own = self.brightness * silver_lining * np.exp(0.2 * self.texture(d_l))
        clear_dop = stokes[:, 1:] / np.maximum(stokes[:, :1], 1e-12)
        through = stokes * (1.0 - opacity)[:, None] ** 2
        added = np.column_stack([own, own[:, None] * self.kept * clear_dop]) * opacity[:, None]
        return np.asarray(through + added)


@dataclass(frozen=True, eq=False)
class Occluder:
    """An opaque body before the sky, where ``depth(d) > level``."""

    shape: Shape
    toward: FloatArray
    """Unit vector in l to its middle, shape (3,)."""
    level: float
    outline: SphereField
    texture: SphereField
    brightness: float
    """Mean radiance over that of the clear zenith."""
    clutter: Clutter = "none"
    dop: float = 0.0
    false_s_l: FloatArray | None = None
    """The direction from which the clutter ``false_sun`` pretends to be lit."""
    wrong: tuple[SphereField, SphereField] | None = None
    """Fields whose two values are the random clutter's Q and U."""

    @classmethod
    def draw(
        cls, rng: np.random.Generator, shape: Shape, share: float, brightness: float, clutter: Clutter, dop: float
    ) -> Occluder:
        """A body in a random direction over exactly a ``share`` of the sky in view."""
        azimuth, false_azimuth = rng.uniform(0.0, 2.0 * np.pi, 2)
        false_zenith = rng.uniform(0.5, 1.2)
        outline, texture, q, u = (SphereField.draw(rng, size) for size in (0.4, 0.2, 0.6, 0.6))
        toward = _direction(np.pi / 2.0 if shape == "wall" else 0.7, azimuth)
        level = level_for_share(lambda d: _depth(shape, toward, outline, d), share, SKY_IN_VIEW)
        false_s_l = _direction(false_zenith, false_azimuth)
        return cls(shape, toward, level, outline, texture, brightness, clutter, dop, false_s_l, (q, u))

    def over(self, stokes: FloatArray, d_l: FloatArray, s_l: FloatArray) -> FloatArray:
        hidden = _depth(self.shape, self.toward, self.outline, d_l) > self.level
        d = d_l[hidden]
        radiance = self.brightness * np.exp(0.3 * self.texture(d))
        polarization = self._polarization(d)
        seen = stokes.copy()
        seen[hidden] = np.column_stack([radiance, radiance * polarization.real, radiance * polarization.imag])
        return seen

    def _polarization(self, d: FloatArray) -> FloatArray:
        """(Q + i U) / I, complex."""
        if self.clutter == "false_sun" and self.false_s_l is not None:
            return self.dop * rayleigh(d, self.false_s_l)
        if self.clutter == "random" and self.wrong is not None:
            q, u = (field(d) for field in self.wrong)
            return np.asarray(self.dop * (q + 1j * u) / np.maximum(np.hypot(q, u), 1e-9))
        return np.zeros(len(d), dtype=complex)


def _direction(zenith: float, azimuth: float) -> FloatArray:
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), -np.cos(zenith)])


def _depth(shape: Shape, toward: FloatArray, outline: SphereField, d: FloatArray) -> FloatArray:
    """How far inside the body a direction is, in units of its own; its level sets are the possible outlines."""
    if shape == "sector":
        along, across = d[:, :2] @ toward[:2], d[:, 0] * toward[1] - d[:, 1] * toward[0]
        return np.asarray(-np.abs(np.arctan2(across, along)))
    if shape == "canopy":
        return np.asarray(outline(d) + 1.5 * (1.0 + d[:, 2]))
    return np.asarray(d @ toward + (0.05 * outline(d) if shape == "hull" else 0.0))
