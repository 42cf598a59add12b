"""uwgraph simulate --on DIVE --add closures --add odometry, and what smooth says of them."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
from commandline import run, told

from uwgraph.dive.folder import read_dive


@pytest.fixture(scope="module")
def patrol(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dives")
    (folder / "mission.yaml").write_text("{pattern: patrol, leg_length_m: 40, line_spacing_m: 20, surface_time_s: 5}\n")
    asked = ("--settings", folder / "mission.yaml", "--duration", 250, "--depth", 2, "--no-sun")
    assert run("simulate", folder / "plain", *asked).returncode == 0
    done = run("simulate", folder / "seen", "--on", folder / "plain", "--add", "closures", "--add", "odometry")
    assert done.returncode == 0, done.stderr
    assert "closures" in done.stderr
    return folder / "seen"


def test_smooth_counts_them_and_writes_why(patrol: Path, tmp_path: Path) -> None:
    dive = read_dive(patrol)
    assert dive.closures is not None
    assert dive.odometry is not None
    done = run("smooth", patrol, "-o", tmp_path / "out", "--initial", "reference")
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    assert metrics["closures_accepted"] + metrics["closures_rejected"] == len(dive.closures)
    assert metrics["closures_accepted"] > 0.8 * len(dive.closures)
    assert f"closures: {metrics['closures_accepted']} accepted" in done.stderr
    verdicts = pd.read_parquet(tmp_path / "out/closures.parquet")
    assert verdicts["accepted"].sum() == metrics["closures_accepted"]
    assert verdicts["t_ns"].tolist() == dive.closures.t_ns.tolist()
    assert verdicts["reason"].str.len().min() > 10
    assert "odometry" in (tmp_path / "out/run.log").read_text()


def test_without_them_nothing_is_said(patrol: Path, tmp_path: Path) -> None:
    (tmp_path / "off.yaml").write_text("{closures: false, odometry: false}\n")
    done = run("smooth", patrol, "-o", tmp_path / "out", "--initial", "reference", "--settings", tmp_path / "off.yaml")
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "out/closures.parquet").exists()
    assert "closures" not in json.loads((tmp_path / "out/metrics.json").read_text())
    assert "closures:" not in done.stderr


def test_a_way_without_returns_is_told(tmp_path: Path) -> None:
    assert run("simulate", tmp_path / "far", "--pattern", "transit", "--duration", 100, "--no-sun").returncode == 0
    told(run("simulate", tmp_path / "seen", "--on", tmp_path / "far", "--add", "closures"), 3, "never comes back")
    assert not (tmp_path / "seen").exists()


@pytest.mark.parametrize("setting", ["closure_gate: 1.0", "closure_pairs: 0.2", "max_closures: 0"])
def test_impossible_settings_are_refused(patrol: Path, tmp_path: Path, setting: str) -> None:
    (tmp_path / "odd.yaml").write_text(setting + "\n")
    told(run("smooth", patrol, "-o", tmp_path / "out", "--settings", tmp_path / "odd.yaml"), 2, setting.split(":")[0])
