"""``uwgraph calibrate dvl``, ``clock`` and ``apply`` from outside: tables, files, exit codes, words."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import commandline
import numpy as np
import pytest
from commandline import Done

from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.dive.rig import DvlRig, Rig
from uwgraph.dive.rigfile import read_rig, write_rig
from uwgraph.simulate import DvlModel, HeadingModel, SimulationSettings, simulate

LATE = DvlRig(translation_m=(0.4, 0.1, 0.15), time_offset_s=0.15, sigma=0.004)
MISSION = SimulationSettings(
    duration_s=180.0,
    leg_length_m=30.0,
    line_spacing_m=20.0,
    surface_time_s=10.0,
    depth=5.0,
    current=(0.35, -0.3),
    imu_rate_hz=50.0,
    truth_rate_hz=2.0,
    grade="fog",
    dvl=DvlModel(rig=LATE),
    compass=HeadingModel(),
)


def run(*arguments: object) -> Done:
    return commandline.run("calibrate", *arguments)


@pytest.fixture(scope="module")
def dive() -> Dive:
    made = simulate(MISSION, 3)
    return replace(made, rig=made.rig.model_copy(update={"dvl": DvlRig(sigma=LATE.sigma)}))


@pytest.fixture(scope="module")
def folder(dive: Dive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("dives") / "turns"
    write_dive(dive, place)
    return place


def test_a_dvl_from_a_dive_to_a_rig_onto_a_dive(folder: Path, tmp_path: Path) -> None:
    rig, copy = tmp_path / "rig.yaml", tmp_path / "copy"
    done = run("dvl", folder, "--free", "dvl.time_offset_s", "--free", "dvl.translation_m", "-o", rig, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    clock = next(e for e in report["estimates"] if e["name"] == "dvl.time_offset_s")
    assert clock["observable"]
    assert abs(clock["after"] - 0.15) < 4.0 * clock["sigma"]
    assert report == json.loads((tmp_path / "rig.json").read_text())
    assert read_rig(rig).dvl.time_offset_s == clock["after"]

    assert run("apply", rig, folder, "-o", copy).returncode == 0
    kept = read_dive(copy)
    assert kept.rig.dvl.translation_m == read_rig(rig).dvl.translation_m
    assert kept.rig.dvl.time_offset_s == 0.0
    assert "rig of rig.yaml" in kept.provenance["conversions"][-1]

    assert run("apply", rig, copy, "--clocks").returncode == 0
    again = read_dive(copy)
    assert again.rig == read_rig(rig)
    assert again.dvl is not None
    assert kept.dvl is not None
    np.testing.assert_array_equal(again.dvl.v_s, kept.dvl.v_s)
    assert len(again.provenance["conversions"]) == 2


def test_tables_say_what_is_told_and_what_is_not(folder: Path) -> None:
    done = run("mounting", folder, "--free", "heading.rotation_deg", "--free", "depth.translation_m")
    assert done.returncode == 0, done.stderr
    assert "heading.rotation" in done.stdout
    assert "not told" in done.stdout
    assert "1-sigma at most" in done.stdout
    assert "the depth sensor's lever arm z" in done.stdout


def test_wrong_usage_is_told(folder: Path, tmp_path: Path) -> None:
    taken = tmp_path / "rig.yaml"
    taken.write_text("old")
    for arguments, code, words in [
        (("dvl", folder, "-o", taken), 3, "there is such a file"),
        (("dvl", folder, "-o", tmp_path / "rig.json"), 2, "name RIG.yaml"),
        (("dvl", folder, "--free", "dvl.colour"), 2, "dvl.scale"),
        (("dvl", folder, "--reference-sigma", "1"), 2, "--reference"),
        (("dvl", folder, "--reference", "--reference-sigma", "-1"), 2, "sigma_m"),
        (("dvl", tmp_path / "nothing"), 3, "nothing"),
        (("apply", taken, folder), 2, "rig.yaml"),
        (("apply", tmp_path / "no.yaml", folder), 2, "no.yaml"),
    ]:
        done = run(*arguments)
        assert done.returncode == code, (arguments, done.stderr)
        assert words in done.stderr, (arguments, done.stderr)
        assert "Traceback" not in done.stderr
    assert taken.read_text() == "old"


def test_a_recording_is_not_changed_in_place(tmp_path: Path) -> None:
    recording, rig = tmp_path / "log", tmp_path / "rig.yaml"
    recording.mkdir()
    write_rig(Rig(), rig)
    done = run("apply", rig, recording)
    assert done.returncode == 2
    assert "in place" in done.stderr


def test_what_does_not_stand_still_is_an_error(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uwgraph.calibrate.engine.MAX_ITERATIONS", 1)
    done = run("dvl", folder, "--free", "dvl.time_offset_s", "-o", tmp_path / "rig.yaml")
    assert done.returncode == 4
    assert "does not stand still" in done.stderr
    assert not (tmp_path / "rig.yaml").exists()
