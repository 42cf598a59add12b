"""What the water does to the light between the surface and the camera.

Light scattered forward within a few degrees stays in the image and blurs it; the rest of what scattering takes out is
given back as a diffuse veil, so that the downward irradiance falls as Kirk found by Monte Carlo. Both polarization and
radiance are treated: the image is depolarized a little by every forward scattering; the veil is what small particles
scatter once of the light around them, which comes from sun and sky through the surface and spreads evenly about the
zenith with depth, so that its e-vectors lie across the refracted sun near the surface and horizontal in the deep.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import fft

from uwgraph.simulate.fields import cap_directions
from uwgraph.simulate.sky import UP, horizontal_axis
from uwgraph.types import FloatArray

FORWARD_SHARE: Final = 0.8
"""Share of scattering that goes into the image's own blur (Petzold's phase functions, 1972)."""
_QUADRATURE: Final = cap_directions(np.pi / 2.0, 2000)
_COSINES: Final = np.linspace(-1.0, 1.0, 401)


@dataclass(frozen=True)
class Water:
    """Inherent optical properties, the same everywhere."""

    absorption: float
    """a, 1/m."""
    scattering: float
    """b, 1/m."""
    blur: float = 0.035
    """theta_0 of Wells's phase function theta_0 / (theta_0^2 + theta^2)^(3/2), rad: half goes beyond 1.7 theta_0."""
    depolarization: float = 0.1
    """Share of the polarization that one scattering into the image destroys."""
    scattering_dop: float = 0.7
    """Degree of polarization at right angles to one beam (Voss & Fry, Appl. Opt. 23, 4427, 1984: 0.66 to 0.8)."""

    @property
    def forward(self) -> float:
        """Scattering that stays in the image, 1/m."""
        return FORWARD_SHARE * self.scattering

    @property
    def lost(self) -> float:
        """Attenuation of the image as a whole, its blur included, 1/m."""
        return self.absorption + self.scattering - self.forward

    def transmittance(self, path: FloatArray) -> FloatArray:
        """Share of the image's radiance, blurred or not, left after ``path`` [m]."""
        return np.asarray(np.exp(-self.lost * path))

    def polarization_kept(self, path: FloatArray) -> FloatArray:
        """Share of the image's polarization left after ``path`` [m]."""
        return np.asarray(np.exp(-self.depolarization * self.forward * path))

    def diffuse_attenuation(self, mean_cosine: float) -> float:
        """K_d [1/m] of downward irradiance entering at ``mean_cosine`` (Kirk, Limnol. Oceanogr. 29, 350, 1984)."""
        G = 0.425 * mean_cosine - 0.190
        return float(np.sqrt(self.absorption**2 + G * self.absorption * self.scattering)) / mean_cosine


@dataclass(frozen=True, eq=False)
class Downwelling:
    """Light just below a flat surface: what the veil is made of."""

    irradiance: float
    """On the horizontal."""
    axis: FloatArray
    """Mean direction towards the light, in water, unit, in l, shape (3,)."""
    coherency: FloatArray
    """Mean of e e^T of the light's electric vectors from all directions, trace 1, in l, shape (3, 3)."""

    @classmethod
    def of(cls, w_l: FloatArray, stokes: FloatArray) -> Downwelling:
        """Of light from directions ``w_l`` (N, 3): radiance times solid angle (N, 3) about the horizontal axis."""
        I, Q, U = stokes.T  # noqa: E741  (the field's symbol)
        x = horizontal_axis(w_l)
        y = np.cross(w_l, x)
        C = (x.T * (I + Q)) @ x + (y.T * (I - Q)) @ y + (x.T * U) @ y + (y.T * U) @ x
        axis = I @ w_l
        return cls(float(I @ (w_l @ UP)), axis / np.linalg.norm(axis), C / np.trace(C))


