"""Grey images in which the scene counts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from uwgraph.errors import ConfigError
from uwgraph.places.enhance import enhance, scene_mask, without_polarized_veil

HOWS = ("none", "clahe", "normalise", "descatter")


def texture(seed: int, shape: tuple[int, int] = (120, 160)) -> np.ndarray:
    """Blobs of a few pixels, 0 to 255."""
    import cv2

    noise = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(128.0 + 60.0 * smooth / smooth.std(), 0.0, 255.0).astype(np.uint8)


@pytest.mark.parametrize("how", HOWS)
@given(
    image=arrays.arrays(
        st.sampled_from([np.uint8, np.uint16]),
        st.one_of(
            st.tuples(st.integers(1, 40), st.integers(1, 40)),
            st.tuples(st.integers(1, 40), st.integers(1, 40), st.sampled_from([1, 3])),
        ),
        fill=st.integers(0, 255),
    )
)
@settings(max_examples=25, deadline=None)
def test_any_counts_become_grey_of_the_same_size(how: str, image: np.ndarray) -> None:
    grey = enhance(image, how)
    assert grey.dtype == np.uint8
    assert grey.shape == image.shape[:2]


@pytest.mark.parametrize("how", ["clahe", "normalise", "descatter"])
def test_the_scene_is_alike_under_another_lamp(how: str) -> None:
    scene = texture(0, (240, 320)).astype(float)
    v, u = np.mgrid[:240, :320]

    def under_lamp(u0: float, v0: float, veil: float) -> np.ndarray:
        lamp = np.exp(-((u - u0) ** 2 + (v - v0) ** 2) / 180.0**2)
        return np.clip(scene * 0.4 * lamp + veil * lamp, 0, 255).astype(np.uint8)

    left, right = under_lamp(60, 60, 40.0), under_lamp(260, 180, 70.0)

    def likeness(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])

    assert likeness(enhance(left, how), enhance(right, how)) > likeness(left, right) + 0.15


def test_sixteen_bits_are_scaled_to_eight() -> None:
    grey = texture(1)
    wide = enhance((grey.astype(np.uint16) << 4) + 300, "none")
    assert np.corrcoef(grey.ravel(), wide.ravel())[0, 1] > 0.99
    assert wide.min() == 0
    assert wide.max() == 255


def test_a_polarized_veil_is_taken_off() -> None:
    """A veil that grows to one side, polarized by a third along 25 degrees, over an unpolarized scene."""
    scene = texture(2).astype(np.float64)
    veil = np.linspace(0.0, 900.0, scene.shape[1])[None, :] * np.ones((scene.shape[0], 1))
    axis, degree = np.radians(25.0), 1.0 / 3.0
    stokes = np.stack(
        [scene + veil, degree * veil * np.cos(2 * axis), degree * veil * np.sin(2 * axis)], axis=2
    ) + np.random.default_rng(0).normal(0.0, 0.3, (*scene.shape, 3))

    found = without_polarized_veil(stokes)

    before = np.corrcoef((scene + veil).ravel(), scene.ravel())[0, 1]
    after = np.corrcoef(found.ravel(), scene.ravel())[0, 1]
    assert before < 0.5
    assert after > 0.85
    assert enhance(stokes, "polarization").shape == scene.shape


def test_unpolarized_light_passes() -> None:
    scene = texture(3).astype(np.float32)
    stokes = np.stack([scene, np.zeros_like(scene), np.zeros_like(scene)], axis=2)
    np.testing.assert_array_equal(without_polarized_veil(stokes), scene)


@pytest.mark.parametrize(
    ("image", "how"),
    [
        (np.zeros((8, 8), np.float32), "clahe"),
        (np.zeros((8, 8, 2), np.uint8), "clahe"),
        (np.zeros((0, 8), np.uint8), "clahe"),
        (np.zeros(8, np.uint8), "clahe"),
        (np.zeros((8, 8), np.uint8), "polarization"),
        (np.zeros((8, 8), np.uint8), "sharpen"),
    ],
)
def test_what_is_no_image_is_refused(image: np.ndarray, how: str) -> None:
    with pytest.raises(ConfigError, match="remedy"):
        enhance(image, how)


def passing_by(n: int, clock: bool) -> list[np.ndarray]:
    """A wide scene that moves by, with a clock burned in whose last digit counts."""
    import cv2

    wide = texture(4, (120, 160 + 37 * n))
    images = []
    for i in range(n):
        image = wide[:, 37 * i : 37 * i + 160].copy()
        if clock:
            cv2.putText(image, f"13:41:0{i % 10}", (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, 255, 1)
        images.append(image)
    return images


def test_burned_in_text_is_masked_and_the_scene_is_not() -> None:
    mask = scene_mask(passing_by(30, clock=True))
    assert mask is not None
    assert np.mean(mask[6:14, 6:50] == 0) > 0.9
    assert np.mean(mask[30:] == 0) < 0.02


def test_without_an_overlay_nothing_is_masked() -> None:
    mask = scene_mask(passing_by(30, clock=False))
    assert mask is not None
    assert np.mean(mask == 0) < 0.01


def test_a_vehicle_that_stands_still_or_few_images_give_no_mask() -> None:
    assert scene_mask([texture(5)] * 30) is None
    assert scene_mask(passing_by(10, clock=True)) is None
    assert scene_mask([]) is None
