"""Matching of textures that are shifted by known parts of a pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uwgraph.seafloor.disparity import blocks, match

H, W = 160, 240


def textured(noise: float = 1.5, shift: float = 20.3, slope: float = 0.02, contrast: float = 20.0):
    """A left and a right image, and the disparity of the left one: a slanted plane, brightness changed."""
    rng = np.random.default_rng(3)
    spots = sum(cv2.resize(rng.normal(size=(H // s, 2 * W // s)).astype(np.float32), (2 * W, H)) for s in (1, 2, 4, 8))
    scene = cv2.GaussianBlur(110.0 + contrast * spots, (0, 0), 1.0).astype(np.float32)
    u, v = np.meshgrid(np.arange(W, dtype=np.float32), np.arange(H, dtype=np.float32))
    truth = shift + slope * (v - H / 2)
    left = cv2.remap(scene, u + 60.0, v, cv2.INTER_CUBIC)
    right = cv2.remap(scene, u + 60.0 + truth, v, cv2.INTER_CUBIC)  # rows are level: d depends on v alone
    return picture(left, noise, rng), picture(0.9 * right + 8.0, noise, rng), truth


def picture(grey: NDArray[np.float32], noise: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    levels = np.clip(grey + rng.normal(0.0, noise, grey.shape), 0, 255).astype(np.uint8)
    return np.repeat(levels[..., None], 3, axis=2)


@pytest.mark.parametrize("shift", [20.0, 20.25, 20.5, 20.8])
def test_parts_of_a_pixel_are_found_and_sigma_says_how_well(shift: float) -> None:
    left, right, truth = textured(shift=shift)
    found, sigma = match(left, right, 8, 32)
    inner = np.s_[15:-15, 60:-15]
    known = np.isfinite(found[inner])
    error = (found - truth)[inner][known]
    assert known.mean() > 0.95
    assert np.sqrt(np.mean(error**2)) < 0.08
    assert abs(error.mean()) < 0.01
    assert 0.4 < np.sqrt(np.mean((error / sigma[inner][known]) ** 2)) < 2.0


def test_less_contrast_is_less_sure() -> None:
    clear, faint = (match(*textured(contrast=c)[:2], 8, 32)[1] for c in (20.0, 4.0))
    assert np.nanmedian(faint) > 2.5 * np.nanmedian(clear)


def test_nothing_is_found_where_there_is_nothing() -> None:
    flat = np.full((H, W, 3), 90, dtype=np.uint8)
    assert not np.isfinite(match(flat, flat, 8, 32)[0]).any()
    left, right, _ = textured()
    assert np.isfinite(match(left, right[::-1].copy(), 8, 32)[0]).mean() < 0.2


def test_blocks_are_medians_of_what_is_known() -> None:
    values = np.arange(36, dtype=np.float32).reshape(6, 6)
    values[0, 0] = np.nan
    values[3:6, 3:6] = np.nan
    values[4, 4] = 1.0
    middle, sigma = blocks(values, values, 3)
    assert middle.shape == (2, 2)
    assert middle[0, 1] == 10.0
    assert middle[0, 0] == np.sort(values[:3, :3].ravel())[(8 - 1) // 2]
    assert np.isnan(middle[1, 1])  # one of nine
    assert np.array_equal(sigma, middle, equal_nan=True)
