"""The ring form: besides the sun's own light there is any light that depends on the zenith angle alone.

A clear sky is f(angle from the sun) h(zenith angle) (CIE S 011), and the surface, the path in the water and a level
lens multiply functions of the zenith angle. On a zenith ring j the gradient then is (f'/f) grad gamma + b_j e_theta
with one unknown b_j, so (m - b_j e_phi) . s = 0 with e_phi = a x e_theta. The b_j are eliminated exactly: a ring enters
by three 3x3 matrices, and no pixel is touched again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from uwgraph.sun.gradient_field import MAX_ZENITH, GradientField
from uwgraph.sun.observation import level_axes
from uwgraph.types import FloatArray

RINGS = 26
STEP_ZENITH, STEP_AZIMUTH = np.radians(3.0), np.radians(4.0)
ROUNDS = 3
"""Of reweighting."""
EXACT = 1e-3
"""An objective below this share of the largest is as good as zero."""


@dataclass(frozen=True, eq=False)
class RingResult:
    """The sun by the ring form."""

    s: FloatArray
    """Unit vector to the sun, in b, shape (3,)."""
    misfit: float
    """Least objective over the objective of no sun at all: 0 where the model is exact, 1 where it says nothing."""
    other: FloatArray
    """The best direction at least 30 degrees away, shape (3,)."""
    contrast: float
    """Objective of ``other`` over that of ``s``, which counts as ``EXACT`` of the largest at least."""
    weight: FloatArray
    """Robust weight of every gradient, shape (N,)."""
    grows: bool
    """Whether the light that the rings do not explain grows towards ``s``."""


@dataclass(frozen=True, eq=False)
class _Rings:
    """Per ring: scatter of the normals, of normals with e_phi, of e_phi, each (RINGS, 6) for products with s s^T."""

    mm: FloatArray
    me: FloatArray
    ee: FloatArray

    def objective(self, ss: FloatArray) -> FloatArray:
        """J of directions given by their squares (K, 6), shape (K,)."""
        me, ee = ss @ self.me.T, ss @ self.ee.T
        return np.asarray((ss @ self.mm.T - me * me / np.maximum(ee, 1e-12)).sum(axis=1))

    def nuisance(self, s: FloatArray) -> FloatArray:
        """b_j of every ring for the sun at s (3,), shape (RINGS,)."""
        ss = _squares(s)
        return np.asarray((self.me @ ss) / np.maximum(self.ee @ ss, 1e-12))


_ROWS, _COLUMNS = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
_TWICE = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])


def _products(x: FloatArray, y: FloatArray) -> FloatArray:
    """Upper triangle of the symmetric part of x y^T, shape (..., 6)."""
    return 0.5 * (x[..., _ROWS] * y[..., _COLUMNS] + x[..., _COLUMNS] * y[..., _ROWS])


def _squares(s: FloatArray) -> FloatArray:
    """What a scatter's upper triangle is multiplied with for s^T M s, shape (..., 6)."""
    return np.asarray(_products(s, s) * _TWICE)


def ring_sun(field: GradientField, up_b: FloatArray, sun_zenith: float | None = None) -> RingResult:
    """Search the sky on a grid, refine, reweight gradients that do not fit, and repeat."""
    axes = level_axes(up_b)
    grid = _grid(sun_zenith) @ axes
    squares = _squares(grid)
    zenith = np.arccos(np.clip(field.a @ up_b, -1.0, 1.0))
    ring = np.minimum((zenith / MAX_ZENITH * RINGS).astype(np.intp), RINGS - 1)
    member = (ring[None, :] == np.arange(RINGS)[:, None]).astype(np.float64)
    e_phi = np.cross(up_b, field.a)
    e_phi /= np.maximum(np.linalg.norm(e_phi, axis=1), 1e-9)[:, None]
    mm = _products(field.m, field.m) - field.noise[:, _ROWS, _COLUMNS]  # the noise's own scatter is taken off
    scatter = np.concatenate([mm, _products(field.m, e_phi), _products(e_phi, e_phi)], axis=1)
    steep = (field.g**2).sum(axis=1)
    weight = 1.0 / (steep + np.median(steep) + 1e-12)  # so that the edges of clouds do not set the start
    along = np.ones(len(ring))
    for _ in range(ROUNDS):
        rings = _Rings(*np.split((member * (weight / along)) @ scatter, 3, axis=1))
        J = rings.objective(squares)
        s = _refined(rings, grid[np.argmin(J)], axes, sun_zenith)
        b = rings.nuisance(s)[ring]
        along = np.maximum(1.0 - (field.a @ s) ** 2, 0.05**2)
        r = (field.m - b[:, None] * e_phi) @ s / np.sqrt(along)
        c2 = (2.0 * 1.4826 * np.median(np.abs(r))) ** 2 + 1e-24
        weight = 1.0 / (1.0 + r * r / c2) ** 2
    least = float(rings.objective(_squares(s)[None])[0])
    far = np.where(grid @ s < np.cos(np.radians(30.0)), J, np.inf)
    e_theta = np.cross(e_phi, field.a)
    return RingResult(
        s=s,
        misfit=max(least, 0.0) / float(J.max()),
        other=grid[np.argmin(far)],
        contrast=float(far.min()) / max(least, EXACT * float(J.max())),
        weight=weight,
        grows=bool((weight * ((field.g - b[:, None] * e_theta) @ s)).sum() > 0.0),
    )


def _refined(rings: _Rings, s: FloatArray, axes: FloatArray, sun_zenith: float | None) -> FloatArray:
    """The least objective near s, by a stencil that shrinks; along the horizon only where the zenith is known."""
    x, y, z = axes @ s
    centre = np.array([np.arccos(np.clip(z, -1.0, 1.0)), np.arctan2(y, x)])
    stencil = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 5)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    step = np.array([STEP_ZENITH, STEP_AZIMUTH])
    if sun_zenith is not None:
        step[0] = 0.0
    for _ in range(8):
        points = centre + step * stencil
        points[:, 0] = np.clip(points[:, 0], 0.01, np.pi / 2.0)
        d = _directions(points) @ axes
        centre = points[np.argmin(rings.objective(_squares(d)))]
        step = step / 2.0
    return np.asarray((_directions(centre[None]) @ axes)[0])


def _directions(points: FloatArray) -> FloatArray:
    """Unit vectors (K, 3) along bow, starboard, up of (zenith angle, azimuth) (K, 2)."""
    zenith, azimuth = points.T
    return np.stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)], axis=1)


@lru_cache(maxsize=8)
def _grid(sun_zenith: float | None) -> FloatArray:
    """Directions over the upper half of the sphere, or round the circle of a known zenith angle, shape (K, 3)."""
    known = sun_zenith is not None
    zenith = np.array([sun_zenith]) if known else np.arange(STEP_ZENITH, np.pi / 2.0 + 1e-9, STEP_ZENITH)
    azimuth = np.arange(0.0, 2.0 * np.pi, STEP_AZIMUTH)
    return _directions(np.stack(np.meshgrid(zenith, azimuth, indexing="ij"), axis=-1).reshape(-1, 2))