def veil(water: Water, light: Downwelling, depth: float, w_l: FloatArray) -> FloatArray:
    """(I, Q, U) about the horizontal axis of the diffuse light seen at ``depth`` [m] along ``w_l``, shape (N, 3).

    Its radiance is 1 / (1 - eps m.w), the shape of the asymptotic distribution in isotropic scattering (Preisendorfer
    1959; Mobley, Light and Water, 1994, 9.6), with eps = K_d / c. The direction m of its maximum turns from the mean
    direction of the light to the zenith over a length of non-forward scattering (as Tyler measured, 1960), and over
    the same length the light that is scattered into view turns into that distribution.
    """
    mean_cosine = float(light.axis @ UP)
    K_d = water.diffuse_attenuation(mean_cosine)
    left = np.exp(-K_d * depth) - np.exp(-water.lost * depth / mean_cosine)
    kept = np.exp(-(water.scattering - water.forward) * depth)
    m = kept * light.axis + (1.0 - kept) * UP
    m /= np.linalg.norm(m)
    eps = K_d / (water.absorption + water.scattering) if water.scattering > 0.0 else 0.0
    shape = 1.0 / (1.0 - eps * (w_l @ m))
    onto_horizontal = 2.0 * np.pi * np.mean(_QUADRATURE @ UP / (1.0 - eps * (_QUADRATURE @ m)))
    radiance = light.irradiance * max(left, 0.0) * shape / onto_horizontal
    C = kept * light.coherency + (1.0 - kept) * _asymptotic_coherency(eps)
    polarization = water.scattering_dop * _scattered_once(C, w_l)
    return np.column_stack([radiance, radiance * polarization.real, radiance * polarization.imag])


def _scattered_once(C: FloatArray, w_l: FloatArray) -> FloatArray:
    """(Q + i U) / I, complex, shape (N,), of light of coherency ``C`` scattered by dipoles towards views ``w_l``.

    A dipole sends what of the field is across the view, so light from everywhere at once enters by its coherency alone;
    for one refracted beam this is the Mueller-Stokes chain of surface and Rayleigh scattering.
    """
    x = horizontal_axis(w_l)
    y = np.cross(w_l, x)
    xx, yy, xy = (((p @ C) * q).sum(axis=1) for p, q in ((x, x), (y, y), (x, y)))
    return np.asarray((xx - yy + 2j * xy) / (xx + yy))


def _asymptotic_coherency(eps: float) -> FloatArray:
    """Of unpolarized light 1 / (1 - eps cos Z) from the whole sphere."""
    upright = float(np.average(_COSINES**2, weights=1.0 / (1.0 - eps * _COSINES)))
    return np.diag([1.0 + upright, 1.0 + upright, 2.0 - 2.0 * upright]) / 4.0


def blurred(image: FloatArray, water: Water, path: float, pixels_per_radian: float) -> FloatArray:
    """The image (H, W, C) after forward scattering along ``path`` [m]; the sum of light is kept.

    In the small-angle approximation a radiance that depends on direction alone is multiplied in the domain of angular
    frequency psi by exp(-b_f s (1 - p(psi))), p the transform of the phase function (Wells, AGARD Lecture Series 61,
    1973; Dolin 1964), for Wells's exp(-2 pi theta_0 psi). The image is continued by its edge.
    """
    if water.forward * path <= 0.0:
        return image
    height, width, _ = image.shape
    pad = min(max(height, width) // 4, int(np.ceil(8.0 * water.blur * pixels_per_radian)))
    rows, columns = (fft.next_fast_len(extent + 2 * pad, real=True) for extent in (height, width))
    behind = ((pad, rows - height - pad), (pad, columns - width - pad), (0, 0))
    padded = np.pad(image, behind, mode="edge")
    psi = np.hypot(fft.fftfreq(rows)[:, None], fft.rfftfreq(columns)[None]) * pixels_per_radian
    transfer = np.exp(-water.forward * path * (1.0 - np.exp(-2.0 * np.pi * water.blur * psi)))
    spectrum = fft.rfft2(padded, axes=(0, 1)) * transfer[:, :, None]
    seen: FloatArray = fft.irfft2(spectrum, (rows, columns), axes=(0, 1))
    return seen[pad : pad + height, pad : pad + width]
