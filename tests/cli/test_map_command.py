"""``uwgraph map`` from outside: files, figures, exit codes, words."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run, started, told

sys.path.insert(0, str(Path(__file__).parents[1] / "seafloor"))

from floor_scene import Scene, dive_over

from uwgraph.dive.folder import write_dive
from uwgraph.evaluate import write_solution
from uwgraph.graph import SmoothSettings, resample, smooth

QUICK = ("--voxel", 0.08, "--pixel", 0.05)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return dive_over(tmp_path_factory.mktemp("scene") / "dive", stereo=False)


@pytest.fixture(scope="module")
def result(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What smooth wrote of half of the dive."""
    whole = smooth(scene.dive, SmoothSettings(initial="reference"))
    t_ns = whole.t_ns[whole.t_ns < whole.t_ns[0] + 50 * 10**9]
    out = tmp_path_factory.mktemp("result") / "out"
    write_solution(resample(scene.dive, whole, t_ns), out, {}, {}, "")
    return out


def test_a_map_and_the_same_re_deformed(scene: Scene, result: Path, tmp_path: Path) -> None:
    made = run("map", scene.folder, "--solution", result, "-o", tmp_path / "a", "--json", *QUICK)
    assert made.returncode == 0, made.stderr
    figures = json.loads(made.stdout)
    assert figures["ranges"] == "altitude"
    assert figures["keyframes"] > 8
    assert figures["left_out"]["outside the solution"] > 8
    assert (tmp_path / "a" / "cloud.ply").stat().st_size > 10_000
    again = run("map", scene.folder, "--along", "reference", "--from", tmp_path / "a", "-o", tmp_path / "b")
    told_well = again.stdout + again.stderr
    assert again.returncode == 0, again.stderr
    assert "keyframes" in told_well
    assert f"map in {tmp_path / 'b'}" in told_well
    assert json.loads((tmp_path / "b" / "map.json").read_text())["keyframes"] == figures["keyframes"]
    told(run("map", scene.folder, "--along", "reference", "-o", tmp_path / "a"), 3, "not empty")


def test_usage_errors(scene: Scene, result: Path, tmp_path: Path) -> None:
    out = tmp_path / "m"
    told(run("map", scene.folder, "--camera", "sky", "-o", out), 2, "no camera 'sky'", "down")
    told(run("map", scene.folder, "--voxel", -1, "-o", out), 2, "voxel_m", "greater than 0")
    told(run("map", scene.folder, "--from", result, "--voxel", 0.1, "-o", out), 2, "--from", "leave out")
    told(run("map", scene.folder, "--along", "reference", "--solution", result, "-o", out), 2, "--along")
    (tmp_path / "s.yaml").write_text("voxle_m: 0.1\n")
    told(run("map", scene.folder, "--settings", tmp_path / "s.yaml", "-o", out), 2, "voxle_m", "voxel_m")
    assert not out.exists()


def test_data_errors(scene: Scene, result: Path, tmp_path: Path) -> None:
    out = tmp_path / "m"
    told(run("map", tmp_path / "nowhere", "-o", out), 3, "nowhere")
    told(run("map", scene.folder, "--solution", tmp_path, "-o", out), 3, "uwgraph smooth")
    told(run("map", scene.folder, "--solution", result, "--from", result, "-o", out), 3, "is no map")
    blind = replace(scene.dive, altitude=None)
    write_dive(blind, tmp_path / "blind", images_from=scene.folder)
    told(run("map", tmp_path / "blind", "--solution", result, "-o", out), 3, "how far the floor", "altitude")
    late = replace(scene.dive.images["down"], t_ns=scene.dive.images["down"].t_ns + np.int64(10**13))
    write_dive(replace(scene.dive, images={"down": late}), tmp_path / "late", images_from=scene.folder)
    told(run("map", tmp_path / "late", "--solution", result, "-o", out), 3, "none of the images", "time_offset_s")
    assert not out.exists()


def test_the_installed_command_has_help_with_examples() -> None:
    done = started("map", "--help")
    assert "uwgraph map" in done.stdout.partition("Example")[2]
