"""The command line from outside: exit codes, what goes to which stream, and what is left on the disk."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from commandline import UWGRAPH, told
from commandline import started as run

from uwgraph.dive.folder import read_dive, write_dive


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dives") / "short"
    done = run("simulate", folder, "--duration", 120, "--seed", 4)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    return folder


def test_help_names_every_command() -> None:
    done = run("--help")
    assert done.returncode == 0
    for command in ("import", "check", "simulate", "smooth", "export", "sun", "demo", "version"):
        assert command in done.stdout


@pytest.mark.parametrize("command", ["import", "check", "simulate", "smooth", "export", "demo"])
def test_every_command_has_an_example(command: str) -> None:
    done = run(command, "--help")
    assert done.returncode == 0
    assert f"uwgraph {command}" in done.stdout.partition("Example")[2]


def test_version() -> None:
    assert run("version").stdout.strip().count(".") == 2


def test_usage_errors(dive: Path, tmp_path: Path) -> None:
    told(run("smooth", dive), 2, "--out")
    told(run("smooth", dive, "-o", tmp_path / "o", "--loudly"), 2, "--loudly")
    told(run("simulate", tmp_path / "d", "--pattern", "zigzag"), 2, "zigzag", "lawnmower")
    told(run("import", dive, tmp_path / "d", "--format", "floppy"), 2, "floppy", "snapir")


def test_missing_dive(tmp_path: Path) -> None:
    told(run("smooth", tmp_path / "nowhere", "-o", tmp_path / "o"), 3, "nowhere", "remedy")
    told(run("check", tmp_path), 3, "remedy")
    assert list(tmp_path.iterdir()) == []


def test_unknown_setting_is_named(dive: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("max_iteration: 3\n")
    done = run("smooth", dive, "-o", tmp_path / "o", "--settings", tmp_path / "mine.yaml")
    told(done, 2, "mine.yaml", "max_iteration", "max_iterations")


def test_settings_of_the_wrong_shape(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("- 1\n- 2\n")
    told(run("simulate", tmp_path / "d", "--settings", tmp_path / "mine.yaml"), 2, "mine.yaml")


def test_same_seed_same_dive(dive: Path, tmp_path: Path) -> None:
    run("simulate", tmp_path / "again", "--duration", 120, "--seed", 4)
    for name in ("imu", "dvl", "sun"):
        file = f"{name}.parquet"
        pd.testing.assert_frame_equal(pd.read_parquet(dive / file), pd.read_parquet(tmp_path / "again" / file))


@pytest.mark.slow
def test_smooth_writes_the_folder_and_pure_json(dive: Path, tmp_path: Path) -> None:
    done = run("smooth", dive, "-o", tmp_path / "out", "--plot", "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    stored = json.loads((tmp_path / "out/metrics.json").read_text())
    assert figures == stored | {"output": str(tmp_path / "out")}
    assert figures["matched"] == figures["total"] > 100
    assert figures["horizontal_rmse_m"] < 5.0
    assert figures["heading_rmse_deg"] < 1.0
    assert figures["runtime_s"] > 0.0
    files = {"trajectory.tum", "solution.parquet", "metrics.json", "config.yaml", "run.log", "track.png"}
    assert {p.name for p in (tmp_path / "out").iterdir()} == files
    table = pd.read_parquet(tmp_path / "out/solution.parquet")
    assert len(table) == figures["total"]
    assert table.notna().all(axis=None)

    told(run("smooth", dive, "-o", tmp_path / "out"), 2, "earlier result", "--force")
    again = run("smooth", dive, "-o", tmp_path / "out", "--force", "--no-covariances")
    assert again.returncode == 0, again.stderr
    assert "horizontal_rmse_m" in again.stdout
    assert not (tmp_path / "out/track.png").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.slow
def test_without_any_heading_it_refuses(dive: Path, tmp_path: Path) -> None:
    write_dive(replace(read_dive(dive), sun=None, fixes=None), tmp_path / "blind")
    told(run("smooth", tmp_path / "blind", "-o", tmp_path / "o"), 4, "heading", "--heading-deg")
    assert not (tmp_path / "o").exists()
    word = run("smooth", tmp_path / "blind", "-o", tmp_path / "o", "--heading-deg", 30)
    assert word.returncode == 0, word.stderr


@pytest.mark.slow
def test_check_prints_pure_json(dive: Path) -> None:
    done = run("check", dive, "--json")
    assert done.returncode == 0, done.stdout
    assert json.loads(done.stdout)["exit_status"] == 0


def test_a_bad_file_is_named(dive: Path, tmp_path: Path) -> None:
    broken = copy_of(dive, tmp_path / "broken")
    whole = (broken / "imu.parquet").read_bytes()
    (broken / "imu.parquet").write_bytes(whole[: len(whole) // 2])
    told(run("smooth", broken, "-o", tmp_path / "o"), 3, "imu.parquet", "remedy")
    assert not (tmp_path / "o").exists()


def copy_of(dive: Path, folder: Path) -> Path:
    folder.mkdir()
    for file in dive.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


@pytest.mark.parametrize("command", ["simulate", "smooth"])
def test_a_full_disk_is_told_and_leaves_nothing(dive: Path, tmp_path: Path, command: str) -> None:
    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    out = tmp_path / "out"
    arguments = ("simulate", out, "--duration", 60) if command == "simulate" else ("smooth", dive, "-o", out)
    told(run(*arguments, preexec=small_files), 3, "full", "remedy")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_run_leaves_nothing(dive: Path, tmp_path: Path, sent: signal.Signals, code: int) -> None:
    arguments = [str(UWGRAPH), "smooth", str(dive), "-o", str(tmp_path / "out"), "--keyframe-period", "0.05"]
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    wait_until_busy(process)
    process.send_signal(sent)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == code, stderr
    assert stdout == ""
    assert "Traceback" not in stderr
    assert list(tmp_path.iterdir()) == []


def wait_until_busy(process: subprocess.Popen[str]) -> None:
    """Until gtsam is loaded, so that the signal meets the run and not the start of Python."""
    maps = Path(f"/proc/{process.pid}/maps")
    if not maps.exists():
        time.sleep(1.5)
        return
    deadline = time.monotonic() + 30.0
    while "gtsam" not in maps.read_text() and time.monotonic() < deadline:
        time.sleep(0.02)


@pytest.mark.slow
def test_demo_from_start_to_picture(tmp_path: Path) -> None:
    done = run("demo", "-o", tmp_path / "demo")
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "demo/result/metrics.json").read_text())
    assert figures["duration_s"] == pytest.approx(1200.0, abs=1.0)
    assert figures["heading_rmse_deg"] < 0.2
    assert figures["final_error_percent"] < 1.0
    assert (tmp_path / "demo/result/track.png").is_file()


def test_simulate_on_a_dive_degrades_and_adds(dive: Path, tmp_path: Path) -> None:
    made = tmp_path / "aided"
    done = run("simulate", made, "--on", dive, "--grade", "mems", "--add", "sun-heading", "--add", "depth")
    assert done.returncode == 0, done.stderr
    aided, plain = read_dive(made), read_dive(dive)
    assert aided.heading is not None
    assert plain.heading is None
    assert set(aided.provenance["simulated"]) == {"imu", "heading", "depth"}
    assert aided.rig.imu.gyro_noise_density > plain.rig.imu.gyro_noise_density


@pytest.mark.parametrize("options", [("--add", "dvl"), ("--on", "anywhere", "--pattern", "helix")])
def test_simulate_on_refuses_what_does_not_go_together(tmp_path: Path, options: tuple[str, ...]) -> None:
    told(run("simulate", tmp_path / "dive", *options), 2, "--on")
    assert not list(tmp_path.iterdir())
