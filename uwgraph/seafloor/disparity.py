"""Disparities of a rectified pair, refined below the pixel, with a 1-sigma that knows the texture.

Semi-global matching (Hirschmueller 2008, OpenCV's) finds the whole pixels and locks its fractions to them; a few steps
of Lucas and Kanade (1981) along the rows, with brightness free in every window, unlock them.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.seafloor.patch import Colours
from uwgraph.types import FloatArray

Pixels = NDArray[np.float32]
"""A value per pixel, shape (H, W); NaN where not known."""

_BLOCK: Final = 5
_CLAHE: Final = (2.0, (8, 8))
_WINDOW: Final = 3.0
"""Pixels: width of the bell that weights a match."""
_SMOOTH: Final = 2.0
"""Pixels: disparities are smooth to about this."""
_STEPS: Final = 4
_FARTHEST_STEP: Final = 1.0
"""Pixels: who is refined by more was mismatched."""
_FLAT: Final = 1e-3
"""Grey levels squared: variance of slope below which there is no texture."""
_WORST: Final = 0.5
"""Pixels: a match with a larger 1-sigma is none."""
_FILLED: Final = 0.5
"""Less than this share of a block known: the block is not."""


def match(left: Colours, right: Colours, low: int, count: int) -> tuple[Pixels, Pixels]:
    """Disparity of every pixel of the left image, ``low`` to ``low + count``, and its 1-sigma, pixels.

    NaN where the two images do not agree both ways, or have too little texture to tell.
    """
    first, second = (np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) for image in (left, right))
    return _refined(first.astype(np.float32), second.astype(np.float32), _whole(first, second, low, count))


def blocks(disparity: Pixels, sigma: Pixels, step: int) -> tuple[FloatArray, FloatArray]:
    """Median disparity and 1-sigma of blocks of ``step`` x ``step`` pixels, shapes (rows, columns).

    Neighbouring matches share their windows, so that a block is no surer than one of them. NaN where less than half
    of a block is known.
    """
    middle, typical = (_median(pixels, step) for pixels in (disparity, sigma))
    return middle, typical


def _whole(left: NDArray[np.uint8], right: NDArray[np.uint8], low: int, count: int) -> Pixels:
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=_BLOCK,
        P1=8 * _BLOCK**2,
        P2=32 * _BLOCK**2,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=10,
        speckleWindowSize=left.size // 1000,
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    equalise = cv2.createCLAHE(*_CLAHE)
    found = np.asarray(matcher.compute(equalise.apply(left), equalise.apply(right)), dtype=np.float32) / 16.0
    return np.where(found >= max(low, 1), found, np.float32(np.nan))


def _refined(left: Pixels, right: Pixels, start: Pixels) -> tuple[Pixels, Pixels]:
    """Disparities d with right(u - d) = left(u) up to brightness, by least squares in a window, and their 1-sigma."""
    known = np.isfinite(start)
    mask = known.astype(np.float32)
    first = _mean(np.where(known, start, 0.0), mask, _SMOOTH)
    u, v = np.meshgrid(np.arange(start.shape[1], dtype=np.float32), np.arange(start.shape[0], dtype=np.float32))
    slope_left = cv2.Sobel(left, cv2.CV_32F, 1, 0, ksize=1)
    d = first
    for _ in range(_STEPS):
        seen = cv2.remap(right, u - d, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        slope = 0.25 * (cv2.Sobel(seen, cv2.CV_32F, 1, 0, ksize=1) + slope_left)
        off = seen - left
        mean_slope, mean_off, slopes, offs, both = (
            _mean(x, mask, _WINDOW) for x in (slope, off, slope * slope, off * off, slope * off)
        )
        slopes = np.maximum(slopes - mean_slope**2, _FLAT)
        both -= mean_slope * mean_off
        # ripples finer than the window are seen by none of the windows: they would stay
        d = _mean(d + np.clip(both / slopes, -0.5, 0.5), mask, _SMOOTH)
    unexplained = np.maximum(offs - mean_off**2 - both**2 / slopes, 0.0)
    count = 4.0 * np.pi * _WINDOW**2 * np.maximum(_blur(mask, _WINDOW), _FLAT)  # of equal weights that average as well
    alike = _correlated(off - mean_off - both / slopes * (slope - mean_slope), known)
    sigma = np.sqrt(alike * unexplained / slopes / count)
    good = known & (np.abs(d - first) < _FARTHEST_STEP) & (sigma < _WORST) & (slopes > _FLAT)
    return np.where(good, d, np.float32(np.nan)), np.where(good, sigma, np.float32(np.nan))


def _correlated(left: Pixels, known: NDArray[np.bool_]) -> float:
    """How many neighbouring pixels err alike, by blur, interpolation and compression: of residuals (H, W)."""
    left = np.where(known, left, np.float32(0.0))
    power = float(np.mean(left * left)) or 1.0
    rho = [float(np.mean(a * b)) / power for a, b in ((left[1:], left[:-1]), (left[:, 1:], left[:, :-1]))]
    down, across = np.clip(rho, 0.0, 0.95)  # as of a first-order process
    return float((1.0 + down) / (1.0 - down) * (1.0 + across) / (1.0 - across))


def _mean(x: Pixels, mask: Pixels, sigma: float) -> Pixels:
    """Means weighted by a bell of ``sigma`` pixels, over the pixels of the mask."""
    return np.asarray(_blur(x * mask, sigma) / np.maximum(_blur(mask, sigma), _FLAT), dtype=np.float32)


def _blur(x: Pixels, sigma: float) -> Pixels:
    return np.asarray(cv2.GaussianBlur(x.astype(np.float32), (0, 0), sigma), dtype=np.float32)


def _median(pixels: Pixels, step: int) -> FloatArray:
    rows, columns = (extent // step for extent in pixels.shape)
    cut = pixels[: rows * step, : columns * step].reshape(rows, step, columns, step).swapaxes(1, 2)
    ranked = np.sort(cut.reshape(rows, columns, step * step), axis=2)  # NaN at the end
    known = np.isfinite(ranked).sum(axis=2)
    middle = np.take_along_axis(ranked, np.maximum(known - 1, 0)[..., None] // 2, axis=2)[..., 0]
    return np.where(known >= _FILLED * step * step, middle, np.nan).astype(np.float64)
