"""From polarization in the image to e-vectors in the sky: analyser, port, surface.

Where the analyser sits decides the e-vector in space (p the ray inside the housing, theta its angle from the optical
axis, alpha its azimuth and phi the image's angle of polarization, both from x towards y):

* ``lens``: behind the lens, on the sensor. A rotationally symmetric lens keeps the meridional plane: the e-vector is
  at phi - alpha from the radial direction.
* ``sheet``: one ideal sheet before the lens, which absorbs along its axis: e = p x (-sin phi, cos phi, 0).
* ``projected``: phi counts from the camera's x projected on the plane normal to p (simulators).

They agree on the optical axis only. A flat port and the water's surface polarize by refraction; both are undone with
Fresnel's coefficients (Born & Wolf, 1.5.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.model import Analyser, Camera
from uwgraph.sun.eigen import Evectors
from uwgraph.sun.stokes import StokesImage
from uwgraph.sun.surface import to_air, transmission_elements
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

IndexArray = NDArray[np.intp]

_RANDOM = np.pi / np.sqrt(12.0)  # 1-sigma of an angle that is not known at all
_EXACT = 1e-4  # least 1-sigma of an angle, rad: weights stay finite without noise


@dataclass(frozen=True, eq=False)
class Light:
    """Partly polarized light along rays, Q and U counted about an axis in space; one row for each pixel in use."""

    w_b: FloatArray
    """Unit rays outside the housing, in the body, shape (N, 3)."""
    x_b: FloatArray
    """Unit axes of Q > 0, normal to the rays, shape (N, 3); angles turn about the ray."""
    I: FloatArray  # noqa: E741  (the field's symbol)
    Q: FloatArray
    U: FloatArray
    sigma: FloatArray
    """1-sigma of Q and of U, shape (N,)."""
    block: IndexArray
    """Number of the pixel's block, shape (N,)."""

    def evectors(self) -> Evectors:
        """The e-vectors as they are, along the rays."""
        chi = np.arctan2(self.U, self.Q) / 2.0
        e_b = np.cos(chi)[:, None] * self.x_b + np.sin(chi)[:, None] * np.cross(self.w_b, self.x_b)
        sigma = 0.5 * self.sigma / np.maximum(np.hypot(self.Q, self.U), 1e-300)
        return Evectors(self.w_b, e_b, np.clip(sigma, _EXACT, _RANDOM), self.block)

    def select(self, index: IndexArray) -> Light:
        w_b, x_b, I, Q, U, sigma = (x[index] for x in (self.w_b, self.x_b, self.I, self.Q, self.U, self.sigma))  # noqa: E741
        return Light(w_b, x_b, I, Q, U, sigma, self.block[index])


@dataclass(frozen=True)
class Unknowns:
    """What is not known of the light's way, beside the sun."""

    log_kappa: float = 0.0
    """Logarithm of how much the water, after the surface, lessened the degree of polarization; 0 in air."""
    twice: float = 0.0
    """Vertical polarization near the horizon by light that was scattered twice, as a share of the intensity.

    It falls off as sin^2 of the zenith angle and makes the sky's neutral points (Berry, Dennis & Lee, New J. Phys. 6,
    162, 2004).
    """


@dataclass(frozen=True, eq=False)
class Skylight:
    """Light about horizontal axes, below a level surface or in air, and what the surface did to it."""

    a_b: FloatArray
    """Directions in the sky, above the surface, shape (N, 3)."""
    s_axis: FloatArray
    """Unit horizontal axes, normal to the plane of incidence, shape (N, 3)."""
    p_axis: FloatArray
    """a x s_axis, shape (N, 3)."""
    sin2: FloatArray
    """sin^2 of the zenith angle of ``a_b``, shape (N,)."""
    light: Light
    """Q and U about ``s_axis``."""
    A: FloatArray
    """(t_s^2 + t_p^2) / 2, shape (N,); B is half the difference, C the product of t_s and t_p. 1, 0, 1 in air."""
    B: FloatArray
    C: FloatArray

    def evectors(self, unknowns: Unknowns) -> Evectors:
        """The e-vectors of the light that was scattered once, above the surface."""
        light, A, B, C = self.light, self.A, self.B, self.C
        kappa = np.exp(unknowns.log_kappa)
        Q = A * kappa * light.Q - B * light.I
        U = C * kappa * light.U
        Q = Q + unknowns.twice * self.sin2 * (A * light.I - B * kappa * light.Q)
        sigma = 0.5 * kappa * light.sigma * np.hypot(Q * C, U * A) / np.maximum(Q * Q + U * U, 1e-300)
        chi = np.arctan2(U, Q) / 2.0
        e_b = np.cos(chi)[:, None] * self.s_axis + np.sin(chi)[:, None] * self.p_axis
        return Evectors(self.a_b, e_b, np.clip(sigma, _EXACT, _RANDOM), light.block)

    def derivatives(self, unknowns: Unknowns, s_b: FloatArray) -> FloatArray:
        """Derivative of the e-vectors' angles [rad] by log kappa and by twice, shape (N, 2), for a sun at ``s_b``.

        It is taken at the angles that the sun makes, not at those measured, and so is free of their noise.
        """
        light, A, B, C = self.light, self.A, self.B, self.C
        kappa = np.exp(unknowns.log_kappa)
        I = A * light.I - B * kappa * light.Q  # noqa: E741
        Q = A * kappa * light.Q - B * light.I + unknowns.twice * self.sin2 * I
        degree = np.maximum(np.hypot(Q, C * kappa * light.U), 1e-300)
        across = np.cross(self.a_b, s_b)
        along_s, along_p = (np.einsum("ni,ni->n", across, axis) for axis in (self.s_axis, self.p_axis))
        sin_2chi = 2.0 * along_s * along_p / np.maximum(along_s**2 + along_p**2, 1e-300)
        by_log_kappa = (B - unknowns.twice * self.sin2 * A) * light.I
        by_twice = self.sin2 * I
        return np.asarray(-0.5 * (sin_2chi / degree)[:, None] * np.stack([by_log_kappa, by_twice], axis=1))

    def select(self, index: IndexArray) -> Skylight:
        a, s, p, sin2, A, B, C = (
            x[index] for x in (self.a_b, self.s_axis, self.p_axis, self.sin2, self.A, self.B, self.C)
        )
        return Skylight(a, s, p, sin2, self.light.select(index), A, B, C)


