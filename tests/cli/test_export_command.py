"""``uwgraph export`` from outside: exit codes, words, and what is left on the disk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run, started, told
from mcap.reader import make_reader

from uwgraph.dive.folder import write_dive
from uwgraph.evaluate import write_solution
from uwgraph.export import read_result
from uwgraph.simulate import SimulationSettings, simulate
from uwgraph.types import Solution


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A dive, the same without a reference, and a result that is its truth."""
    place = tmp_path_factory.mktemp("export")
    dive = simulate(SimulationSettings(duration_s=30.0), seed=1)
    write_dive(dive, place / "dive")
    write_dive(replace(dive, reference=None, fixes=None), place / "blind")
    count = 30
    t_ns = 1_700_000_000_000_000_000 + np.arange(count) * 10**9
    eye = np.tile(np.eye(3), (count, 1, 1))
    track = np.arange(count)[:, None] * [1.0, 0.5, 0.1]
    zero = np.zeros((count, 3))
    cov = np.tile(np.eye(6) * 1e-4, (count, 1, 1))
    solution = Solution(
        dive.origin, t_ns, eye, track, np.diff(track, axis=0, append=track[-1:]), zero, zero, cov, cov[:, :3, :3], cov
    )
    write_solution(solution, place / "result", {}, {}, "")
    return place / "dive", place / "blind", place / "result"


def test_every_suffix_makes_its_file(folders: tuple[Path, Path, Path], tmp_path: Path) -> None:
    _, _, result = folders
    for name in ("a.tum", "a.kitti", "a.mcap", "a.geojson", "a.KML", "a.csv"):
        done = run("export", result, "-o", tmp_path / name)
        told(done, 0, name, name.partition(".")[2].lower())
        assert (tmp_path / name).stat().st_size > 1000
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        ["a.tum", "a.kitti", "a_times.txt", "a.mcap", "a.geojson", "a.KML", "a.csv"]
    )
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 4 * len(read_result(result)) + 1


def test_a_dive_its_reference_its_fixes_and_the_whole(folders: tuple[Path, Path, Path], tmp_path: Path) -> None:
    dive, blind, _ = folders
    told(
        run("export", dive, "-o", tmp_path / "a.txt", "--format", "tum", "--frame", "enu", "--rate", 1), 0, "ENU world"
    )
    assert 29 <= len((tmp_path / "a.txt").read_text().splitlines()) - 2 <= 31
    told(run("export", dive, "-o", tmp_path / "a.kml", "--stream", "fixes"), 0, "a.kml")
    told(run("export", blind, "-o", tmp_path / "blind.mcap"), 0, "messages")
    told(run("export", dive, "-o", tmp_path / "asl", "--format", "euroc"), 0, "asl")
    assert (tmp_path / "asl/mav0/imu0/data.csv").is_file()


def test_a_taken_file_needs_force(folders: tuple[Path, Path, Path], tmp_path: Path) -> None:
    _, _, result = folders
    (tmp_path / "a.kml").write_text("mine")
    told(run("export", result, "-o", tmp_path / "a.kml"), 2, "a.kml", "already there", "--force")
    assert (tmp_path / "a.kml").read_text() == "mine"
    told(run("export", result, "-o", tmp_path / "a.kml", "--force"), 0)
    assert (tmp_path / "a.kml").read_text() != "mine"
    (tmp_path / "b.kml").mkdir()
    told(run("export", result, "-o", tmp_path / "b.kml", "--force"), 2, "something else")


def test_usage_errors(folders: tuple[Path, Path, Path], tmp_path: Path) -> None:
    dive, _, result = folders
    told(run("export", result, "-o", tmp_path / "a.txt"), 2, "'.txt'", ".tum", "--format")
    told(run("export", result, "-o", tmp_path / "a"), 2, "suffix", "--format")
    told(run("export", result, "-o", tmp_path / "a.kml", "--frame", "enu"), 2, "--frame")
    told(run("export", result, "-o", tmp_path / "a.kml", "--stream", "fixes"), 2, "--stream")
    told(run("export", dive, "-o", tmp_path / "a.mcap", "--stream", "fixes"), 2, "--stream")
    told(run("export", dive, "-o", tmp_path / "a.kml", "--format", "gpx"), 2, "gpx")
    told(run("export", result, "-o", tmp_path / "a.kml", "--rate", 0), 2, "--rate")
    assert list(tmp_path.iterdir()) == []


def test_sources_that_will_not_do(folders: tuple[Path, Path, Path], tmp_path: Path) -> None:
    dive, blind, _ = folders
    told(run("export", tmp_path / "nowhere", "-o", tmp_path / "a.kml"), 3, "nowhere", "remedy")
    told(run("export", tmp_path, "-o", tmp_path / "a.kml"), 3, "uwgraph smooth", "remedy")
    told(run("export", blind, "-o", tmp_path / "a.tum"), 3, "no reference", "smooth")
    told(run("export", blind, "-o", tmp_path / "a.kml", "--stream", "fixes"), 3, "no fixes")
    told(run("export", dive, "-o", tmp_path / "a.tum", "--stream", "fixes"), 3, "tum")
    assert list(tmp_path.iterdir()) == []


def test_the_installed_command_has_help_with_examples() -> None:
    done = started("export", "--help")
    assert "uwgraph export" in done.stdout.partition("Example")[2]
