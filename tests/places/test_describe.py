"""Images as vectors, or as no descriptor at all."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.signal import correlate
from tiny_onnx import write_tiny_onnx

from uwgraph.errors import DataError
from uwgraph.places.deep import OnnxDescriber, OnnxSettings
from uwgraph.places.describe import Describer, DescriberSettings, VladDescriber, describe_all
from uwgraph.places.local import LocalSettings
from uwgraph.places.vlad import Vocabulary

SETTINGS = DescriberSettings(local=LocalSettings(limit=150))


def scene(seed: int, shape: tuple[int, int] = (200, 260)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = np.full((*shape, 3), 110, np.uint8)
    for _ in range(160):
        centre = (int(rng.integers(shape[1])), int(rng.integers(shape[0])))
        cv2.circle(image, centre, int(rng.integers(2, 12)), tuple(int(c) for c in rng.integers(40, 220, 3)), -1)
    return image


@pytest.fixture(scope="module")
def vlad() -> VladDescriber:
    return VladDescriber.learn([scene(i) for i in range(6)], SETTINGS)


@pytest.fixture
def network(tmp_path: Path) -> OnnxDescriber:
    return OnnxDescriber.open(OnnxSettings(path=str(write_tiny_onnx(tmp_path / "t.onnx")), width=64, height=48))


def test_the_same_place_is_nearer_than_others(vlad: VladDescriber) -> None:
    """Seen again shifted, darker and with noise, among 24."""
    places = [scene(i, (240, 300)) for i in range(10, 34)]
    rng = np.random.default_rng(0)
    first = [vlad.describe(p[:200, :260]) for p in places]
    again = [
        np.clip(0.6 * p[20:220, 15:275] + rng.normal(0, 4, (200, 260, 3)), 0, 255).astype(np.uint8) for p in places
    ]
    second = [vlad.describe(p) for p in again]
    likeness = np.array(first) @ np.array(second).T
    assert np.mean(likeness.argmax(axis=1) == np.arange(24)) >= 0.8


BLANKS = {
    "black": np.zeros((200, 260, 3), np.uint8),
    "grey": np.full((200, 260), 128, np.uint8),
    "one pixel": np.full((1, 1), 9, np.uint8),
    "a line": np.full((1, 500, 3), 40, np.uint8),
    "16 bits": np.full((30, 20), 60_000, np.uint16),
    "a ramp": np.tile(np.linspace(0, 255, 300).astype(np.uint8), (200, 1)),
}


@pytest.mark.parametrize("kind", ["sift", "orb"])
@pytest.mark.parametrize("name", BLANKS)
@pytest.mark.parametrize("enhancement", ["none", "normalise", "descatter"])
def test_nothing_to_see_is_no_descriptor(kind: str, name: str, enhancement: str) -> None:
    settings = DescriberSettings(words=4, local=LocalSettings(kind=kind), enhancement=enhancement)
    width = settings.local.width
    arrays = np.zeros(width), np.eye(64, width), np.eye(4, 64)
    describer = VladDescriber(Vocabulary(*(array.astype(np.float32) for array in arrays)), settings)
    assert describer.describe(BLANKS[name]) is None


def test_few_features_are_no_descriptor(vlad: VladDescriber) -> None:
    image = np.full((200, 260), 90, np.uint8)
    cv2.circle(image, (100, 100), 9, 200, -1)
    assert vlad.describe(image) is None


def test_many_images_in_turn(vlad: VladDescriber) -> None:
    images = [scene(3), BLANKS["black"], scene(4)]
    told: list[float] = []
    X, found = describe_all(vlad, [lambda i=i: i for i in images], progress=told.append)
    np.testing.assert_array_equal(found, [True, False, True])
    np.testing.assert_array_equal(X[0], vlad.describe(scene(3)))
    assert not np.any(X[1])
    assert told == pytest.approx([1 / 3, 2 / 3, 1.0])


def test_the_mask_hides(vlad: VladDescriber, network: OnnxDescriber) -> None:
    """What is written into the hidden corner does not matter."""
    image, mask = scene(5), np.full((200, 260), 255, np.uint8)
    mask[:40, :200] = 0
    written = image.copy()
    cv2.putText(written, "13:42:17", (5, 25), cv2.FONT_HERSHEY_SIMPLEX, 0.8, (255, 255, 255), 2)
    describers: tuple[Describer, ...] = (vlad, network)
    for describer in describers:
        plain, other = describer.describe(image, mask), describer.describe(written, mask)
        assert plain is not None
        assert other is not None
        assert plain @ other > 0.9999
        assert plain @ other > plain @ describer.describe(written)


def test_a_network_is_run_as_it_is(network: OnnxDescriber) -> None:
    image = scene(6)
    small = cv2.resize(image, (64, 48), interpolation=cv2.INTER_AREA)[..., ::-1] / 255.0
    x = ((small - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]).transpose(2, 0, 1)
    w = np.random.default_rng(0).normal(size=(12, 3, 3, 3)).astype(np.float32)
    y = [np.maximum(sum(correlate(x[c], w[o, c], "valid") for c in range(3)), 0.0).mean() for o in range(12)]
    np.testing.assert_allclose(network.describe(image), y / np.linalg.norm(y), atol=1e-5)
    assert network.size == 12


@pytest.mark.parametrize("name", BLANKS)
def test_a_network_sees_no_place_in_a_blank(network: OnnxDescriber, name: str) -> None:
    found = network.describe(BLANKS[name])
    assert found is None or name == "a ramp"


def test_grey_and_deep_images_are_given_to_the_network(network: OnnxDescriber) -> None:
    colour = scene(7)
    grey = cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)
    assert network.describe(grey) @ network.describe(cv2.merge([grey] * 3)) > 0.999
    assert network.describe(colour.astype(np.uint16) << 8) @ network.describe(colour) > 0.999


@pytest.mark.parametrize("content", [b"", b"junk" * 50, None])
def test_what_is_no_network_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "bad.onnx"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(DataError, match=r"bad\.onnx"):
        OnnxDescriber.open(OnnxSettings(path=str(path)))


def test_a_network_of_unknown_operators_or_cut_off_is_refused(tmp_path: Path) -> None:
    path = write_tiny_onnx(tmp_path / "bad.onnx", op="Nonsense")
    with pytest.raises(DataError, match="plain operators"):
        OnnxDescriber.open(OnnxSettings(path=str(path), width=64, height=48))
    path.write_bytes(write_tiny_onnx(path).read_bytes()[:300])
    with pytest.raises(DataError, match="OpenCV can run"):
        OnnxDescriber.open(OnnxSettings(path=str(path), width=64, height=48))
