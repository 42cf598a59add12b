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


def refractive_index(salinity: float = 35.0, temperature_c: float = 15.0, wavelength_nm: float = 530.0) -> float:
    """Refractive index of sea water against air, 400 to 700 nm (Quan & Fry, Appl. Opt. 34, 3477, 1995, eq. 3).

    Parameters
    ----------
    salinity : float
        Practical salinity, 0 to 40.
    temperature_c : float
        Degrees Celsius, 0 to 30.
    wavelength_nm : float
        In vacuum, nanometres.
    """
    S, T, lam = salinity, temperature_c, wavelength_nm
    return (
        1.31405
        + (1.779e-4 - 1.05e-6 * T + 1.6e-8 * T * T) * S
        - 2.02e-6 * T * T
        + (15.868 + 0.01155 * S - 0.00423 * T) / lam
        - 4382.0 / lam**2
        + 1.1455e6 / lam**3
    )
