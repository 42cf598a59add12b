"""Sunlight scattered under water: the Mueller-Stokes chain sun, surface, scattering, detector.

One ray of the sun is refracted into the water, scattered once towards the camera, and seen by an analyser whose axes
are horizontal (right) and upright. Powell, Garnett, Marshall & Rizk, Science Robotics 3, 2018; Kattawar & Adams,
Limnol. Oceanogr. 34, 1989, for the surface.

Azimuths are clockwise from any common zero (north, or the bow of the levelled body); a view direction points from the
camera outwards. Stokes vectors are (I, Q, U), for no light here is circular, about axes transverse to the light: Q > 0
along the first, U > 0 between the first and the second, the light coming towards the reader. The angle of polarization
(AoP) of scattered light is 0 when horizontal and grows from the right, as the camera sees it, towards up. It counts
modulo 180 degrees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from uwgraph.sun.surface import transmission_elements
from uwgraph.types import FloatArray


def scattered_aop(
    sun_azimuth: ArrayLike,
    sun_zenith: ArrayLike,
    view_azimuth: ArrayLike,
    view_elevation: ArrayLike = 0.0,
    n: float = 1.33,
    max_dolp: float = 1.0,
) -> FloatArray:
    """AoP [rad] in [-pi/2, pi/2] of :func:`scattered_stokes`, arguments and shape as there."""
    S = scattered_stokes(sun_azimuth, sun_zenith, view_azimuth, view_elevation, n, max_dolp)
    return aop(S)


def scattered_stokes(
    sun_azimuth: ArrayLike,
    sun_zenith: ArrayLike,
    view_azimuth: ArrayLike,
    view_elevation: ArrayLike = 0.0,
    n: float = 1.33,
    max_dolp: float = 1.0,
) -> FloatArray:
    """Stokes vectors, shape (..., 3), of sunlight scattered once in the water, seen by a camera in the water.

    The intensity lacks the scalar phase function and attenuation, which change neither AoP nor degree of polarization.

    Parameters
    ----------
    sun_azimuth, sun_zenith : array_like
        Apparent sun above the surface, rad; shapes broadcast with those of the view.
    view_azimuth, view_elevation : array_like
        Direction of view in the water, rad.
    n : float
        Refractive index of the water.
    max_dolp : float
        Degree of polarization at 90 degrees of scattering: 1 for Rayleigh's, 0.66 to 0.8 measured in sea water
        (Voss & Fry, Appl. Opt. 23, 1984).
    """
    sun_zenith, view_elevation = np.asarray(sun_zenith, np.float64), np.asarray(view_elevation, np.float64)
    turn = np.asarray(view_azimuth, dtype=np.float64) - np.asarray(sun_azimuth, dtype=np.float64)
    sin_t = np.sin(sun_zenith) / n  # the beam in the water, from its zenith
    cos_t = np.sqrt(1.0 - sin_t * sin_t)
    sin_v, cos_v = np.sin(view_elevation), np.cos(view_elevation)
    i, q, _ = transmission_elements(np.cos(sun_zenith), n)
    u = np.zeros_like(i)

    # From the horizontal to the plane of scattering, about the beam: the scattered ray across the beam
    i, q, u = _turned(i, q, u, -cos_v * np.sin(turn), cos_t * cos_v * np.cos(turn) - sin_t * sin_v)
    i, q, u = _scattered(i, q, u, sin_t * cos_v * np.cos(turn) + cos_t * sin_v, max_dolp)
    # and from there to the horizontal of the camera: the beam across the scattered ray
    i, q, u = _turned(i, q, u, -sin_t * np.sin(turn), sin_t * sin_v * np.cos(turn) - cos_t * cos_v)
    return np.stack(np.broadcast_arrays(i, q, u), axis=-1)


def aop(S: FloatArray) -> FloatArray:
    """Angle of polarization [rad], shape (...), from the first transverse axis, of Stokes vectors (..., 3)."""
    angle: FloatArray = np.arctan2(S[..., 2], S[..., 1]) / 2.0
    return angle


def dolp(S: FloatArray) -> FloatArray:
    """Degree of linear polarization, shape (...), of Stokes vectors (..., 3)."""
    degree: FloatArray = np.hypot(S[..., 1], S[..., 2]) / S[..., 0]
    return degree


def wrap_half(angle: ArrayLike) -> FloatArray:
    """A difference of AoPs brought into [-pi/2, pi/2)."""
    wrapped: FloatArray = (np.asarray(angle, dtype=np.float64) + np.pi / 2.0) % np.pi - np.pi / 2.0
    return wrapped


def sun_from_sine(view_azimuth: FloatArray, aops: FloatArray, weights: FloatArray, n: float) -> tuple[float, float]:
    """(azimuth, zenith) [rad] of the sun from AoPs (N,) of level views: a start, good to some degrees.

    Without the surface's diattenuation tan(AoP) = tan(theta_r) sin(view - sun), sin(theta_r) = sin(zenith) / n, which
    is linear in two numbers. The crossings at sun and antisun differ in slope, so that there is no second solution.
    """
    A = np.stack([np.sin(view_azimuth), np.cos(view_azimuth)], axis=1)
    steepest = np.arctan(1.25 / n)  # noise beyond what any sun gives must not run off to infinity
    t = np.tan(np.clip(wrap_half(aops), -steepest, steepest))
    (a, b), *_ = np.linalg.lstsq(A * weights[:, None], t * weights, rcond=None)
    theta_r = np.arctan(np.hypot(a, b))
    return float(np.arctan2(-b, a)), float(np.arcsin(min(1.0, n * np.sin(theta_r))))


def _turned(
    i: FloatArray, q: FloatArray, u: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same light about an axis along (x, y), of any length, in the axes it was given in."""
    square = x * x + y * y
    nowhere = square < 1e-24  # straight ahead and behind there is no plane of scattering: any will do
    square = np.where(nowhere, 1.0, square)
    cos_2, sin_2 = np.where(nowhere, 1.0, (x * x - y * y) / square), 2.0 * x * y / square
    return i, cos_2 * q + sin_2 * u, cos_2 * u - sin_2 * q


def _scattered(
    i: FloatArray, q: FloatArray, u: FloatArray, mu: FloatArray, max_dolp: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rayleigh's scattering matrix, its polarizing elements scaled, about the plane of scattering; mu = cos(angle)."""
    a = max_dolp * (mu * mu - 1.0) / (mu * mu + 1.0)
    return i + a * q, a * i + q, 2.0 * mu / (mu * mu + 1.0) * u
