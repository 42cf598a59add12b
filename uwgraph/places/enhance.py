"""Grey images in which the scene counts, not the water, the lamp or the clock burned into the corner."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.errors import ConfigError

Grey = NDArray[np.uint8]
Enhancement = Literal["none", "clahe", "normalise", "descatter", "polarization"]

SCALE: Final = 1.0 / 12.0
"""Width of what counts as illumination and veil, as a share of the longer side of the image."""
CLIP: Final = 3.0
"""Contrast limit of CLAHE."""
TILES: Final = 8
"""CLAHE's tiles along either side."""
MIN_SIDE: Final = 16
"""Narrower images have nothing to be enhanced."""
COHERENT: Final = 0.65
"""Edges that keep their place: length of the mean gradient over the mean length (a scene of straight lines: 0.55)."""
MIN_IMAGES: Final = 20
"""With fewer images edges of the scene fall onto each other by chance."""
MOST_STATIC: Final = 0.3
"""Where more of the image stands still than this, the vehicle does, not an overlay."""


def enhance(image: NDArray[Any], how: Enhancement = "clahe", mask: Grey | None = None) -> Grey:
    """An image as 8-bit grey, shape (H, W), with its local contrast brought out.

    Parameters
    ----------
    image : shape (H, W), (H, W, 3) or (H, W, 1)
        Counts of 8 or 16 bits, colours in the order blue, green, red; for ``"polarization"`` a Stokes image (I, Q, U)
        of numbers.
    how : str
        ``"clahe"``: contrast-limited adaptive histogram equalisation. ``"normalise"``: the local mean and spread are
        taken out, and with them lamp, vignetting and attenuation. ``"descatter"``: the veil is the local minimum; it
        is subtracted and what is left is divided by the transmission (dark channel; Drews et al., ICCV workshops,
        2013), then CLAHE. ``"polarization"``: the veil found by its polarization is subtracted, then CLAHE.
        ``"none"``: grey alone.
    mask : shape (H, W), optional
        0 where the scene is hidden: what is there is replaced by its surroundings, or it would change their contrast.

    Raises
    ------
    ConfigError
        When the array is no image, or no Stokes image where one is needed.
    """
    if how not in get_args(Enhancement):
        raise ConfigError(f"unknown enhancement {how!r}", remedy=f"use one of {', '.join(get_args(Enhancement))}")
    if how == "polarization":
        return _equalised(_filled(_eight_bits(without_polarized_veil(image)), mask))
    grey = _filled(_grey(image), mask)
    if how == "none" or min(grey.shape) < MIN_SIDE:
        return grey
    if how == "normalise":
        return _normalised(grey)
    return _equalised(_without_veil(grey) if how == "descatter" else grey)


def without_polarized_veil(stokes: NDArray[Any]) -> NDArray[np.float32]:
    """Intensity without the scattered light, shape (H, W), from a Stokes image (I, Q, U), shape (H, W, 3).

    The veil is polarized along one axis and the sea floor hardly is: the difference of the images along and across
    that axis, divided by the veil's degree of polarization, is the veil (Schechner & Karpel, IEEE J. Oceanic Eng. 30,
    2005; polarization difference: Rowe, Pugh, Tyo & Engheta, Opt. Lett. 20, 1995).
    """
    if stokes.ndim != 3 or stokes.shape[2] != 3 or stokes.dtype.kind not in "fiu" or stokes.size == 0:
        raise ConfigError(
            f"{stokes.dtype} of shape {stokes.shape} is no Stokes image",
            remedy="give I, Q, U as an array (H, W, 3), or choose another enhancement",
        )
    i, q, u = np.moveaxis(np.nan_to_num(stokes.astype(np.float32), posinf=0.0, neginf=0.0), 2, 0)
    i = np.maximum(i, 0.0)
    axis = 0.5 * np.arctan2(u.sum(dtype=np.float64), q.sum(dtype=np.float64))
    difference = np.clip(q * np.float32(np.cos(2.0 * axis)) + u * np.float32(np.sin(2.0 * axis)), 0.0, i)
    degree = np.divide(difference, i, out=np.zeros_like(i), where=i > 0.0)
    veil_degree = float(np.percentile(degree, 99.0))
    if veil_degree < 0.01:  # unpolarized light has no veil that could be told apart
        return np.asarray(i)
    return np.asarray(np.maximum(i - difference / veil_degree, 0.0), dtype=np.float32)


