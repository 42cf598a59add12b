"""From numbers to the measurement models of :mod:`factors`: the same for a graph and for a filter."""

from __future__ import annotations

import factors
from uwgraph.frames import rph_from_matrix
from uwgraph.graph.place import Place
from uwgraph.types import FloatArray


def depth_models(depth: FloatArray, sigma: FloatArray, place: Place, l_b: FloatArray) -> list[factors.Depth]:
    """Depths of the sensor, shape (K,), m."""
    each = zip(depth.tolist(), sigma.tolist(), place.R_local, place.p_n, place.depth.tolist(), strict=True)
    return [factors.Depth(d, s, R[:, 2], p, at, l_b) for d, s, R, p, at in each]


def fix_models(p_n: FloatArray, cov: FloatArray, R_local: FloatArray, l_b: FloatArray) -> list[factors.PositionFix]:
    """Positions of the antenna, shape (K, 3), with covariances along local north, east, down."""
    return [factors.PositionFix(p, c, l_b, R) for p, c, R in zip(p_n, cov, R_local, strict=True)]


def heading_models(heading: FloatArray, sigma: FloatArray, place: Place) -> list[factors.Heading]:
    """True headings, shape (K,), rad."""
    pitch = rph_from_matrix(place.R_nb)[:, 1].tolist()
    each = zip(heading.tolist(), sigma.tolist(), pitch, place.R_local, strict=True)
    return [factors.Heading(h, s, t, R) for h, s, t, R in each]


def sun_models(information_b: FloatArray, s_n: FloatArray) -> list[factors.SunScatter]:
    """Rank-2 informations in the body, shape (K, 3, 3), of suns in n, shape (K, 3)."""
    return [factors.SunScatter(L, s) for L, s in zip(information_b, s_n, strict=True)]
