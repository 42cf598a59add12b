"""Stokes vectors (I, Q, U), shape (N, 3), about an axis across the view ray: turning the axis, and passing surfaces."""

from __future__ import annotations

import numpy as np

from uwgraph.types import FloatArray


def about(stokes: FloatArray, d: FloatArray, old: FloatArray, new: FloatArray) -> FloatArray:
    """The same light about another axis; all (N, 3), ``old`` and ``new`` unit and across ``d``."""
    return turned(stokes, (old * new).sum(axis=1) + 1j * (np.cross(d, old) * new).sum(axis=1))


def turned(stokes: FloatArray, axis: FloatArray) -> FloatArray:
    """About an axis at the angle of the complex unit number ``axis`` (N,) from the old one, towards d x old."""
    linear = (stokes[:, 1] + 1j * stokes[:, 2]) * np.conj(axis) ** 2
    return np.column_stack([stokes[:, 0], linear.real, linear.imag])


def transmitted(stokes: FloatArray, cos_in: FloatArray, cos_out: FloatArray, n: float) -> FloatArray:
    """Radiance behind a surface, about the axis parallel to it, of light entering a medium ``n`` times as dense.

    Fresnel's amplitudes (Born & Wolf, 1.5.2), the flux through the surface, and the n^2 of the narrowed beam.
    """
    t_s = 2.0 * cos_in / (cos_in + n * cos_out)
    t_p = 2.0 * cos_in / (n * cos_in + cos_out)
    A, B, C = (t_s**2 + t_p**2) / 2.0, (t_s**2 - t_p**2) / 2.0, t_s * t_p
    S0, S1, S2 = stokes.T
    power = n**3 * cos_out / cos_in
    behind: FloatArray = np.column_stack([A * S0 + B * S1, B * S0 + A * S1, C * S2]) * power[:, None]
    return behind
