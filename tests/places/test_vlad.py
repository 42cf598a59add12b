"""Local features and what VLAD makes of them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.decomposition import PCA

from uwgraph.errors import DataError
from uwgraph.places.local import LocalFeatures, LocalSettings, extract
from uwgraph.places.vlad import Vocabulary, as_floats, vlad


def scene(seed: int, shape: tuple[int, int] = (240, 320)) -> np.ndarray:
    """Random discs: corners and blobs in plenty."""
    rng = np.random.default_rng(seed)
    image = np.full(shape, 120, np.uint8)
    for _ in range(250):
        centre = (int(rng.integers(shape[1])), int(rng.integers(shape[0])))
        cv2.circle(image, centre, int(rng.integers(2, 14)), int(rng.integers(255)), -1)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


@pytest.mark.parametrize("kind", ["sift", "orb"])
def test_features_are_spread_and_the_same_again(kind: str) -> None:
    image = scene(0)
    image[:, 160:] = np.clip(128.0 + 0.25 * (image[:, 160:].astype(float) - 128.0), 0, 255).astype(np.uint8)
    wanted = LocalSettings(kind=kind, limit=160, rows=4, columns=4)
    found = extract(image, wanted)
    again = extract(image, wanted)
    np.testing.assert_array_equal(found.uv, again.uv)
    np.testing.assert_array_equal(found.descriptors, again.descriptors)
    assert 100 < len(found) <= 160
    assert np.mean(found.uv[:, 0] > 160) > 0.25  # the dull half has its share


def test_root_sift_has_unit_length() -> None:
    found = extract(scene(1))
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1.0, atol=1e-5)


def test_pixels_are_those_of_the_image_as_given() -> None:
    """A blob keeps its place though the image is reduced to a third."""
    image = np.full((900, 1200), 60, np.uint8)
    cv2.ellipse(image, (700, 300), (30, 26), 20, 0, 360, 220, -1)
    small = extract(image, LocalSettings(max_side=400))
    distance = np.linalg.norm(small.uv - [700.0, 300.0], axis=1)
    assert distance.min() < 1.5


def test_masked_pixels_have_no_features() -> None:
    mask = np.full((240, 320), 255, np.uint8)
    mask[:, :160] = 0
    found = extract(scene(2), mask=mask)
    assert len(found) > 50
    assert found.uv[:, 0].min() > 158.0


@pytest.mark.parametrize("kind", ["sift", "orb"])
@pytest.mark.parametrize("shape", [(1, 1), (5, 400), (16, 16), (400, 3), (33, 64)])
def test_images_without_features_have_none(kind: str, shape: tuple[int, int]) -> None:
    found = extract(np.full(shape, 90, np.uint8), LocalSettings(kind=kind))
    assert len(found) == 0
    assert found.descriptors.shape[0] == 0


def clusters(seed: int, n: int = 300, d: int = 128) -> LocalFeatures:
    rng = np.random.default_rng(seed)
    centres = np.random.default_rng(99).normal(size=(8, d))
    x = (centres[rng.integers(8, size=n)] + 0.2 * rng.normal(size=(n, d))).astype(np.float32)
    return LocalFeatures(rng.uniform(0, 100, (n, 2)), x)


def vocabulary(words: np.ndarray) -> Vocabulary:
    """Of words along the first axes of descriptors of 128 numbers."""
    axes = np.eye(words.shape[1], 128, dtype=np.float32)
    return Vocabulary(np.zeros(128, np.float32), axes, words.astype(np.float32))


def test_descriptors_are_reduced_as_by_pca() -> None:
    features = [clusters(0), clusters(1)]
    words, x = Vocabulary.learn(features, 8, 5), clusters(2)
    pca = PCA(5, svd_solver="full").fit(np.concatenate([f.descriptors for f in features]))
    np.testing.assert_allclose(np.abs(words.reduce(x)), np.abs(pca.transform(x.descriptors)), atol=1e-3)
    assert (words.words.shape, words.size) == ((8, 5), 40)


def test_vlad_is_the_sum_of_residuals_by_word() -> None:
    words = Vocabulary.learn([clusters(0), clusters(1)], 8, 16)
    x = clusters(2)
    found = vlad(x, words)
    assert found is not None
    reduced = (x.descriptors - words.mean) @ words.axes.T
    nearest = np.argmin(((reduced[:, None] - words.words) ** 2).sum(2), axis=1)
    by_word = np.zeros_like(words.words, dtype=np.float64)
    for word, descriptor in zip(nearest, reduced, strict=True):
        by_word[word] += descriptor - words.words[word]
    by_word /= np.linalg.norm(by_word, axis=1, keepdims=True)
    expected = np.sign(by_word) * np.sqrt(np.abs(by_word))
    np.testing.assert_allclose(found, expected.ravel() / np.linalg.norm(expected), atol=1e-4)


@given(seed=st.integers(0, 1000), n=st.integers(1, 60))
@settings(max_examples=30, deadline=None)
def test_vlad_has_unit_length_in_any_order_of_features(seed: int, n: int) -> None:
    words = vocabulary(np.random.default_rng(1).normal(size=(6, 32)))
    x = clusters(seed, n)
    found = vlad(x, words)
    assert found is not None
    assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-5)
    order = np.random.default_rng(seed).permutation(n)
    shuffled = vlad(LocalFeatures(x.uv[order], x.descriptors[order]), words)
    np.testing.assert_allclose(shuffled, found, atol=1e-3)


def test_a_feature_on_its_word_and_no_feature_at_all() -> None:
    words = vocabulary(np.eye(4, 16))
    assert vlad(LocalFeatures(np.zeros((2, 2)), np.eye(2, 128, dtype=np.float32)), words) is None
    assert vlad(LocalFeatures(np.zeros((0, 2)), np.zeros((0, 128), np.float32)), words) is None


def test_the_vocabulary_is_the_same_again_and_needs_features() -> None:
    features = [clusters(3), clusters(4)]
    once, twice = Vocabulary.learn(features, 8), Vocabulary.learn(features, 8)
    np.testing.assert_array_equal(once.axes, twice.axes)
    np.testing.assert_array_equal(once.words, twice.words)
    with pytest.raises(DataError, match="too few"):
        Vocabulary.learn([clusters(5, 10)], 8)
    with pytest.raises(DataError, match="too few"):
        Vocabulary.learn([clusters(5, 100)], 8, 64)
    with pytest.raises(DataError, match="too few"):
        Vocabulary.learn([], 8)


def test_bits_count_as_numbers_and_other_features_are_refused() -> None:
    bits = np.array([[0b10000001, 255]], np.uint8)
    np.testing.assert_array_equal(as_floats(bits)[0], [1, 0, 0, 0, 0, 0, 0, 1] + [1] * 8)
    words = Vocabulary.learn([clusters(0)], 4)
    with pytest.raises(DataError, match="SIFT or ORB"):
        vlad(extract(scene(3), LocalSettings(kind="orb")), words)
