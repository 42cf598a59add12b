"""Every planted defect is found, named and given a remedy; clean dives, simulated and real, pass."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from uwgraph.dive.check import CHECKS, CheckReport, check_dive
from uwgraph.dive.check_table import render
from uwgraph.dive.checks.clocks import check_clocks
from uwgraph.dive.checks.inertial import noise_densities
from uwgraph.dive.model import Dive
from uwgraph.dive.readers import euroc, snapir
from uwgraph.dive.timing import align_clocks
from uwgraph.simulate import HeadingModel, SimulationSettings, simulate
from uwgraph.types import FloatArray, TimeArray

RUNS = (1, 2, 4, 6, 7, 9, 12)
DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))


@pytest.fixture(scope="module")
def dive() -> Dive:
    settings = SimulationSettings(
        duration_s=300, grade="mems", compass=HeadingModel(), speed=2.0, waves=4, surface_depth=0.5, depth=10
    )
    return simulate(settings, seed=5)


def with_(dive: Dive, stream: str, **columns: object) -> Dive:
    return replace(dive, **{stream: replace(getattr(dive, stream), **columns)})


def stamps(dive: Dive, stream: str) -> TimeArray:
    return getattr(dive, stream).t_ns.copy()


def turned(dive: Dive, diagonal: list[float]) -> Dive:
    """The IMU with axes of both sensors multiplied."""
    assert dive.imu is not None
    return with_(dive, "imu", f_s=dive.imu.f_s * diagonal, w_s=dive.imu.w_s * diagonal)


def moved(dive: Dive, stream: str, seconds: float) -> Dive:
    return with_(dive, stream, t_ns=stamps(dive, stream) + round(seconds * 1e9))


def repeated(dive: Dive) -> Dive:
    t = stamps(dive, "dvl")
    t[100] = t[99]
    return with_(dive, "dvl", t_ns=t)


def backward(dive: Dive) -> Dive:
    t = stamps(dive, "imu")
    t[5000:] -= 2_000_000_000
    return with_(dive, "imu", t_ns=t)


def holed(dive: Dive, stream: str, seconds: float) -> Dive:
    t = stamps(dive, stream)
    middle = t[len(t) // 2]
    keep = (t < middle) | (t > middle + round(seconds * 1e9))
    return replace(dive, **{stream: getattr(dive, stream).select(keep)})


def jittered(dive: Dive) -> Dive:
    t = stamps(dive, "imu")
    return with_(dive, "imu", t_ns=t + np.random.default_rng(0).integers(0, 8_000_000, len(t)))


def stretched(dive: Dive) -> Dive:
    t = stamps(dive, "depth")
    return with_(dive, "depth", t_ns=t[0] + np.rint(np.linspace(0, len(t) * 0.2, len(t)) * 1e9).astype(np.int64))


def imu(dive: Dive, f: float | FloatArray = 1.0, w: float | FloatArray = 1.0) -> Dive:
    assert dive.imu is not None
    return with_(dive, "imu", f_s=dive.imu.f_s * f, w_s=dive.imu.w_s * w)


def saturated(dive: Dive) -> Dive:
    assert dive.imu is not None
    limit = float(np.percentile(np.abs(dive.imu.w_s[:, 0]), 99.5))
    w_s = dive.imu.w_s.copy()
    w_s[:, 0] = np.clip(w_s[:, 0], -limit, limit)
    return with_(dive, "imu", w_s=w_s)


def resting(dive: Dive, bias: float) -> Dive:
    """A hundred seconds in the workshop, with a gyro bias."""
    assert dive.imu is not None
    rng, n, rig = np.random.default_rng(1), 10_000, dive.rig.imu
    f_s = np.array([0, 0, -9.8]) + rng.normal(0, rig.accel_noise_density * 10, (n, 3))
    w_s = np.array([bias, 0, 0]) + rng.normal(0, rig.gyro_noise_density * 10, (n, 3))
    still = replace(dive.imu.select(slice(0, n)), f_s=f_s, w_s=w_s)
    return Dive(dive.origin, dive.rig, imu=still)


def stated(dive: Dive, factor: float) -> Dive:
    noise = {k: getattr(dive.rig.imu, k) * factor for k in ("gyro_noise_density", "accel_noise_density")}
    return replace(dive, rig=dive.rig.model_copy(update={"imu": dive.rig.imu.model_copy(update=noise)}))


def dead(dive: Dive) -> Dive:
    return imu(dive, w=np.array([1.0, 1.0, 0.0]))


def lost(dive: Dive) -> Dive:
    assert dive.dvl is not None
    return with_(dive, "dvl", valid=np.random.default_rng(2).random(len(dive.dvl)) < 0.5)


def swung(dive: Dive) -> Dive:
    """The DVL mounted a quarter turn off."""
    assert dive.dvl is not None
    return with_(dive, "dvl", v_s=dive.dvl.v_s[:, [1, 0, 2]] * [1, -1, 1])


def sun(dive: Dive, **change: Callable[[FloatArray], FloatArray]) -> Dive:
    return with_(dive, "sun", **{k: f(getattr(dive.sun, k)) for k, f in change.items()})


DEFECTS: dict[str, tuple[Callable[[Dive], Dive], str, str, str, str]] = {
    "backward": (backward, "error", "imu", "order", "sort"),
    "repeated": (repeated, "error", "dvl", "order", "remove"),
    "long IMU gap": (lambda d: holed(d, "imu", 3), "error", "imu", "gaps", "two dives"),
    "IMU gap": (lambda d: holed(d, "imu", 0.5), "warning", "imu", "gaps", "lost samples"),
    "DVL gap": (lambda d: holed(d, "dvl", 20), "warning", "dvl", "gaps", "lost samples"),
    "jitter": (jittered, "warning", "imu", "jitter", "when they are taken"),
    "stretched": (stretched, "warning", "depth", "stretch", "align_clocks"),
    "time zone": (lambda d: moved(d, "dvl", 3600), "error", "dvl", "overlap", "UTC"),
    "DVL late": (lambda d: moved(d, "dvl", 1.0), "warning", "dvl", "clock", "time_offset_s to -"),
    "reference early": (lambda d: moved(d, "reference", -0.4), "warning", "reference", "clock", "time_offset_s to 0.4"),
    "compass late": (lambda d: moved(d, "heading", 1.5), "warning", "heading", "clock", "time_offset_s to -1."),
    "sun late": (lambda d: moved(d, "sun", 1.0), "warning", "sun", "clock", "time_offset_s to -"),
    "FLU": (lambda d: turned(d, [1, -1, -1]), "error", "imu", "gravity axis", "[180, 0, 0]"),
    "left-handed": (lambda d: turned(d, [1, -1, 1]), "error", "imu", "gyro sign", "left-handed"),
    "one gyro axis": (lambda d: imu(d, w=np.array([-1.0, 1, 1])), "error", "imu", "gyro sign", "negate w_x"),
    "yaw gyro": (lambda d: imu(d, w=np.array([1.0, 1, -1])), "error", "heading", "heading changes", "gyro"),
    "g": (lambda d: imu(d, f=1 / 9.80665), "error", "imu", "gravity norm", "9.80665"),
    "scale of f": (lambda d: imu(d, f=1.05), "warning", "imu", "gravity norm", "calibrate"),
    "deg/s": (lambda d: imu(d, w=np.degrees(1)), "error", "imu", "gyro units", "pi/180"),
    "saturated": (saturated, "warning", "imu", "range", "range"),
    "dead axis": (dead, "error", "imu", "range", "dead"),
    "NaN": (lambda d: imu(d, w=np.array([1.0, 1.0, np.nan])), "error", "imu", "finite", "repair"),
    "bias at rest": (lambda d: resting(d, 0.01), "warning", "imu", "gyro bias", "subtract"),
    "optimistic": (lambda d: stated(d, 0.1), "warning", "imu", "gyro noise", "raise"),
    "pessimistic": (lambda d: stated(d, 30), "warning", "imu", "gyro noise", "lower"),
    "no bottom": (lost, "warning", "dvl", "bottom lock", "drifts"),
    "cm/s": (lambda d: with_(d, "dvl", v_s=d.dvl.v_s * 100), "error", "dvl", "speed", "cm/s"),
    "bottom's velocity": (lambda d: with_(d, "dvl", v_s=-d.dvl.v_s), "error", "dvl", "direction", "negate"),
    "quarter turn": (swung, "error", "dvl", "direction", "rotation_deg"),
    "height": (lambda d: with_(d, "depth", depth=-d.depth.depth), "error", "depth", "sign", "positive down"),
    "shallow height": (
        lambda d: with_(d, "depth", depth=12 - d.depth.depth),
        "error",
        "depth",
        "vertical speed",
        "sign",
    ),
    "feet": (lambda d: with_(d, "depth", depth=d.depth.depth * 3.28), "error", "depth", "vertical speed", "ft"),
    "counter-clockwise": (
        lambda d: with_(d, "heading", heading=-d.heading.heading),
        "error",
        "heading",
        "heading changes",
        "clockwise",
    ),
    "sun not unit": (lambda d: sun(d, s_b=lambda s: s * 1.1), "error", "sun", "unit vector", "divide"),
    "sun below": (lambda d: sun(d, s_b=lambda s: -s), "error", "sun", "above horizon", "sign"),
    "sun full rank": (
        lambda d: sun(d, information_b=lambda m: m + 1e6 * np.eye(3)),
        "error",
        "sun",
        "information",
        "rank",
    ),
    "no IMU": (lambda d: replace(d, imu=None), "error", "imu", "presence", "smoothed"),
    "no DVL": (lambda d: replace(d, dvl=None, fixes=None), "warning", "dvl", "presence", ""),
    "one pose": (
        lambda d: replace(d, reference=d.reference.select(slice(0, 1))),
        "warning",
        "reference",
        "presence",
        "the whole of it",
    ),
    "no heading": (lambda d: replace(d, sun=None, heading=None, fixes=None), "info", "heading", "presence", ""),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_planted_defect_is_found(dive: Dive, defect: str) -> None:
    spoil, level, stream, check, remedy = DEFECTS[defect]
    checks = CHECKS if check == "clock" else tuple(c for c in CHECKS if c is not check_clocks)
    report = check_dive(spoil(dive), checks)
    found = [f for f in report.at(level) if (f.stream, f.check) == (stream, check)]  # type: ignore[arg-type]
    assert found, report.rows()
    assert remedy in found[0].remedy
    assert report.exit_status == (3 if level == "error" or report.at("error") else 0)


@pytest.mark.parametrize(("grade", "pattern"), [("mems", "lawnmower"), ("fog", "helix")])
def test_a_clean_dive_passes(grade: str, pattern: str) -> None:
    settings = SimulationSettings.model_validate({"duration_s": 300, "grade": grade, "pattern": pattern})
    report = check_dive(simulate(settings, seed=7))
    assert not complaints(report)
    assert report.exit_status == 0


def test_what_the_rig_knows_is_no_finding(dive: Dive) -> None:
    report = check_dive(align_clocks(moved(dive, "dvl", 1.0))[0])
    assert not complaints(report)


def test_the_report_is_json_and_a_table(dive: Dive) -> None:
    report = check_dive(repeated(dive))
    told = json.loads(report.to_json())
    assert told["exit_status"] == 3
    assert told["findings"][0]["stream"] == "dvl"
    assert len(told["findings"]) == len(report.findings) == len(report.rows())
    console = Console(record=True, width=160, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(render(report))
    text = console.export_text()
    assert report.summary in text
    assert "remove the repeated rows" in text


@pytest.mark.parametrize("density", [1e-4, 3e-3])
def test_white_noise_is_measured_at_every_averaging_time(density: float) -> None:
    rate = 200.0
    white = np.random.default_rng(4).normal(0, density * np.sqrt(rate), (60_000, 3))
    np.testing.assert_allclose(noise_densities(white, rate), density, rtol=0.25)


def complaints(report: CheckReport) -> list[tuple[str, ...]]:
    return [row for row in report.rows() if row[0] in ("error", "warning")]


def real(folder: str) -> Path:
    path = DATA / folder
    if not path.exists():
        pytest.skip(f"{path} is missing: set UWGRAPH_DATA")
    return path


@pytest.mark.data
@pytest.mark.parametrize("number", RUNS)
def test_snapir_has_no_error(number: int) -> None:
    run = snapir.read(real(f"snapir/Trajectory{number}"))
    report = check_dive(align_clocks(run)[0])
    assert not report.at("error")
    assert {f.check for f in report.at("warning")} <= {"gyro noise"}


@pytest.mark.data
def test_snapir_stamps_and_frame_as_recorded() -> None:
    run = snapir.read(real("snapir/Trajectory1"))
    assert run.dvl is not None
    unaligned = check_dive(run)
    assert not unaligned.at("error")
    assert {f.stream for f in unaligned.at("warning") if f.check == "clock"} == {"dvl", "depth", "reference"}
    n = len(run.dvl)
    printed = with_(run, "dvl", t_ns=run.dvl.t_ns[0] + np.rint(np.linspace(0, n, n) * 1e9).astype(np.int64))
    warned = {(f.stream, f.check) for f in check_dive(printed).at("warning")}
    assert {("dvl", "stretch"), ("dvl", "clock rate")} <= warned
    recorded = check_dive(turned(run, [1, -1, 1]))
    assert any("left-handed" in f.remedy for f in recorded.at("error"))


@pytest.mark.data
def test_euroc_has_no_error() -> None:
    assert not check_dive(euroc.read(real("euroc"))).at("error")
