"""Real recordings: what goes through import and export comes out as the source has it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from evo.tools import file_interface
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from uwgraph.cli.source import load_dive
from uwgraph.export import export, source_of_dive

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[2].parent / "shared" / "data"))


def recording(*parts: str) -> Path:
    path = DATA.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"no {path}: set UWGRAPH_DATA to the folder of the recordings")
    return path


@pytest.mark.data
def test_euroc_comes_out_as_it_went_in(tmp_path: Path) -> None:
    """Position (the floor is put at 10 m depth on the way in), attitude and velocity of the source's own file."""
    folder = recording("euroc")
    dive = load_dive(folder)
    export(source_of_dive(dive, "euroc"), tmp_path / "a.csv", "euroc")
    source = pd.read_csv(next(folder.glob("*.csv"))).to_numpy()
    ours = pd.read_csv(tmp_path / "a.csv").to_numpy()
    np.testing.assert_allclose(ours[:, 1:4] + [0.0, 0.0, 10.0], source[:, 1:4], atol=1e-6)
    turn = Rotation.from_quat(ours[:, 4:8], scalar_first=True).inv() * Rotation.from_quat(
        source[:, 4:8], scalar_first=True
    )
    assert turn.magnitude().max() < 1e-7
    np.testing.assert_allclose(ours[:, 8:11], source[:, 8:11], atol=1e-6)
    stamps = [int(line.partition(",")[0]) for line in (tmp_path / "a.csv").read_text().splitlines()[1:]]
    assert dive.reference is not None
    assert stamps == dive.reference.t_ns.tolist()
    assert dive.imu is not None


@pytest.mark.data
def test_snapir_goes_to_evo_and_to_mcap(tmp_path: Path) -> None:
    dive = load_dive(recording("snapir", "Trajectory1"))
    export(source_of_dive(dive, "run1"), tmp_path / "a.tum", frame="enu")
    track = file_interface.read_tum_trajectory_file(tmp_path / "a.tum")
    assert track.check()[0]
    assert dive.reference is not None
    assert track.path_length == pytest.approx(761.4, abs=1.0)
    made = export(source_of_dive(dive, "run1", None), tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == made.count > 40_000
    topics = {channel.topic for channel in summary.channels.values()}
    assert {"/imu", "/dvl", "/depth", "/tf", "/reference/pose", "/reference/location"} <= topics
