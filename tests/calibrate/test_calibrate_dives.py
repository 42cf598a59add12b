"""Whole calibrations of simulated dives: what they find, what they refuse, and what they write."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_dives import LEVER, STRAIGHT, TRUE_DVL, TURNING, bare, cut, dive_of

from uwgraph.calibrate import Calibration, ReferenceUse, calibrate_dives
from uwgraph.calibrate.report import as_plain, doubts, write_calibration
from uwgraph.dive import Dive
from uwgraph.dive.rig import DepthRig, HeadingRig
from uwgraph.dive.rigfile import read_rig
from uwgraph.errors import ConfigError, DataError, InitialisationError

TRUTH = {
    "dvl.scale": TRUE_DVL.scale,
    **{f"dvl.rotation_deg.{a}": x for a, x in zip(("roll", "pitch", "yaw"), TRUE_DVL.rotation_deg, strict=True)},
    **{f"dvl.translation_m.{a}": x for a, x in zip("xyz", LEVER, strict=True)},
    "dvl.time_offset_s": TRUE_DVL.time_offset_s,
}


@pytest.fixture(scope="module")
def dive() -> Dive:
    return dive_of(TURNING, 1)


@pytest.fixture(scope="module")
def found(dive: Dive) -> Calibration:
    return calibrate_dives([bare(dive)], "dvl", names=["one"])


def test_a_turning_dive_tells_its_dvl(found: Calibration) -> None:
    assert found.converged
    assert found.unseen == ()
    for name, truth in TRUTH.items():
        e = found.estimate(name)
        assert e.observable, name
        assert abs(e.after - truth) < 3.5 * e.sigma, name
    e = np.array([found.estimate(n).after - TRUTH[n] for n in found.names])
    assert e @ np.linalg.solve(found.covariance, e) / len(e) < 2.5  # beyond the 99 % point of chi-square over 8
    assert found.estimate("dvl.scale").sigma < 1e-3
    assert found.estimate("dvl.time_offset_s").sigma < 0.015


def test_the_rig_states_what_is_left(found: Calibration) -> None:
    assert found.rig.dvl.scale_sigma == pytest.approx(found.estimate("dvl.scale").sigma)
    assert found.rig.dvl.misalignment_sigma_deg == pytest.approx(
        max(found.estimate(f"dvl.rotation_deg.{a}").sigma for a in ("roll", "pitch", "yaw"))
    )
    assert found.rigs["one"].dvl == found.rig.dvl


def test_a_straight_run_is_refused_what_it_cannot_show() -> None:
    dive = bare(cut(dive_of(STRAIGHT, 2), 160.0, 350.0))
    found = calibrate_dives([dive], "dvl")
    refused = {e.name for e in found.estimates if not e.observable}
    assert {"dvl.rotation_deg.roll", "dvl.time_offset_s", *(f"dvl.translation_m.{a}" for a in "xyz")} <= refused
    assert all(e.after == e.before for e in found.estimates if e.name in refused)
    scale, yaw = found.estimate("dvl.scale"), found.estimate("dvl.rotation_deg.yaw")
    assert scale.observable
    assert abs(scale.after - TRUE_DVL.scale) < 4.0 * scale.sigma
    assert yaw.observable
    assert {name for u in found.unseen for name in u.names} >= refused
    assert any("turns" in u.text for u in found.unseen)
    assert found.rig.dvl.time_offset_s == 0.0


@pytest.mark.parametrize("lever", [TRUE_DVL.translation_m, (0.0, 0.0, 0.0)], ids=["known", "forgotten"])
def test_a_clock_alone_with_a_rig_that_is_given(dive: Dive, lever: tuple[float, float, float]) -> None:
    """The given rig is put onto the dive; a lever arm that it does not have is estimated along, not held at zero."""
    dvl = TRUE_DVL.model_copy(update={"translation_m": lever, "time_offset_s": 0.0})
    found = calibrate_dives([dive], ["dvl.time_offset_s"], rig=dive.rig.model_copy(update={"dvl": dvl}))
    clock = found.estimate("dvl.time_offset_s")
    assert abs(clock.after - TRUE_DVL.time_offset_s) < 4.0 * clock.sigma < 0.04
    assert found.rig.dvl.scale == TRUE_DVL.scale


def test_a_lever_arm_that_is_wrong_is_doubted(dive: Dive) -> None:
    wrong = TRUE_DVL.model_copy(update={"translation_m": (6.0, 0.0, 0.0), "time_offset_s": 0.0})
    found = calibrate_dives([dive], ["dvl.time_offset_s"], rig=dive.rig.model_copy(update={"dvl": wrong}))
    said = " ".join(doubts(found))
    assert "dvl.time_offset_s" in said
    assert "lever arm" in said


def test_dives_have_their_own_clocks_and_one_rig(dive: Dive) -> None:
    assert dive.dvl is not None
    late = replace(dive, dvl=replace(dive.dvl, t_ns=dive.dvl.t_ns - 200_000_000))
    dives = [bare(dive), bare(late)]
    free = ["dvl.scale", "dvl.translation_m", "dvl.rotation_deg", "dvl.time_offset_s"]
    apart = calibrate_dives(dives, free, names=["a", "b"])
    offsets = [apart.estimate(f"{n}: dvl.time_offset_s") for n in "ab"]
    assert offsets[1].after - offsets[0].after == pytest.approx(0.2, abs=0.01)
    assert apart.rigs["b"].dvl.time_offset_s == offsets[1].after
    mean = apart.estimate("dvl.time_offset_s")
    assert mean.after == pytest.approx(np.mean([e.after for e in offsets]), abs=1e-6)
    assert mean.scatter == pytest.approx(0.2 / np.sqrt(2.0), abs=0.01)
    scale = apart.estimate("dvl.scale")
    assert scale.dives == 2
    assert abs(scale.after - TRUE_DVL.scale) < 3.5 * scale.sigma


def test_clocks_and_mounting_of_the_other_sensors(dive: Dive) -> None:
    assert dive.heading is not None
    assert dive.depth is not None
    assert dive.sun is not None
    turned = replace(
        dive,
        heading=replace(dive.heading, heading=dive.heading.heading + np.radians(3.0)),
        sun=replace(dive.sun, t_ns=dive.sun.t_ns - 100_000_000),
        rig=dive.rig.model_copy(update={"depth": DepthRig(), "heading": HeadingRig()}),
    )
    free = ["heading.rotation_deg", "sun.time_offset_s", "depth.translation_m"]
    found = calibrate_dives([turned], free)
    yaw = found.estimate("heading.rotation_deg.yaw")
    assert abs(yaw.after - 3.0) < 3.5 * yaw.sigma < 1.0
    clock = found.estimate("sun.time_offset_s")
    assert abs(clock.after - 0.1) < 3.5 * clock.sigma < 0.3
    x = found.estimate("depth.translation_m.x")
    assert abs(x.after + 0.2) < 3.5 * x.sigma


def test_a_rate_is_told_and_not_applied(dive: Dive) -> None:
    assert dive.dvl is not None
    since = dive.dvl.t_ns - dive.dvl.t_ns.mean().astype(np.int64)
    stretched = replace(dive, dvl=replace(dive.dvl, t_ns=dive.dvl.t_ns - np.rint(3e-4 * since).astype(np.int64)))
    found = calibrate_dives([stretched], ["dvl.time_offset_s", "dvl.clock_rate_ppm"])
    rate = found.estimate("dvl.clock_rate_ppm")
    assert abs(rate.after - 300.0) < 3.5 * rate.sigma < 400.0
    offset = found.estimate("dvl.time_offset_s")
    assert abs(offset.after - TRUE_DVL.time_offset_s) < 3.5 * offset.sigma


@pytest.mark.slow
def test_the_reference_stands_in_for_fixes(dive: Dive) -> None:
    blind = replace(bare(dive), fixes=None, heading=None, sun=None)
    with pytest.raises(InitialisationError, match="wreck"):
        calibrate_dives([blind], "dvl", names=["wreck"])
    found = calibrate_dives([blind], ["dvl.scale", "dvl.rotation_deg"], reference=ReferenceUse(sigma_m=0.2))
    scale = found.estimate("dvl.scale")
    # its clock is taken from the rig, and is wrong here: along the track that is no scale
    assert scale.observable
    assert abs(scale.after - TRUE_DVL.scale) < 2e-3
    # its lever arm moves the fixes that were made from it, and its clock leaves the compass alone
    both = ["reference.translation_m", "reference.time_offset_s"]
    seen = calibrate_dives([replace(dive, fixes=None)], both, reference=ReferenceUse(sigma_m=0.2, period_s=2.0))
    for e in seen.estimates:
        assert abs(e.after) < 3.5 * e.sigma, e.name
        assert e.sigma > 0.01, e.name
    assert seen.estimate("reference.translation_m.x").observable
    with pytest.raises(ConfigError, match="in these dives"):
        calibrate_dives([dive], both)
    with pytest.raises(DataError, match="no reference"):
        calibrate_dives([replace(blind, reference=None)], "dvl", reference=ReferenceUse())


def test_the_rig_file_comes_back(found: Calibration, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    write_calibration(found, file)
    assert read_rig(file) == found.rig
    assert "calibrate dvl from one" in file.read_text()
    report = json.loads((tmp_path / "rig.json").read_text())
    assert report == json.loads(json.dumps(as_plain(found)))
    np.testing.assert_allclose(report["covariance"]["matrix"], found.covariance)
    assert report["covariance"]["names"] == list(found.names)


@pytest.mark.parametrize("what", ["velocity", ["dvl.colour"], ["camera.scale"], ["heading.translation_m"]])
def test_what_cannot_be_freed_is_told(dive: Dive, what: str | list[str]) -> None:
    with pytest.raises(ConfigError, match="cannot be calibrated"):
        calibrate_dives([dive], what)


def test_a_sensor_that_is_not_there_is_told(dive: Dive) -> None:
    with pytest.raises(ConfigError, match="in these dives"):
        calibrate_dives([replace(dive, dvl=None)], "dvl")
    with pytest.raises(DataError, match="no dive"):
        calibrate_dives([], "dvl")
