"""The navigation frame on the ellipsoid, local verticals, gravity, and attitude angles.

The navigation frame n is Cartesian NED, tangent to the WGS-84 ellipsoid at the dive's origin (height 0). It turns with
the Earth and nothing else, so the Earth rate in it is constant; gravity and the local vertical depend on the place.
Heights are taken against the sea surface, which stands for the ellipsoid.
"""

from __future__ import annotations

from typing import Final

import boule
import numpy as np
import pymap3d
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from uwgraph.types import FloatArray, Origin

OMEGA_EARTH: Final = 7.292115e-5
"""Rotation rate of the Earth, rad/s (WGS-84)."""

WGS84: Final = boule.WGS84


def ned_from_geodetic(origin: Origin, lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> FloatArray:
    """Position in n, shape (..., 3), of latitude and longitude [rad] and height [m]."""
    shape = np.broadcast_shapes(np.shape(lat), np.shape(lon), np.shape(height))
    ned = pymap3d.geodetic2ned(lat, lon, height, origin.lat, origin.lon, 0.0, deg=False)
    # pymap3d drops the axis of arrays of one element
    return np.stack(np.broadcast_arrays(*ned), axis=-1).reshape(*shape, 3).astype(np.float64)


def geodetic_from_ned(origin: Origin, p_n: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Latitude [rad], longitude [rad] and height [m] of positions in n, shape (..., 3)."""
    n, e, d = np.moveaxis(np.asarray(p_n, dtype=np.float64), -1, 0)
    lat, lon, height = pymap3d.ned2geodetic(n, e, d, origin.lat, origin.lon, 0.0, deg=False)
    return np.reshape(lat, n.shape), np.reshape(lon, n.shape), np.reshape(height, n.shape)


def origin_from(lat: float, lon: float, height: float, p_n: FloatArray) -> Origin:
    """Where n touches the ellipsoid, given one place [rad, rad, m] and its position in n, shape (3,).

    A place too far north as seen from a guess means that the guess is too far south.
    """
    guess = Origin(lat, lon)
    for _ in range(50):
        off = ned_from_geodetic(guess, lat, lon, height) - p_n
        if np.hypot(off[0], off[1]) < 1e-8:
            break
        at_lat, at_lon, _ = geodetic_from_ned(guess, np.array([off[0], off[1], 0.0]))
        guess = Origin(float(at_lat), float(at_lon))
    return guess


def _ecef_from_ned(lat: ArrayLike, lon: ArrayLike) -> FloatArray:
    """Rotation from the NED axes at a place to the Earth's own axes, shape (..., 3, 3)."""
    lat, lon = np.broadcast_arrays(np.asarray(lat, dtype=np.float64), np.asarray(lon, dtype=np.float64))
    sp, cp, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    zero = np.zeros_like(sp)
    north = np.stack([-sp * cl, -sp * sl, cp], axis=-1)
    east = np.stack([-sl, cl, zero], axis=-1)
    down = np.stack([-cp * cl, -cp * sl, -sp], axis=-1)
    return np.stack([north, east, down], axis=-1)


def R_n_local(origin: Origin, lat: ArrayLike, lon: ArrayLike) -> FloatArray:
    """Rotation from the local NED axes at (lat, lon) [rad] to n, shape (..., 3, 3)."""
    R: FloatArray = _ecef_from_ned(origin.lat, origin.lon).T @ _ecef_from_ned(lat, lon)
    return R


def earth_rate_n(origin: Origin) -> FloatArray:
    """Earth rotation in n, shape (3,), rad/s; the same at every place, since n does not move over the Earth."""
    return np.array([OMEGA_EARTH * np.cos(origin.lat), 0.0, -OMEGA_EARTH * np.sin(origin.lat)])


def normal_gravity(lat: ArrayLike, height: ArrayLike) -> FloatArray:
    """Normal gravity [m/s^2] at latitude [rad] and height [m], in free air above the sea and in water below.

    Below the surface the gradient is the free-air one less that of the water, 0.3086 - 4 pi G rho = 0.22246 mGal/m
    (rho = 1027 kg/m^3; Poincare-Prey reduction, Hofmann-Wellenhof & Moritz, Physical Geodesy, 3.5).
    """
    lat = np.asarray(lat, dtype=np.float64)
    height = np.asarray(height, dtype=np.float64)
    above = WGS84.normal_gravity((np.zeros_like(lat), np.degrees(lat), np.maximum(height, 0.0))) * 1e-5
    gravity: FloatArray = np.asarray(above) + 0.22246e-5 * np.maximum(-height, 0.0)
    return gravity


def gravity_n(origin: Origin, p_n: ArrayLike) -> FloatArray:
    """Gravity vector in n at positions p_n, shape (..., 3), m/s^2, centrifugal force included."""
    lat, lon, height = geodetic_from_ned(origin, p_n)
    down = R_n_local(origin, lat, lon)[..., :, 2]
    g: FloatArray = down * normal_gravity(lat, height)[..., None]
    return g


def matrix_from_rph(rph: ArrayLike) -> FloatArray:
    """Rotation body to local NED, shape (..., 3, 3), of roll, pitch, heading [rad], shape (..., 3)."""
    angles = np.asarray(rph, dtype=np.float64)
    flat = Rotation.from_euler("ZYX", angles.reshape(-1, 3)[:, ::-1]).as_matrix()
    R: FloatArray = flat.reshape(*angles.shape[:-1], 3, 3)
    return R


def rph_from_matrix(R: ArrayLike) -> FloatArray:
    """Roll, pitch, heading [rad], shape (..., 3), of rotations body to local NED, shape (..., 3, 3)."""
    M = np.asarray(R, dtype=np.float64)
    roll = np.arctan2(M[..., 2, 1], M[..., 2, 2])
    pitch = np.arcsin(np.clip(-M[..., 2, 0], -1.0, 1.0))
    heading = np.arctan2(M[..., 1, 0], M[..., 0, 0])
    return np.stack([roll, pitch, heading], axis=-1)


def wrap_pi(angle: ArrayLike) -> FloatArray:
    """The angle brought into [-pi, pi)."""
    return (np.asarray(angle, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi
