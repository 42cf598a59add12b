"""``uwgraph places`` where it cannot work: said in words, with the exit code, and nothing is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commandline import run, told

from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.simulate import SimulationSettings, simulate


@pytest.fixture(scope="module")
def blind(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dive without images."""
    folder = tmp_path_factory.mktemp("places") / "dive"
    write_dive(simulate(SimulationSettings(duration_s=60.0), seed=1), folder)
    return folder


@pytest.mark.parametrize("command", [("match",), ("train", "-o", "m.npz"), ("show",)])
def test_a_dive_without_images(blind: Path, tmp_path: Path, command: tuple[str, ...], monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    told(run("places", command[0], blind, *command[1:]), 2)
    assert not list(tmp_path.iterdir())
    assert read_dive(blind).closures is None


def test_a_model_that_is_none(blind: Path, tmp_path: Path) -> None:
    np.savez(tmp_path / "m.npz", a=np.array([{"x": 1}], dtype=object))
    told(run("places", "match", blind, "--model", tmp_path / "m.npz"), 2)


def test_solutions_are_given_for_all_dives_or_none(blind: Path, tmp_path: Path) -> None:
    told(run("places", "train", blind, blind, "--solution", tmp_path, "-o", tmp_path / "m.npz"), 2, "2 dives", "1 sol")


def test_a_model_is_not_replaced_unasked(blind: Path, tmp_path: Path) -> None:
    (tmp_path / "m.npz").write_bytes(b"mine")
    told(run("places", "train", blind, "-o", tmp_path / "m.npz"), 3, "m.npz", "--force")
    assert (tmp_path / "m.npz").read_bytes() == b"mine"
