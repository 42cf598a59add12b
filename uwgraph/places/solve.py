"""The two-view problem as one least-squares problem: points of a plane, points off it, and the aids."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from uwgraph.places.aids import RELIEF, Aids
from uwgraph.places.plane import Geometry, epipolar, inverse_depths, transfer
from uwgraph.places.refine import refine
from uwgraph.places.view import View, blocks
from uwgraph.types import BoolArray, FloatArray

GAUGE: Final = 1e-3
"""1-sigma that stands for 'exactly one' where no length is known."""
TOLD_APART: Final = 20.0
"""Points that the translation moves by more pixels than this show how far they are off the plane."""


@dataclass(frozen=True, eq=False)
class Solved:
    """The refined geometry."""

    geometry: Geometry
    cov: FloatArray
    """Of (small rotation in the axes of b, c, and the plane where there is one), shape (6, 6) or (9, 9)."""
    metric: bool
    """Whether lengths are metres."""
    sigma: float
    """What the points are off by, pixels."""
    aid_cost: float
    """Squared whitened residuals of the aids."""
    off_soundings: float
    """Largest whitened residual of the soundings, sigma; 0 where they tell nothing."""


def solve(g: Geometry, a: View, b: View, on_plane: BoolArray, aids: Aids) -> Solved:
    """Refine a geometry on matches (rows of a and b), those ``on_plane`` with both coordinates, others across c."""
    l_b = a.camera.l_b
    flattest = aids.flattest(a.rays, l_b)
    floor = is_floor(g.plane, aids.floor, flattest)
    scale = aids.scale(g.R, g.c, g.plane if floor else None, l_b)
    metric = scale is not None
    g = g.scaled(_unit(g) if scale is None else scale)
    relief = max(RELIEF, _relief(g, a, b))
    size = 6 if g.plane is None else 9
    order = np.argsort(~on_plane, kind="stable")
    planar, count = int(on_plane.sum()), len(order)
    plane_a, plane_b = a.select(order[:planar]), b.select(order[:planar])
    off_a, off_b = a.select(order[planar:]), b.select(order[planar:])

    def points(at: Geometry) -> tuple[FloatArray, FloatArray]:
        r, J = np.zeros((count, 2)), np.zeros((count, 2, size))
        if planar:
            r[:planar], J[:planar] = transfer(at, plane_a, plane_b)
        r[planar:, 0], J[planar:, 0, :6] = epipolar(at, off_a, off_b)
        return r, J

    def known(at: Geometry) -> FloatArray:
        rows = [aids.of_rotation(at.R)]
        if floor and at.plane is not None:
            rows.append(aids.of_slope(at.plane))
        if floor and metric and at.plane is not None:
            rows.append(aids.of_soundings(at.R, at.c, at.plane, l_b, relief))
        rows.append(aids.of_length(at.R, at.c, l_b) if metric else np.array([np.log(_unit(at)) / GAUGE]))
        return np.concatenate(rows)

    dims = np.where(np.arange(count) < planar, 2, 1)
    fit = refine(g, points, dims, known, blocks(a.features.uv[order]))
    if floor and not is_floor(fit.geometry.plane, aids.floor, flattest):  # it was taken for one
        return solve(fit.geometry, a, b, on_plane, aids)
    g, off_soundings = fit.geometry, 0.0
    if floor and metric and g.plane is not None:
        off_soundings = float(np.abs(aids.of_soundings(g.R, g.c, g.plane, l_b, relief)).max(initial=0.0))
    return Solved(g, fit.cov, metric, fit.sigma, fit.aid_cost, off_soundings)


def is_floor(plane: FloatArray | None, floor: FloatArray, flattest: float) -> bool:
    """Whether a plane (3,) lies across the direction to the floor up to the angle with that cosine."""
    return plane is not None and float(plane @ floor) > flattest * float(np.linalg.norm(plane))


def _unit(g: Geometry) -> float:
    """One over the length that is one where no scale is known: the plane's distance, or the way of the camera."""
    return float(np.linalg.norm(g.plane)) if g.plane is not None else 1.0 / float(np.linalg.norm(g.c))


def _relief(g: Geometry, a: View, b: View) -> float:
    """How far the points are off the plane, 1-sigma in parts of its distance, as far as their noise lets it be seen."""
    if g.plane is None:
        return 0.0
    rho, pixels = inverse_depths(g, a, b)
    told_apart = rho * pixels > TOLD_APART
    if told_apart.sum() < 8:
        return 0.0
    off = np.abs(a.rays[told_apart] @ g.plane / rho[told_apart] - 1.0)
    return 1.5 * float(np.median(off))
