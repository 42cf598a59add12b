"""From an image to the logarithm of the sky's radiance and its gradient on the sphere of directions.

The light of the sky grows towards the sun, so its gradient lies in the plane of the view and the sun: the normal of
view and gradient is orthogonal to the sun (Chinese patent application "autonomous orientation by underwater light
intensity gradients"). The logarithm turns every factor of the light's way into a term: those that depend on the zenith
angle alone (Fresnel, path, vignetting of a level lens) can then be told from the sun's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.refraction import refract_jacobian
from uwgraph.camera.sensor import Sensor
from uwgraph.sun.gradient_mask import clear_sky, dilated, smoothed
from uwgraph.sun.surface import in_window, radiance_factor
from uwgraph.sun.view import View
from uwgraph.types import BoolArray, FloatArray

MAX_ZENITH = np.radians(76.0)
"""Sky farther from the zenith is not used: refraction and haze are steep there."""


@dataclass(frozen=True, eq=False)
class SkyLight:
    """The logarithm of the radiance above the surface, in binned pixels of one image."""

    view: View
    """Of the binned pixels."""
    log_l: FloatArray
    """ln of the radiance up to a constant, shape (H, W); NaN beyond the sky in view."""
    variance: FloatArray
    """Its variance from the sensor's noise, shape (H, W)."""
    sky: BoolArray
    """Pixels in the window and nearer to the zenith than ``MAX_ZENITH``, shape (H, W)."""
    good: BoolArray
    """Those of clear sky: not overexposed, no disc, glint or occluder, shape (H, W)."""
    noise_share: FloatArray
    """Noise over light in one pixel of the sensor, shape (H, W)."""
    overexposed: float
    """Share of the sky in view that is overexposed."""

    def directions(self, pixels: BoolArray, up_b: FloatArray) -> FloatArray:
        """Sky directions in b of the chosen pixels, row by row, shape (N, 3), were ``up_b`` the vertical."""
        w = self.view.body_rays()[0][pixels.ravel()]
        return self.view.tilted(up_b).above(w)


def sky_light(image: NDArray[Any], view: View, sensor: Sensor, factor: int, optical_depth: float = 0.0) -> SkyLight:
    """Bin the image (H, W) by ``factor``, mask it, and undo surface and path (``optical_depth`` straight up)."""
    counts, clipped = _binned(image, sensor, factor)
    view = view.binned(factor)
    light = np.maximum(counts - sensor.black, 0.1 / sensor.gain)
    w, _ = view.body_rays()
    sky = np.nan_to_num(w @ view.up_b, nan=-1.0) > 1e-3
    sky[sky] = in_window(w[sky], view.up_b, view.n, MAX_ZENITH)
    cos_air, path = _heights(w[sky], view)
    sky = sky.reshape(counts.shape)
    log_l = np.full(sky.shape, np.nan)
    log_l[sky] = np.log(light[sky]) + optical_depth * path
    if view.in_water:
        log_l[sky] -= np.log(radiance_factor(cos_air, view.n))
    overexposed = sky & clipped
    zenith = np.zeros(sky.shape)
    zenith[sky] = np.arccos(np.minimum(cos_air, 1.0))
    noise_share = np.sqrt(sensor.variance(counts)) / light
    return SkyLight(
        view=view,
        log_l=log_l,
        variance=(noise_share / factor) ** 2,
        noise_share=noise_share,
        sky=sky,
        good=clear_sky(log_l, zenith, sky, overexposed | (sky & (noise_share > 1.0))),
        overexposed=float(overexposed.sum() / max(sky.sum(), 1)),
    )


def _binned(image: NDArray[Any], sensor: Sensor, factor: int) -> tuple[FloatArray, BoolArray]:
    """Counts at the middle of ``factor`` x ``factor`` pixels, and where any of them is overexposed or no number."""
    height, width = (extent // factor for extent in image.shape)
    image = image[: height * factor, : width * factor]
    size = (width, height)
    counts = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    clipped = cv2.resize(sensor.saturated(image).view(np.uint8) * np.uint8(255), size, interpolation=cv2.INTER_AREA)
    lost = ~np.isfinite(counts)
    counts = np.where(lost, sensor.black, counts).astype(np.float64)
    if factor > 1:  # the mean over a curved patch is not the value at its middle
        counts = np.maximum(counts - cv2.Laplacian(counts, cv2.CV_64F, borderType=cv2.BORDER_REPLICATE) / 24.0, 0.0)
    return np.asarray(counts, dtype=np.float64), np.asarray((clipped > 0) | lost)


def _heights(w: FloatArray, view: View) -> tuple[FloatArray, FloatArray]:
    """Cosine of the zenith angle in air, and slant path over height in the water, of body rays (N, 3)."""
    cos_w = w @ view.up_b
    return np.sqrt(1.0 - view.n**2 * (1.0 - cos_w**2)), 1.0 / cos_w


@dataclass(frozen=True, eq=False)
class GradientField:
    """Gradients of the logarithm of the radiance on the sphere, at chosen pixels."""

    a: FloatArray
    """Directions in the sky, in b, shape (N, 3)."""
    g: FloatArray
    """Tangent gradients, 1/rad, shape (N, 3)."""
    m: FloatArray
    """Normals a x g of the planes that hold view, gradient and sun, shape (N, 3)."""
    noise: FloatArray
    """Covariance of ``m`` from the sensor's noise, shape (N, 3, 3)."""
    pixels: BoolArray
    """Which pixels of the binned image these are, shape (H, W)."""


def gradient_field(light: SkyLight, blur: float) -> GradientField:
    """Smooth with a Gaussian of ``blur`` pixels, differentiate, and lift to the sphere.

    The tangent gradient is the only tangent vector g with A^T g = grad_uv, A the derivative of the direction by the
    pixel: g = A (A^T A)^-1 grad_uv.
    """
    smooth, share = smoothed(light.log_l, light.good, blur)
    du = cv2.Sobel(smooth, cv2.CV_64F, 1, 0, ksize=3, scale=1.0 / 8.0)
    dv = cv2.Sobel(smooth, cv2.CV_64F, 0, 1, ksize=3, scale=1.0 / 8.0)
    pixels = light.good & (share > 0.8)
    pixels &= ~dilated(~pixels, 1.0)
    a = light.directions(pixels, light.view.up_b)
    w, J = (x[pixels.ravel()] for x in light.view.body_rays())
    A = refract_jacobian(w, light.view.up_b, 1.0 / light.view.n) @ J if light.view.in_water else J
    lift = A @ np.linalg.inv(np.swapaxes(A, 1, 2) @ A)
    g = np.einsum("nij,nj->ni", lift, np.stack([du[pixels], dv[pixels]], axis=1))
    across = np.cross(a[:, None, :], np.swapaxes(lift, 1, 2))
    sigma2 = light.variance[pixels] / (8.0 * np.pi * blur**4)  # of the derivative of a Gaussian mean of white noise
    noise = sigma2[:, None, None] * np.einsum("npi,npj->nij", across, across)
    return GradientField(a, g, np.cross(a, g), noise, pixels)
