"""``uwgraph import`` of logs, from outside."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from commandline import UWGRAPH, run, told

START_S = 1_654_646_400


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An IMU with a gap of 20 s, depths, and a table that nobody knows."""
    folder = tmp_path_factory.mktemp("logs") / "log"
    folder.mkdir()
    t = np.concatenate([np.arange(0, 10, 0.05), np.arange(30, 60, 0.05)])
    imu = np.column_stack([START_S + t, *np.tile([[0], [0], [-9.8], [0], [0], [0.01]], len(t))])
    header = "t,ACC X [m/s^2],ACC Y [m/s^2],ACC Z [m/s^2],gx,gy,gz"
    np.savetxt(folder / "imu.csv", imu, delimiter=",", header=header, comments="", fmt="%.12g")
    depth = np.column_stack([START_S + np.arange(60), np.full(60, 3.0)])
    np.savetxt(folder / "ctd.csv", depth, delimiter=",", header="t,depth", comments="", fmt="%.12g")
    np.savetxt(folder / "odd.csv", depth, delimiter=",", header="t,foo [q]", comments="", fmt="%.12g")
    return folder


def test_listing_imports_nothing(log: Path, tmp_path: Path) -> None:
    done = run("import", "--list", log, "--mapping-out", tmp_path / "m.yaml")
    assert done.returncode == 0, done.stderr
    assert "imu from imu.csv (table): time t [s]; f ACC {X, Y, Z} [m/s^2]; w" in done.stdout
    assert "odd.csv (table): what it means is not known" in done.stdout
    assert "foo [q]" in (tmp_path / "m.yaml").read_text()
    figures = json.loads(run("import", "--list", log, "--json").stdout)
    assert {t["stream"]: t["topic"] for t in figures["taken"]} == {"imu": "imu.csv", "depth": "ctd.csv"}
    assert figures["left"][0]["fields"] == ["t", "foo [q]"]


def test_origin_gap_part_and_mapping(log: Path, tmp_path: Path) -> None:
    dive = tmp_path / "dive"
    told(run("import", log, dive), 3, "--origin LAT,LON")
    gap = run("import", log, dive, "--origin", "-43.1,5.9")
    told(gap, 3, "no IMU sample for 20", "--from 2022-06-08T00:00:30.000000000Z")
    assert list(tmp_path.iterdir()) == []
    part = gap.stderr.partition("--from ")[2].split()
    done = run("import", log, dive, "--origin", "-43.1,5.9", "--from", part[0], "--to", part[2], "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["format"] == "csv"
    assert {s["name"]: s["count"] for s in report["streams"]} == {"imu": 599, "depth": 30}
    assert [item["topic"] for item in report["left"]] == ["odd.csv"]

    mine = tmp_path / "mine.yaml"
    text = (dive / "mapping.yaml").read_text()
    mine.write_text("origin: {lat_deg: 1, lon_deg: 2}\n" + text.replace("depth [m]", "depth [dm]"))
    again = run("import", log, dive, "--mapping", mine, "--from", 30, "--csv", "--force")
    assert again.returncode == 0, again.stderr
    assert "0.3" in (dive / "depth.csv").read_text()
    assert "lat_deg: 1.0" in (dive / "dive.yaml").read_text()
    assert run("check", dive).returncode in (0, 3)


def test_words_for_what_does_not_fit(log: Path, tmp_path: Path) -> None:
    dive, mine = tmp_path / "dive", tmp_path / "m.yaml"
    told(run("import", log), 2, "DEST", "--list")
    told(run("import", log, dive, "--origin", "north"), 2, "--origin 43.1,5.9")
    told(run("import", log, dive, "--from", "soon"), 2, "soon", "--from")
    told(run("import", log, dive, "--rig", tmp_path / "none.yaml"), 2, "none.yaml")
    mine.write_text("streams: {depth: {topic: ctd.cvs, depth: depth}}\n")
    told(run("import", log, dive, "--mapping", mine, "--origin", "1,2"), 2, "did you mean 'ctd.csv'")
    mine.write_text("streams: {depth: {topic: ctd.csv, depth: detph}}\n")
    told(
        run("import", log, dive, "--mapping", mine, "--origin", "1,2"),
        2,
        "mapping: depth.depth",
        "did you mean 'depth'",
    )
    assert list(tmp_path.iterdir()) == [mine]


def test_nothing_known_names_the_file_to_edit(log: Path, tmp_path: Path) -> None:
    dive = tmp_path / "dive"
    told(run("import", log / "odd.csv", dive), 3, str(tmp_path / "dive-mapping.yaml"), "--mapping")
    text = (tmp_path / "dive-mapping.yaml").read_text()
    assert "foo [q]" in text
    named = run("import", log / "odd.csv", dive, "--mapping-out", tmp_path / "named.yaml")
    told(named, 3, str(tmp_path / "named.yaml"))
    assert (tmp_path / "named.yaml").read_text() == text


def test_options_of_logs_are_refused_elsewhere(tmp_path: Path) -> None:
    source = tmp_path / "sim"
    assert run("simulate", source, "--duration", 60).returncode == 0
    told(run("import", source, tmp_path / "d", "--origin", "1,2"), 2, "no topics to map")
    told(run("import", "--list", source), 2, "no topics to list")
    assert run("import", source, tmp_path / "d").returncode == 0
    assert not (tmp_path / "d/mapping.yaml").exists()


@pytest.mark.slow
def test_an_interrupted_import_leaves_nothing(tmp_path: Path) -> None:
    source, dive = tmp_path / "log", tmp_path / "out" / "dive"
    source.mkdir()
    row = b"1654646400.01,0.1,0.2,-9.8,0.01,0.02,0.03\n"
    with (source / "imu.csv").open("wb") as file:
        file.write(b"t,ax,ay,az,gx,gy,gz\n")
        for _ in range(60):
            file.write(row * 20_000)
    command = [str(UWGRAPH), "import", str(source), str(dive), "--origin", "1,2"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("out/.dive.partial-*")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, stderr
    assert "Traceback" not in stderr
    assert list((tmp_path / "out").iterdir()) == []
