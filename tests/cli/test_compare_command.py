"""``uwgraph compare`` from the shell: the table, the folder, and how it refuses, fails and is interrupted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from commandline import run, started, told

from uwgraph.cli.compare import _delay, _settings
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.errors import ConfigError
from uwgraph.simulate import SimulationSettings, simulate

pytestmark = pytest.mark.slow
FAST = "filter: {samples_per_step: 8}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short simulated dive."""
    place = tmp_path_factory.mktemp("dives") / "short"
    write_dive(simulate(SimulationSettings(duration_s=40.0, imu_rate_hz=50.0, surface_time_s=5.0), 1), place)
    return place


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("settings") / "fast.yaml"
    file.write_text(FAST)
    return file


@pytest.fixture(scope="module")
def compared(folder: Path, fast: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """The folder of a comparison, and what was said."""
    out = tmp_path_factory.mktemp("compared") / "out"
    options = ("--estimators", " eskf, smooth,", "--settings", fast, "--delay", "sun=1.5")
    done = started("compare", folder, "-o", out, *options)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return out, done.stdout, done.stderr


def figures_of(out: Path) -> dict[str, Any]:
    comparison: dict[str, Any] = json.loads((out / "comparison.json").read_text())
    return comparison


def test_people_see_a_row_each(compared: tuple[Path, str, str]) -> None:
    out, shown, said = compared
    rows = [line for line in shown.splitlines() if "eskf" in line or "smooth" in line]
    assert len(rows) == 2
    for heading in ("rmse m", "NEES pos", "time s", "MB"):
        assert heading in shown
    assert "poses matched" in shown
    assert f"results in {out}" in said.replace("\n", "")


def test_the_folder_is_whole(compared: tuple[Path, str, str]) -> None:
    out = compared[0]
    assert {"comparison.json", "report.html", "config.yaml", "eskf", "smooth"} <= {p.name for p in out.iterdir()}
    pictures = list(out.glob("*.png"))
    assert len(pictures) >= 2
    assert all(p.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" for p in pictures)
    assert {p.name for p in (out / "eskf").iterdir()} == {
        "trajectory.tum",
        "solution.parquet",
        "innovations.parquet",
    }
    assert {p.name for p in (out / "smooth").iterdir()} == {"trajectory.tum", "solution.parquet"}
    rows = np.loadtxt(out / "eskf/trajectory.tum")
    assert rows.shape[1] == 8
    assert len(rows) == pq.read_table(out / "eskf/solution.parquet").num_rows
    innovations = pq.read_table(out / "eskf/innovations.parquet")
    assert set(innovations.column("kind").to_pylist()) == {"dvl", "depth", "sun", "fixes"}


def test_the_figures_are_those_of_metrics_json_and_more(compared: tuple[Path, str, str], folder: Path) -> None:
    figures = figures_of(compared[0])
    assert figures["dive"] == folder.name
    assert figures["simulated"]
    assert list(figures["estimators"]) == ["eskf", "smooth"]
    assert figures["failed"] == {}
    for entry in figures["estimators"].values():
        for key in (
            "title",
            "horizontal_rmse_m",
            "final_error_percent",
            "heading_rmse_deg",
            "attitude_rmse_deg",
            "rpe",
        ):
            assert key in entry
        assert entry["alignment"] == "none"
        assert entry["matched"] == entry["total"]
        assert entry["nees_position"] > 0.0
        assert entry["nees_heading_95"][0] < 1.0 < entry["nees_heading_95"][1]
        assert entry["runtime_s"] > 0.0
        assert entry["memory_mb"] > 50.0
    filtered = figures["estimators"]["eskf"]
    assert filtered["nis_dvl_95"][0] < filtered["nis_dvl_95"][1]
    assert filtered["refused_dvl"] == 0


def test_the_settings_used_are_written_down(compared: tuple[Path, str, str]) -> None:
    text = (compared[0] / "config.yaml").read_text()
    assert "samples_per_step: 8" in text
    assert "sun: 1.5" in text
    assert "rig:" in text


def test_the_figures_agree_with_eval(compared: tuple[Path, str, str], folder: Path) -> None:
    done = run("eval", compared[0] / "eskf/solution.parquet", folder, "--json")
    assert done.returncode == 0, done.stderr
    judged, stated = json.loads(done.stdout), figures_of(compared[0])["estimators"]["eskf"]
    for key in ("matched", "horizontal_rmse_m", "heading_rmse_deg", "nees_position"):
        assert judged[key] == pytest.approx(stated[key], rel=1e-5), key


def test_a_taken_folder_is_kept_unless_forced(compared: tuple[Path, str, str], folder: Path, tmp_path: Path) -> None:
    out = compared[0]
    before = (out / "comparison.json").read_text()
    told(run("compare", folder, "-o", out, "--estimators", "dr"), 2, "--force")
    assert (out / "comparison.json").read_text() == before
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("years of work")
    told(run("compare", folder, "-o", mine, "--estimators", "dr", "--force"), 2, "mine")
    assert (mine / "thesis.tex").read_text() == "years of work"


def test_json_and_force(folder: Path, tmp_path: Path) -> None:
    """Twice into one folder, the second time without what the first had; jobs and alignment as asked for."""
    out = tmp_path / "out"
    first = run("compare", folder, "-o", out, "--estimators", "dr", "--json")
    assert first.returncode == 0, first.stderr
    assert json.loads(first.stdout)["output"] == str(out)
    assert json.loads(first.stdout)["estimators"] == figures_of(out)["estimators"]
    (out / "dr" / "old").write_text("")
    again = run("compare", folder, "-o", out, "--estimators", "dr", "--force", "--align", "yaw", "--json")
    assert again.returncode == 0, again.stderr
    assert figures_of(out)["estimators"]["dr"]["alignment"] == "yaw"
    assert not (out / "dr" / "old").exists()


# Refusals


def test_an_unknown_estimator(folder: Path, tmp_path: Path) -> None:
    told(run("compare", folder, "-o", tmp_path / "o", "--estimators", "eskf,kalman"), 2, "kalman", "aukf", "smooth")
    told(run("compare", folder, "-o", tmp_path / "o", "--estimators", ","), 2, "estimator")
    assert list(tmp_path.iterdir()) == []


def test_nothing_tells_the_heading(folder: Path, tmp_path: Path) -> None:
    dive = read_dive(folder)
    write_dive(replace(dive, sun=None, fixes=None, reference=None), tmp_path / "dark")
    told(run("compare", tmp_path / "dark", "-o", tmp_path / "o", "--estimators", "dr"), 4, "heading", "--heading-deg")
    assert not (tmp_path / "o").exists()


def test_without_a_reference_there_are_sigmas_and_no_errors(folder: Path, tmp_path: Path, fast: Path) -> None:
    write_dive(replace(read_dive(folder), reference=None), tmp_path / "alone")
    done = run("compare", tmp_path / "alone", "-o", tmp_path / "o", "--estimators", "eskf", "--settings", fast)
    assert done.returncode == 0, done.stderr
    assert "no reference" in done.stdout
    figures = figures_of(tmp_path / "o")["estimators"]["eskf"]
    assert "horizontal_rmse_m" not in figures
    assert figures["sigma"]["north_m"]["final"] > 0.0
    assert (tmp_path / "o/report.html").is_file()


@pytest.mark.parametrize("text", ["sun", "sun=", "sun=soon", "=2", "sum=2"])
def test_a_delay_that_is_none(text: str, folder: Path, tmp_path: Path) -> None:
    told(run("compare", folder, "-o", tmp_path / "o", "--delay", text), 2, "delay")


def test_delays_and_settings(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("smooth: {heading_deg: 10.0, keyframe_period_s: 2.0}\nfilter: {delays_s: {dvl: 0.5, sun: 9.0}}\n")
    chosen = _settings(file, {"heading_deg": 20.0, "initial": None}, ["sun=2", "fixes = 1.5"])
    assert chosen.smooth.heading_deg == 20.0
    assert chosen.smooth.keyframe_period_s == 2.0
    assert chosen.filter.delays_s == {"dvl": 0.5, "sun": 2.0, "fixes": 1.5}
    assert _settings(None, {}, []).filter.delays_s == {}
    assert _delay("sun=2e-1") == ("sun", 0.2)
    for wrong in (["sun=-1"], ["sun=inf"], ["sun=nan"]):
        with pytest.raises(ConfigError):
            _settings(None, {}, wrong)


@pytest.mark.parametrize(
    ("text", "word"),
    [("filter: {gate: 2.0}", "gate"), ("filter: {noise: 1}", "noise"), ("smoth: {}", "smoth"), ("- 1", "mine.yaml")],
)
def test_a_wrong_settings_file_is_named(text: str, word: str, folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    told(run("compare", folder, "-o", tmp_path / "o", "--settings", file), 2, word, "mine.yaml")
    told(run("compare", folder, "-o", tmp_path / "o", "--settings", tmp_path / "no.yaml"), 2, "no.yaml")


def test_a_dive_that_is_none(tmp_path: Path) -> None:
    told(run("compare", tmp_path / "nothing", "-o", tmp_path / "o"), 3, "nothing")


# Failures and interruptions

OWN = """
import os, signal, time
from uwgraph.filters import ESTIMATORS, Named

def killed(task, settings, progress):
    os.kill(os.getpid(), signal.SIGKILL)

def sleeps(task, settings, progress):
    progress("sleeping", 0.5)
    open(os.environ["ASLEEP"], "w").close()
    time.sleep(120)

ESTIMATORS["killed"] = Named("killed", True, killed)
ESTIMATORS["sleeps"] = Named("sleeping", True, sleeps)

if __name__ == "__main__":
    from uwgraph.cli import main
    main()
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """The command with estimators of one's own; processes that it starts know them too."""
    script = tmp_path / "own.py"
    script.write_text(OWN)
    return script


def test_who_dies_is_listed_and_the_others_are_written(own: Path, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, own, "compare", folder, "-o", out, "--estimators", "killed,dr"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 4, done.stderr
    assert "Traceback" not in done.stderr
    assert "killed gave no result" in done.stderr
    assert "signal 9" in done.stderr
    figures = figures_of(out)
    assert list(figures["estimators"]) == ["dr"]
    assert "signal 9" in figures["failed"]["killed"]
    assert not (out / "killed").exists()
    assert "signal 9" in (out / "report.html").read_text()


@pytest.mark.parametrize("whole_group", [False, True], ids=["the command", "as a terminal does"])
def test_an_interrupted_comparison_leaves_nothing(own: Path, folder: Path, tmp_path: Path, whole_group: bool) -> None:
    out, asleep = tmp_path / "out", tmp_path / "asleep"
    command = [sys.executable, own, "compare", folder, "-o", out, "--estimators", "sleeps"]
    process = subprocess.Popen(
        list(map(str, command)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "ASLEEP": str(asleep)},
    )
    deadline = time.monotonic() + 60.0
    while not asleep.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert asleep.exists()
    if whole_group:
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=30)
    assert process.returncode == 130, stderr
    assert stdout == ""
    assert "Traceback" not in stderr
    assert {p.name for p in tmp_path.iterdir()} == {"own.py", "asleep"}
    assert gone(process.pid)


@pytest.mark.parametrize("seconds", [0.2, 1.5])
def test_an_interruption_while_a_process_starts_is_quiet(
    own: Path, folder: Path, tmp_path: Path, seconds: float
) -> None:
    """A terminal's Ctrl-C reaches the new process too, in the middle of its imports."""
    command = [sys.executable, own, "compare", folder, "-o", tmp_path / "out", "--estimators", "dr"]
    process = subprocess.Popen(
        list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    if not children.exists():
        process.kill()
        pytest.skip("this system does not list the children of a process")
    deadline = time.monotonic() + 60.0
    # the first child of multiprocessing is its resource tracker
    while len(children.read_text().split()) < 2 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)
    stdout, stderr = process.communicate(timeout=30)
    assert process.returncode == 130, stderr
    assert "Traceback" not in stderr
    assert stdout == ""
    assert gone(process.pid)
    assert not (tmp_path / "out").exists()


def gone(group: int) -> bool:
    """Whether no process of the group is left after ten seconds at most: some systems reap orphans every two."""
    for _ in range(200):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False