def scene_mask(images: Iterable[Grey]) -> Grey | None:
    """Where a sequence of images (H, W) shows the scene: 255, and 0 on burned-in text, the vehicle itself, dirt.

    An edge of an overlay is at the same place in every image, an edge of the scene passes by. Some forty images spread
    over a dive suffice. None where there are fewer than 20 of one size, or the vehicle stood still.
    """
    count = 0
    total: NDArray[Any] = np.zeros(0)
    length: NDArray[Any] = np.zeros(0)
    for image in images:
        smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
        gradient = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)])
        if count and gradient.shape != total.shape:
            continue
        size = np.hypot(*gradient)
        total, length = (total + gradient, length + size) if count else (gradient, size)
        count += 1
    if count < MIN_IMAGES:
        return None
    around = max(3, round(max(length.shape) / 128))
    lengths = cv2.blur(length, (around, around))
    kept = cv2.blur(np.hypot(*total), (around, around)) / np.maximum(lengths, 1e-6)
    fixed = ((kept > COHERENT) & (lengths > 10.0 * count)).astype(np.uint8)
    closed = cv2.morphologyEx(fixed, cv2.MORPH_CLOSE, np.ones((2 * around + 1, 4 * around + 1), np.uint8))
    static = np.asarray(cv2.dilate(closed, np.ones((around, around), np.uint8)), dtype=bool)
    return None if static.mean() > MOST_STATIC else np.where(static, np.uint8(0), np.uint8(255))


def _grey(image: NDArray[Any]) -> Grey:
    """Counts as 8-bit grey."""
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    shaped = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if not shaped or image.dtype not in (np.uint8, np.uint16) or image.size == 0:
        raise ConfigError(
            f"{image.dtype} of shape {image.shape} is no image", remedy="give 8 or 16 bit counts, (H, W) or (H, W, 3)"
        )
    grey: NDArray[Any] = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) if image.ndim == 3 else image
    return grey if grey.dtype == np.uint8 else _eight_bits(grey)


def _filled(grey: Grey, mask: Grey | None) -> Grey:
    """Where the mask is 0, the mean of what is seen around."""
    if mask is None or mask.shape != grey.shape or min(grey.shape) < MIN_SIDE or not np.any(mask == 0):
        return grey
    seen = (mask > 0).astype(np.float32)
    sigma = SCALE * max(grey.shape)
    around = _smooth(grey * seen, sigma) / np.maximum(_smooth(seen, sigma), np.float32(1e-3))
    return np.where(mask > 0, grey, np.clip(np.rint(around), 0.0, 255.0).astype(np.uint8))


def _eight_bits(values: NDArray[Any]) -> Grey:
    """From the darkest to the brightest, but for one in 200 at either end."""
    low, high = np.percentile(values, (0.5, 99.5))
    scaled = (values - low) * (255.0 / max(high - low, 1e-9))
    return np.asarray(np.clip(np.rint(scaled), 0.0, 255.0), dtype=np.uint8)


def _equalised(grey: Grey) -> Grey:
    if min(grey.shape) < MIN_SIDE:
        return grey
    return np.asarray(cv2.createCLAHE(CLIP, (TILES, TILES)).apply(grey), dtype=np.uint8)


def _normalised(grey: Grey) -> Grey:
    """Local mean and standard deviation taken out; a flat patch stays flat."""
    value = grey.astype(np.float32)
    sigma = SCALE * max(grey.shape)
    value -= _smooth(value, sigma)
    spread = np.sqrt(_smooth(value * value, sigma)) + 2.0  # counts: noise is not blown up
    return np.asarray(np.clip(np.rint(128.0 + 48.0 * value / spread), 0.0, 255.0), dtype=np.uint8)


def _without_veil(grey: Grey) -> Grey:
    value = grey.astype(np.float32)
    sigma = SCALE * max(grey.shape)
    patch = max(3, round(sigma / 2.0)) | 1
    darkest = np.asarray(cv2.erode(value, np.ones((patch, patch), np.uint8)), dtype=np.float32)
    veil = _smooth(darkest, sigma / 2.0)
    water = max(float(veil.max()), 1.0)  # the veil of endless water
    transmission = np.maximum(1.0 - 0.9 * veil / water, 0.2)
    return _eight_bits((value - veil) / transmission)


def _smooth(value: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Gaussian, made at a quarter of the size: a wide one is slow."""
    small = cv2.resize(value, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    wide = cv2.GaussianBlur(small, (0, 0), max(sigma / 4.0, 0.5), borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(wide, value.shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)
