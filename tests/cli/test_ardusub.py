"""Real ArduSub logs from outside: imported, checked, smoothed as far as their sensors allow, what is missing told."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from test_import_command import run

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data")) / "ardusub"

pytestmark = [pytest.mark.data, pytest.mark.skipif(not DATA.is_dir(), reason=f"no ArduSub logs in {DATA}")]


@pytest.fixture(scope="module")
def onboard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    dive = tmp_path_factory.mktemp("bin") / "dive"
    done = run("import", DATA / "small.BIN", dive, "--origin", "48.386,-124.631")
    assert done.returncode == 0, done.stderr
    for words in (
        "imu from IMU[0]",
        "depth from BARO[1]",
        "BARO[0]: in air",
        "does not know the date",
        "dvl missing",
    ):
        assert words in done.stdout
    return dive


@pytest.fixture(scope="module")
def telemetry(tmp_path_factory: pytest.TempPathFactory) -> Path:
    dive = tmp_path_factory.mktemp("tlog") / "dive"
    done = run("import", DATA / "small.tlog", dive)
    assert done.returncode == 0, done.stderr
    for words in (
        "imu from RAW_IMU",
        "depth from SCALED_PRESSURE2",
        "488 of 489 repeat the place",
        "imu logged at 2 Hz",
    ):
        assert words in done.stdout
    return dive


def test_without_a_place_the_error_says_how_to_give_one(tmp_path: Path) -> None:
    done = run("import", DATA / "small.BIN", tmp_path / "dive")
    assert done.returncode == 3
    assert "--origin" in done.stderr
    assert not (tmp_path / "dive").exists()


def test_check_tells_what_is_missing(onboard: Path, telemetry: Path) -> None:
    done = run("check", onboard, "--json")
    assert done.returncode == 0, done.stderr
    findings = {(f["stream"], f["check"]): f for f in json.loads(done.stdout)["findings"]}
    assert findings["dvl", "presence"]["level"] == "warning"
    done = run("check", telemetry, "--json")
    assert done.returncode == 3
    findings = {(f["stream"], f["check"]): f for f in json.loads(done.stdout)["findings"]}
    assert findings["imu", "presence"]["level"] == "error"
    assert "SR0_RAW_SENS" in findings["imu", "presence"]["remedy"]


def test_the_onboard_log_is_smoothed_as_far_as_it_goes(onboard: Path, tmp_path: Path) -> None:
    """The vehicle lay still: it stays within its sigmas of where it was, and its attitude is the autopilot's."""
    done = run("smooth", onboard, "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    assert "dvl missing" in done.stderr
    metrics = json.loads(done.stdout)
    assert metrics["roll_rmse_deg"] < 0.5
    assert metrics["pitch_rmse_deg"] < 0.5
    assert metrics["heading_rmse_deg"] < 2.0
    states = pd.read_parquet(tmp_path / "out" / "solution.parquet")
    for axis in ("north", "east", "down"):
        assert (states[axis].abs() < 3.0 * states[f"sigma_{axis}"] + 0.05).all()
    assert states["down"].abs().max() < 0.1
    assert states["sigma_north"].iloc[-1] > 10.0
    assert np.hypot(states["v_n"], states["v_e"]).max() < 1.0


def test_the_telemetry_is_refused_with_what_to_log(telemetry: Path, tmp_path: Path) -> None:
    done = run("smooth", telemetry, "-o", tmp_path / "out")
    assert done.returncode == 3
    assert "2 Hz" in done.stderr
    assert "SR0_RAW_SENS" in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_date_can_be_given(onboard: Path, tmp_path: Path) -> None:
    mapping = yaml.safe_load((onboard / "mapping.yaml").read_text())
    for stream in mapping["streams"].values():
        stream |= {"time": "TimeUS [us]", "epoch": "2023-05-04T17:00:00Z"}
    mapping["origin"] = {"lat_deg": 48.386, "lon_deg": -124.631}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(mapping))
    done = run("import", DATA / "small.BIN", tmp_path / "dive", "--mapping", tmp_path / "mine.yaml", "--json")
    assert done.returncode == 0, done.stderr
    starts = {stream["name"]: stream["start"] for stream in json.loads(done.stdout)["streams"]}
    assert starts["imu"].startswith("2023-05-04T17:04:25.7")