def light_of(image: StokesImage, view: View, use: IndexArray, block: IndexArray, dop_error: float) -> Light:
    """The light at pixels ``use`` (flat indices) before it met the housing; ``view`` is that of the image's pixels.

    ``dop_error`` is the sensor's own error of the degree of polarization, 1-sigma, beside the noise.
    """
    I, Q, U, sigma = (x.ravel()[use] for x in (image.I, image.Q, image.U, image.sigma))  # noqa: E741
    sigma = np.hypot(sigma, dop_error * I)
    lines = _meridians(view.camera, view.n)
    theta = lines.theta[use]
    Q, U, sigma = _about_radial(view.camera.analyser, lines.alpha[use], theta, Q, U, sigma)
    if view.camera.port == "flat" and view.in_water:
        A, B, C = transmission_elements(np.cos(theta), view.n)
        I, Q, U, sigma = A * I + B * Q, A * Q + B * I, C * U, C * sigma  # noqa: E741  (s is the tangential axis)
    return Light(view.body_rays()[0][use], lines.radial_b[use], I, Q, U, sigma, block)


def skylight(light: Light, up_b: FloatArray, n: float) -> Skylight:
    """The light about the horizontal axis; under water (``n`` > 1) below a surface that is level as ``up_b`` says."""
    across = np.cross(up_b, light.w_b)
    across[np.abs(across).max(axis=1) < 1e-9] = np.cross(up_b, [up_b[1], up_b[2], up_b[0]])  # straight up: any will do
    s_axis = across / np.linalg.norm(across, axis=1)[:, None]
    cos_chi = np.einsum("ni,ni->n", s_axis, light.x_b)
    sin_chi = np.einsum("ni,ni->n", s_axis, np.cross(light.w_b, light.x_b))
    cos_2chi, sin_2chi = cos_chi**2 - sin_chi**2, 2.0 * sin_chi * cos_chi
    Q = light.Q * cos_2chi + light.U * sin_2chi
    U = light.U * cos_2chi - light.Q * sin_2chi
    turned = Light(light.w_b, s_axis, light.I, Q, U, light.sigma, light.block)
    a_b = to_air(light.w_b, up_b, n) if n > 1.0 else light.w_b
    cos_zenith = a_b @ up_b
    A, B, C = transmission_elements(cos_zenith, n)
    return Skylight(a_b, s_axis, np.cross(a_b, s_axis), 1.0 - cos_zenith**2, turned, A, B, C)


@dataclass(frozen=True, eq=False)
class _Meridians:
    radial_b: FloatArray
    """Unit vectors normal to the rays outside the housing, away from the optical axis, shape (H W, 3)."""
    alpha: FloatArray
    """Azimuth of the ray about the optical axis, from x towards y, rad, shape (H W,)."""
    theta: FloatArray
    """Angle of the ray inside the housing from the optical axis, rad, shape (H W,)."""


@lru_cache(maxsize=16)
def _meridians(camera: Camera, n: float) -> _Meridians:
    pixels = camera.pixels()
    inside = camera.rays(pixels)
    outside = camera.outside(pixels, n)[0] @ camera.R_bs
    alpha = np.arctan2(inside[:, 1], inside[:, 0])
    sin, cos = np.hypot(outside[:, 0], outside[:, 1]), outside[:, 2]
    radial = np.stack([cos * np.cos(alpha), cos * np.sin(alpha), -sin], axis=1)
    return _Meridians(radial @ camera.R_bs.T, alpha, np.arccos(np.clip(inside[:, 2], -1.0, 1.0)))


def _about_radial(
    analyser: Analyser, alpha: FloatArray, theta: FloatArray, Q: FloatArray, U: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Q, U and their 1-sigma about the radial direction, of those about the image's x."""
    if analyser == "sheet":
        phi = np.arctan2(U, Q) / 2.0 - alpha
        degree = np.hypot(Q, U)
        across, along = np.cos(theta) * np.sin(phi), np.cos(phi)
        chi = 2.0 * np.arctan2(across, along)
        return degree * np.cos(chi), degree * np.sin(chi), sigma * np.cos(theta) / (across**2 + along**2)
    turn = -2.0 * alpha
    if analyser == "projected":
        turn = 2.0 * np.arctan2(-np.sin(alpha), np.cos(theta) * np.cos(alpha))
    cos, sin = np.cos(turn), np.sin(turn)
    return Q * cos - U * sin, Q * sin + U * cos, sigma
