"""Light through the flat surface of the water: vector Snell, Fresnel as Mueller matrix, the window, the path.

Everything is free of coordinates: ``up`` is the unit vector to the zenith in whatever frame the rays are given. A view
ray points from the camera outwards, so light travels against it. ``n`` is the refractive index of the water against
air (1.33 to 1.35).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from uwgraph.camera.refraction import refract
from uwgraph.types import BoolArray, FloatArray


def to_air(w: FloatArray, up: FloatArray, n: float) -> FloatArray:
    """View rays above a level surface, of view rays ``w`` (N, 3) in water; NaN outside Snell's window."""
    a = refract(w, up, 1.0 / n)
    a[w @ up <= 0.0] = np.nan
    return a


def to_water(a: FloatArray, up: FloatArray, n: float) -> FloatArray:
    """View rays in water of view rays ``a`` (N, 3) in air above a level surface."""
    return refract(a, up, n)


def window_half_angle(n: float) -> float:
    """Angle from the zenith [rad] of the edge of Snell's window, under water."""
    return float(np.arcsin(1.0 / n))


def in_window(w: FloatArray, up: FloatArray, n: float, max_zenith: float) -> BoolArray:
    """Which rays ``w`` (N, 3) in water see the sky at most ``max_zenith`` [rad, in air] from the zenith."""
    inside: BoolArray = w @ up > np.sqrt(1.0 - (np.sin(max_zenith) / n) ** 2)
    return inside


def fresnel_amplitudes(cos_air: ArrayLike, n: float) -> tuple[FloatArray, FloatArray]:
    """Amplitude transmission t_s, t_p from air into water at the angle of incidence in air (Born & Wolf, 1.5.2)."""
    c = np.asarray(cos_air, dtype=np.float64)
    c_w = np.sqrt(1.0 - (1.0 - c * c) / (n * n))
    return 2.0 * c / (c + n * c_w), 2.0 * c / (n * c + c_w)


def transmittance(cos_air: ArrayLike, n: float) -> FloatArray:
    """Share of unpolarized power that enters the water, 1 - (R_s + R_p) / 2."""
    c = np.asarray(cos_air, dtype=np.float64)
    c_w = np.sqrt(1.0 - (1.0 - c * c) / (n * n))
    R_s = ((c - n * c_w) / (c + n * c_w)) ** 2
    R_p = ((n * c - c_w) / (n * c + c_w)) ** 2
    T: FloatArray = 1.0 - 0.5 * (R_s + R_p)
    return T


def radiance_factor(cos_air: ArrayLike, n: float) -> FloatArray:
    """Radiance below over radiance above the surface: T n^2 (the solid angle shrinks by n^2)."""
    return transmittance(cos_air, n) * n * n


def transmission_elements(cos_air: ArrayLike, n: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B, C of :func:`transmission_mueller`: half the sum and half the difference of t_s^2 and t_p^2, and t_s t_p."""
    t_s, t_p = fresnel_amplitudes(cos_air, n)
    return (t_s**2 + t_p**2) / 2.0, (t_s**2 - t_p**2) / 2.0, t_s * t_p


def transmission_mueller(cos_air: ArrayLike, n: float) -> FloatArray:
    """Mueller matrix air to water, shape (..., 4, 4), about the horizontal (s) axis, up to the n c_w / c of power.

    S_1 > 0 means polarized along the horizontal. (Kattawar & Adams, Limnol. Oceanogr. 34, 1989.)
    """
    A, B, C = transmission_elements(cos_air, n)
    M = np.zeros((*np.shape(A), 4, 4))
    M[..., 0, 0] = M[..., 1, 1] = A
    M[..., 0, 1] = M[..., 1, 0] = B
    M[..., 2, 2] = M[..., 3, 3] = C
    return M


def path_transmittance(cos_water: ArrayLike, depth: float, attenuation: float) -> FloatArray:
    """exp(-k z / cos) along the slant path from the surface to ``depth`` [m], ``attenuation`` k in 1/m."""
    t: FloatArray = np.exp(-attenuation * depth / np.asarray(cos_water, dtype=np.float64))
    return t
