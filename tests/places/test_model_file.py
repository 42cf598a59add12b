"""Models of places on disk, and what is no such file."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tiny_onnx import write_tiny_onnx

from uwgraph.errors import DataError, UwgraphError
from uwgraph.places.deep import OnnxDescriber, OnnxSettings
from uwgraph.places.describe import DescriberSettings, VladDescriber
from uwgraph.places.local import LocalSettings
from uwgraph.places.metric import Metric
from uwgraph.places.model_file import PlaceModel
from uwgraph.places.vlad import Vocabulary

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 255, (96, 128, 3)).astype(np.uint8)


def normal(*shape: int) -> NDArray[np.float32]:
    return RNG.normal(size=shape).astype(np.float32)


def metric(size: int, p: int = 5) -> Metric:
    return Metric(normal(size), normal(p, size), normal(p, p), 1.5)


def vlad_model(kind: str = "sift") -> PlaceModel:
    settings = DescriberSettings(words=4, components=8, local=LocalSettings(kind=kind, limit=100))
    words = Vocabulary(normal(settings.local.width), normal(8, settings.local.width), normal(4, 8))
    return PlaceModel(VladDescriber(words, settings), metric(words.size))


@pytest.mark.parametrize("kind", ["sift", "orb"])
def test_a_model_is_the_same_after_disk(tmp_path: Path, kind: str) -> None:
    model = vlad_model(kind)
    model.save(tmp_path / "m.npz")
    again = PlaceModel.load(tmp_path / "m.npz")
    z = model.describe(IMAGE)
    assert z is not None
    assert z.shape == (model.size,) == (32,)
    np.testing.assert_array_equal(again.describe(IMAGE), z)


def test_a_network_is_found_again_or_missed(tmp_path: Path) -> None:
    network = write_tiny_onnx(tmp_path / "tiny.onnx")
    describer = OnnxDescriber.open(OnnxSettings(path=str(network), width=64, height=48))
    model = PlaceModel(describer, metric(describer.size))
    model.save(tmp_path / "m.npz")
    np.testing.assert_array_equal(PlaceModel.load(tmp_path / "m.npz").describe(IMAGE), model.describe(IMAGE))
    write_tiny_onnx(network, features=13)
    with pytest.raises(DataError, match="another network"):
        PlaceModel.load(tmp_path / "m.npz")
    network.unlink()
    with pytest.raises(DataError, match="check the path"):
        PlaceModel.load(tmp_path / "m.npz")


@pytest.mark.parametrize(
    "change",
    [
        {"words": np.zeros((4, 9), np.float32)},
        {"words": np.zeros((5, 8), np.float32)},
        {"words": np.full((4, 8), np.inf, np.float32)},
        {"local_mean": np.zeros(64, np.float32)},
        {"local_axes": np.zeros((8, 64), np.float32)},
        {"local_axes": None},
        {"mean": np.zeros(3, np.float32)},
        {"change": np.zeros((4, 5), np.float32)},
        {"change": np.full((5, 5), np.nan, np.float32)},
        {"scale": np.array(np.inf)},
        {"scale": np.array(0.0)},
        {"scale": np.array([1.0])},
        {"components": None},
        {"describer": np.array("cnn")},
        {"settings": np.array('{"words": 4, "colour": 1}')},
        {"settings": np.array("[" * 100_000)},
        {"what": np.array("uwgraph topological map")},
        {"what": None},
    ],
)
def test_a_model_that_contradicts_itself_is_refused(tmp_path: Path, change: dict[str, np.ndarray | None]) -> None:
    vlad_model().save(tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz") as file:
        arrays = {name: file[name] for name in file.files} | change
    np.savez(tmp_path / "bad.npz", **{name: a for name, a in arrays.items() if a is not None})
    with pytest.raises(UwgraphError, match=r"bad\.npz"):
        PlaceModel.load(tmp_path / "bad.npz")


def test_pickles_junk_and_bombs_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "bad.npz"
    for content in (b"", b"junk" * 100, b"PK\x03\x04" + bytes(100)):
        file.write_bytes(content)
        with pytest.raises(DataError, match=r"bad\.npz"):
            PlaceModel.load(file)
    np.savez(file, what=np.array([{"a": 1}], dtype=object))
    with pytest.raises(DataError, match="cannot be read"):
        PlaceModel.load(file)
    with pytest.raises(DataError, match="cannot be read"):
        PlaceModel.load(tmp_path / "none.npz")
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("words.npy", bytes(10_000_000))
    with pytest.raises(DataError, match="unpacks to"):
        PlaceModel.load(file)


def test_a_model_cut_off_is_refused(tmp_path: Path) -> None:
    vlad_model().save(tmp_path / "m.npz")
    whole = (tmp_path / "m.npz").read_bytes()
    for share in (0.1, 0.5, 0.99):
        (tmp_path / "bad.npz").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(DataError, match=r"bad\.npz"):
            PlaceModel.load(tmp_path / "bad.npz")
