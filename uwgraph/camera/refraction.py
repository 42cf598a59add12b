"""Refraction of rays at a plane surface: the port of a housing, the surface of the sea."""

from __future__ import annotations

import numpy as np

from uwgraph.types import FloatArray


def refract(r: FloatArray, axis: FloatArray, n: float) -> FloatArray:
    """Rays (N, 3) behind a surface with normal ``axis`` (unit, r.axis > 0), entering a medium ``n`` times as dense.

    ``n`` > 1 bends towards the normal (air to water), ``n`` < 1 away from it; NaN where light is totally reflected.
    Vector form of Snell's law (Glassner, An Introduction to Ray Tracing, 1989).
    """
    c = r @ axis
    q2 = 1.0 - (1.0 - c * c) / (n * n)
    q = np.sqrt(np.where(q2 >= 0.0, q2, np.nan))
    bent: FloatArray = r / n + (q - c / n)[..., None] * axis
    return bent


def refract_jacobian(r: FloatArray, axis: FloatArray, n: float) -> FloatArray:
    """Derivative of :func:`refract` with respect to r, shape (N, 3, 3), for changes tangent to r."""
    c = r @ axis
    q2 = 1.0 - (1.0 - c * c) / (n * n)
    q = np.sqrt(np.where(q2 > 0.0, q2, np.nan))
    J: FloatArray = np.eye(3) / n + (c / (n * n * q) - 1.0 / n)[..., None, None] * np.outer(axis, axis)
    return J
