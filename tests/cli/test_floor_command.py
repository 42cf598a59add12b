"""uwgraph simulate --floor."""

from pathlib import Path

import pytest
from commandline import run, told

from uwgraph.dive.folder import read_dive

SHORT = ("--pattern", "patrol", "--duration", 50, "--depth", 1, "--seed", 4)


def test_simulate_makes_a_dive_over_a_floor(tmp_path: Path) -> None:
    (tmp_path / "murky.yaml").write_text("water: {turbidity: 1.5}\naltitude: 4\n")
    done = run("simulate", tmp_path / "reef", *SHORT, "--floor", "--floor-rate", 0.015, "--stereo", 0.2,
               "--floor-altitude", 2, "--floor-settings", tmp_path / "murky.yaml")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "images/down_right" in done.stderr
    dive = read_dive(tmp_path / "reef")
    assert len(dive.images["down"]) == len(dive.images["down_right"]) >= 1
    assert dive.altitude is not None
    assert dive.provenance["floor"]["model"]["water"]["turbidity"] == 1.5
    assert dive.provenance["floor"]["model"]["altitude"] == 2.0
    assert dive.provenance["settings"]["speed"] == 0.7
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_a_speed_that_is_asked_for_stays(tmp_path: Path) -> None:
    done = run("simulate", tmp_path / "reef", *SHORT, "--speed", 1.1, "--floor", "--floor-rate", 0.015)
    assert done.returncode == 0, done.stderr
    assert read_dive(tmp_path / "reef").provenance["settings"]["speed"] == 1.1


@pytest.mark.parametrize("options", [("--stereo", 0.2), ("--floor-rate", 1), ("--floor-photos", "photos")])
def test_options_of_the_floor_need_it(tmp_path: Path, options: tuple[object, ...]) -> None:
    told(run("simulate", tmp_path / "reef", *SHORT, *options), 2, "--floor")
    assert not (tmp_path / "reef").exists()


def test_a_missing_folder_of_photos_is_told_and_nothing_is_left(tmp_path: Path) -> None:
    done = run("simulate", tmp_path / "reef", *SHORT, "--floor", "--floor-photos", tmp_path / "none")
    told(done, 3, "none", "photographs")
    assert list(tmp_path.iterdir()) == []
