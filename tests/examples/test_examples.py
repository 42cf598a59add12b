"""Every example runs, is short, and says something."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*.py"))
DATA = Path(os.environ.get("UWGRAPH_DATA", ROOT.parent / "shared" / "data"))


def run(script: str, *arguments: object, data: Path = DATA) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "examples" / script), *map(str, arguments)]
    environment = os.environ | {"UWGRAPH_DATA": str(data)}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=900)


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda p: p.name)
def test_an_example_is_short_and_starts_with_how_to_run_it(script: Path) -> None:
    text = script.read_text()
    assert len(text.splitlines()) < 60
    assert f"python examples/{script.name}" in text


@pytest.mark.slow
def test_first_dive() -> None:
    done = run("01_first_dive.py", 240)
    assert done.returncode == 0, done.stderr
    rows = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()}
    assert {"0", "1", "2", "3", "4", "mean"} <= rows.keys()
    with_sun, without = map(float, rows["mean"][2:4])
    assert with_sun < 0.2
    assert without > 2.0 * with_sun


def test_real_log_without_the_data_says_where_to_get_it(tmp_path: Path) -> None:
    done = run("02_real_log.py", data=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "github.com" in done.stdout


def test_real_log_of_a_wrong_name_fails_in_words(tmp_path: Path) -> None:
    done = run("02_real_log.py", tmp_path / "nowhere")
    assert done.returncode == 1
    assert "nowhere" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.data
@pytest.mark.skipif(not (DATA / "snapir" / "Trajectory1").is_dir(), reason=f"no Snapir recordings in {DATA}")
def test_real_log() -> None:
    done = run("02_real_log.py")
    assert done.returncode == 0, done.stderr
    figures = dict(line.split() for line in done.stdout.splitlines() if len(line.split()) == 2)
    assert float(figures["horizontal_rmse_m"]) < 10.0
    assert float(figures["heading_rmse_deg"]) < 1.0


def test_sun_from_an_image() -> None:
    done = run("03_sun_from_an_image.py")
    assert done.returncode == 0, done.stderr
    lines = [line.replace(",", "").split() for line in done.stdout.splitlines()]
    assert [line[0] for line in lines] == ["polarization", "gradient"]
    for line in lines:
        heading, sigma, true = float(line[2]), float(line[4]), float(line[7].rstrip(")"))
        assert abs(heading - true) < max(3.0 * sigma, 0.5)
        assert line[-2:] == ["no", "doubts"]


def test_sun_heading_factor() -> None:
    done = run("04_sun_heading_factor.py")
    assert done.returncode == 0, done.stderr
    headings = [float(line.split("heading")[-1].split()[0]) for line in done.stdout.splitlines()]
    assert len(headings) == 3
    assert all(abs(heading - 215.0) < 1.0 for heading in headings)


def test_own_csv() -> None:
    done = run("05_own_csv.py", 60)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [line[0] for line in lines[:3]] == ["imu", "dvl", "depth"]
    assert [int(line[1]) for line in lines[:3]] == [6000, 301, 301]
    assert 20.0 < float(lines[3][2]) < 80.0


def test_ardusub_log() -> None:
    done = run("07_ardusub_log.py", 60)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert {(line[0], line[2]) for line in lines[:6]} >= {("imu", "HIGHRES_IMU"), ("dvl", "VISION_POSITION_DELTA")}
    assert lines[-1][:2] == ["61", "keyframes,"]
    assert 5.0 < float(lines[-1][-2]) < 12.0


def test_ros_bag() -> None:
    done = run("06_ros_bag.py", 60)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert {(line[0].rpartition("/")[2], line[-1]) for line in lines[:4]} == {
        ("imu", "imu"),
        ("twiststamped", "dvl"),
        ("fluidpressure", "depth"),
        ("navsatfix", "fixes"),
    }
    assert 20.0 < float(lines[4][2]) < 80.0


@pytest.mark.slow
def test_calibration() -> None:
    done = run("08_calibration.py", 700)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    numbers = {line[0]: line[1:] for line in lines if line and line[0].startswith("dvl.")}
    assert len(numbers) == 8
    for name in ("dvl.scale", "dvl.time_offset_s"):
        value, _, sigma, *_ = numbers[name]
        assert abs(float(value) - float(numbers[name][-1].rstrip(")"))) < 4.0 * float(sigma)
    rmse = [float(line[-2]) for line in lines if "RMSE" in line]
    assert rmse[1] < rmse[0]


def test_learned_metric() -> None:
    done = run("09_learned_metric.py")
    assert done.returncode == 0, done.stderr
    errors = dict(line.split("%")[0].split(":") for line in done.stdout.splitlines()[:2])
    euclidean, learned = (float(value) for value in errors.values())
    assert learned < euclidean


@pytest.mark.slow
def test_places_and_map(tmp_path: Path) -> None:
    done = run("10_places_and_map.py", tmp_path)
    assert done.returncode == 0, done.stderr
    rows = {line[:12].strip(): float(line.split()[-2]) for line in done.stdout.splitlines() if "RMSE" in line}
    assert rows["with images"] < 0.3
    assert rows["without"] > 10.0 * rows["with images"]
    assert list((tmp_path / "map").glob("*.ply"))


@pytest.mark.slow
def test_filter_or_smoother(tmp_path: Path) -> None:
    done = run("11_filter_or_smoother.py", 300, tmp_path)
    assert done.returncode == 0, done.stderr
    rows = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()[1:6]}
    assert rows.keys() == {"dr", "eskf", "ukf", "aukf", "smooth"}
    heading = {name: float(row[2]) for name, row in rows.items()}
    assert heading["smooth"] < 0.5 * min(heading["eskf"], heading["ukf"], heading["aukf"])
    assert (tmp_path / "compared" / "report.html").stat().st_size > 50_000


@pytest.mark.slow
def test_own_sensor() -> None:
    done = run("12_own_sensor.py")
    assert done.returncode == 0, done.stderr
    rmse = [float(line.split()[-2]) for line in done.stdout.splitlines()]
    assert len(rmse) == 6
    for without, with_ranges in zip(rmse[::2], rmse[1::2], strict=True):
        assert with_ranges < 0.6 * without
