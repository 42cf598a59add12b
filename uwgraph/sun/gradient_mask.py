"""Which pixels show clear sky: not the sun's disc, a glint, an occluder, or anything overexposed."""

from __future__ import annotations

import cv2
import numpy as np

from uwgraph.types import BoolArray, FloatArray

RING = np.radians(2.0)
"""Width of the zenith rings in which an occluder is told by its darkness, rad."""
DARK_SHARE = 0.1
"""An occluder is darker than this times the 80 % quantile of its ring; clear sky opposite a low sun reaches 0.2."""
DROP = 0.5
"""The edge of an occluder is darker than this times the brightest pixel near it."""
ROUGH, ROUGHER = 0.08, 5.0
"""Mean absolute Laplacian of ln L from which a pixel is no sky, and how many times its lower quartile that must be."""
MOST_CUT_OFF = 0.6
"""Of the sky in view, by edges: what is larger was not closed off by them."""
ISLAND = 0.1
"""Regions smaller than this times the largest are not used."""
SPOT_RATIO = 1.5
"""The sun's disc and glints outshine the median of their surroundings by more than this."""
SPOT_SURROUNDINGS = 15
"""Width of those surroundings, binned pixels."""


def clear_sky(log_l: FloatArray, zenith: FloatArray, sky: BoolArray, lost: BoolArray) -> BoolArray:
    """Pixels of ``sky`` that show it, ``lost`` being known not to; ln of the radiance, zenith angle, all (H, W)."""
    for test in (bright_spots, rough, darker_than_its_ring, behind_edges):
        rest = sky & ~lost
        if not rest.any():
            return rest
        lost = lost | test(log_l, zenith, rest)
    return connected(sky & ~dilated(lost, 1.5))


def darker_than_its_ring(log_l: FloatArray, zenith: FloatArray, sky: BoolArray) -> BoolArray:
    """Pixels much darker than the bright part of their zenith ring."""
    ring = (zenith[sky] / RING).astype(np.intp)
    values = log_l[sky]
    order = np.lexsort((values, ring))
    count = np.bincount(ring)
    first = np.cumsum(count) - count
    bright = values[order][np.minimum(first + (0.8 * count).astype(np.intp), len(order) - 1)]
    dark = np.zeros_like(sky)
    dark[sky] = values < bright[ring] + np.log(DARK_SHARE)
    return dark


def behind_edges(log_l: FloatArray, zenith: FloatArray, sky: BoolArray) -> BoolArray:
    """The dark side of sharp edges, and whole regions that such edges cut off from brighter sky."""
    drop = cv2.dilate(np.where(sky, log_l, -np.inf), np.ones((5, 5), np.uint8)) - np.where(sky, log_l, np.inf)
    edge = drop > np.log(1.0 / DROP)
    if not edge.any():
        return np.asarray(edge)
    count, region = cv2.connectedComponents((sky & ~edge).astype(np.uint8), connectivity=4)
    rim = dilated(edge, 1.0) & (region > 0)
    fall = cv2.dilate(np.where(sky, log_l, -np.inf), np.ones((9, 9), np.uint8)) - np.where(sky, log_l, np.inf)
    area, length = np.bincount(region.ravel(), minlength=count), np.bincount(region[rim], minlength=count)
    under = np.bincount(region[rim], fall[rim] > np.log(1.0 / DROP), minlength=count)
    cut_off = (under > 0.5 * length) & (under > np.sqrt(area)) & (area < MOST_CUT_OFF * sky.sum())
    cut_off[0] = False
    return np.asarray(edge | cut_off[region])


def rough(log_l: FloatArray, zenith: FloatArray, sky: BoolArray) -> BoolArray:
    """Where neighbours differ far more than a smooth sky, or the waves over most of it, makes them."""
    filled = np.where(sky, log_l, smoothed(log_l, sky, 2.0)[0])
    bend = np.abs(cv2.Laplacian(filled, cv2.CV_64F))
    local, _ = smoothed(bend, sky & ~dilated(~sky, 1.0), 1.5)
    return np.asarray(sky & (local > max(ROUGH, ROUGHER * float(np.quantile(local[sky], 0.25)))))


def bright_spots(log_l: FloatArray, zenith: FloatArray, sky: BoolArray) -> BoolArray:
    """Compact pixels far brighter than the median around them: the sun's disc and glints."""
    low, high = log_l[sky].min(), log_l[sky].max()
    scale = 254.0 / max(high - low, 1e-9)  # OpenCV's wide median takes bytes only
    around, _ = smoothed(log_l, sky, SPOT_SURROUNDINGS / 3.0)  # beyond the edge, so that it draws no median down
    levels = (np.where(sky, log_l, np.clip(around, low, high)) - low) * scale
    excess = (levels - cv2.medianBlur(levels.astype(np.uint8), SPOT_SURROUNDINGS)) / scale
    return np.asarray(sky & (excess > np.log(SPOT_RATIO) + 1.0 / scale))


def connected(mask: BoolArray) -> BoolArray:
    """The mask without islands: what shows of an occluder that is partly as bright as the sky."""
    count, region, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    if count < 3:
        return mask
    area = stats[:, cv2.CC_STAT_AREA].astype(np.float64)
    area[0] = 0.0
    return np.asarray((area >= ISLAND * area.max())[region])


def dilated(mask: BoolArray, radius: float) -> BoolArray:
    """The mask grown by a disc of ``radius`` pixels."""
    size = 2 * int(np.ceil(radius)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return np.asarray(cv2.dilate(mask.astype(np.uint8), kernel) > 0)


def smoothed(values: FloatArray, mask: BoolArray, sd: float) -> tuple[FloatArray, FloatArray]:
    """Gaussian mean (H, W) over the pixels of the mask alone, and the share of the kernel that it had.

    Normalized convolution (Knutsson & Westin, CVPR 1993).
    """
    weight = mask.astype(np.float64)
    share = cv2.GaussianBlur(weight, (0, 0), sd)
    total = cv2.GaussianBlur(np.where(mask, values, 0.0), (0, 0), sd)
    return np.asarray(total / np.maximum(share, 1e-6), dtype=np.float64), np.asarray(share, dtype=np.float64)
