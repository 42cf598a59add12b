"""``uwgraph eval`` from the shell: what people see, what evo makes of its export, and how it refuses."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import run, told
from scipy.spatial.transform import Rotation

from uwgraph.dive.folder import write_dive
from uwgraph.evaluate.table import tum_lines
from uwgraph.simulate import SimulationSettings, simulate

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
BIN = Path(sys.executable).parent


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A random walk and its estimate with noise, scale and drift, as TUM."""
    folder, rng, n = tmp_path_factory.mktemp("pair"), np.random.default_rng(3), 300
    t_ns = 1_654_646_400_000_000_001 + np.arange(n) * 1_000_000_000
    p = np.cumsum(rng.normal([1.0, 0.3, 0.05], 0.5, (n, 3)), axis=0)
    R = Rotation.from_rotvec(np.cumsum(rng.normal(scale=0.05, size=(n, 3)), axis=0))
    turn = Rotation.from_rotvec([0.01, -0.02, 0.2])
    files = folder / "estimate.tum", folder / "reference.tum"
    noisy = turn.apply(1.01 * p + rng.normal(scale=0.2, size=(n, 3))) + np.array([5.0, -3.0, 1.0])
    # the first attitude is the reference's, so that evo's --align_origin, which turns by it, only shifts as ours does
    rotations = (turn * R).as_matrix()
    rotations[0] = R[0].as_matrix()
    files[0].write_text(tum_lines(t_ns, noisy, rotations))
    files[1].write_text(tum_lines(t_ns, p, R.as_matrix()))
    return files


@pytest.fixture(scope="module")
def smoothed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A short simulated dive, and what smooth made of it."""
    folder = tmp_path_factory.mktemp("smoothed")
    write_dive(simulate(SimulationSettings(duration_s=40.0, grade="fog"), seed=4), folder / "dive")
    assert run("smooth", folder / "dive", "-o", folder / "out", "--initial", "reference").returncode == 0
    return folder / "out", folder / "dive"


def figures(*arguments: object) -> dict[str, Any]:
    done = run("eval", *arguments, "--json")
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def evo(tool: str, *arguments: object) -> dict[str, float]:
    """Statistics that evo's own command prints, to six decimals."""
    done = subprocess.run([BIN / tool, "tum", *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {name: float(value) for name, value in re.findall(r"^\s+(\w+)\t([-\d.e+]+)$", done.stdout, re.MULTILINE)}


def agree(ours: dict[str, Any], theirs: dict[str, float]) -> None:
    for name in ("rmse", "mean", "median", "max"):
        assert ours[f"ate_{name}_m"] == pytest.approx(theirs[name], abs=1.1e-6), name


def test_people_see_the_count_and_the_drift(pair: tuple[Path, Path]) -> None:
    done = run("eval", *pair, "--distance", "10", "--distance", "100")
    assert done.returncode == 0
    assert "ate_rmse_m" in done.stdout
    assert "drift (RPE" in done.stdout
    assert "translation, %" in done.stdout
    assert "300 of 300 poses matched" in done.stderr
    assert "taken as NED" in done.stderr


@pytest.mark.parametrize("distance", ["0", "-5", "inf", "nan"])
def test_a_distance_that_nobody_travels(pair: tuple[Path, Path], distance: str) -> None:
    done = run("eval", *pair, "--distance", distance)
    assert done.returncode == 2
    assert done.stdout == ""


def test_evo_ape_says_the_same(pair: tuple[Path, Path]) -> None:
    estimate, reference = pair
    agree(figures(*pair), evo("evo_ape", reference, estimate))
    agree(figures(*pair, "--align", "se3"), evo("evo_ape", reference, estimate, "--align"))
    agree(figures(*pair, "--align", "origin"), evo("evo_ape", reference, estimate, "--align_origin"))


def test_evo_rpe_says_the_same(pair: tuple[Path, Path]) -> None:
    estimate, reference = pair
    row = figures(*pair, "--distance", "20")["rpe"][0]
    options = (reference, estimate, "-d", "20", "-u", "m", "--all_pairs", "--pairs_from_reference")
    assert row["translation_rmse_m"] == pytest.approx(evo("evo_rpe", *options)["rmse"], abs=1e-6)
    turned = evo("evo_rpe", *options, "-r", "angle_deg")
    assert row["rotation_rmse_deg"] == pytest.approx(turned["rmse"], abs=1e-6)


@pytest.mark.parametrize("alignment", ["yaw", "se3"])
def test_the_export_is_what_was_judged(pair: tuple[Path, Path], tmp_path: Path, alignment: str) -> None:
    """Evo needs no alignment any more, since the export has it; not even the one that evo does not know."""
    ours = figures(*pair, "--align", alignment, "--export", tmp_path / "judged")
    agree(ours, evo("evo_ape", tmp_path / "judged/reference.tum", tmp_path / "judged/trajectory.tum"))
    assert json.loads((tmp_path / "judged/eval.json").read_text())["ate_rmse_m"] == ours["ate_rmse_m"]
    again = figures(tmp_path / "judged/trajectory.tum", tmp_path / "judged/reference.tum")
    assert again["ate_rmse_m"] == pytest.approx(ours["ate_rmse_m"], abs=1e-6)
    assert not any("taken as NED" in line for line in again["notes"])


def test_an_alignment_says_what_it_hides(pair: tuple[Path, Path]) -> None:
    assert any("heading, tilt and position" in line for line in figures(*pair, "--align", "se3")["notes"])
    assert not any("hide" in line for line in figures(*pair)["notes"])


def test_a_result_is_judged_as_smooth_judged_it(smoothed: tuple[Path, Path], tmp_path: Path) -> None:
    out, dive = smoothed
    ours = figures(out, dive, "--export", tmp_path / "judged", "--plot", tmp_path / "errors.png")
    theirs = json.loads((out / "metrics.json").read_text())
    for name in ("matched", "horizontal_rmse_m", "ate_rmse_m", "heading_rmse_deg", "nees_position", "nees_heading"):
        assert ours[name] == pytest.approx(theirs[name], rel=1e-6), name
    for row, expected in zip(ours["rpe"], theirs["rpe"], strict=True):
        assert row["pairs"] == expected["pairs"]
        assert row["translation_rmse_m"] == pytest.approx(expected["translation_rmse_m"], abs=1e-7)
    assert "nees_attitude" not in ours
    agree(ours, evo("evo_ape", tmp_path / "judged/reference.tum", tmp_path / "judged/trajectory.tum"))
    assert (tmp_path / "errors.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_every_form_of_a_result_gives_the_same(smoothed: tuple[Path, Path], tmp_path: Path) -> None:
    """The folder, its table, its TUM file and a CSV; against the dive and against an export of its reference."""
    out, dive = smoothed
    assert run("export", out, "-o", tmp_path / "a.csv").returncode == 0
    assert run("export", dive, "-o", tmp_path / "ref.tum", "--frame", "enu").returncode == 0
    whole = figures(out / "solution.parquet", dive)
    for name in (tmp_path / "a.csv", out / "trajectory.tum"):
        assert figures(name, dive)["ate_rmse_m"] == pytest.approx(whole["ate_rmse_m"], abs=2e-6), name
    assert whole["nees_position"] == pytest.approx(figures(tmp_path / "a.csv", dive)["nees_position"], rel=1e-3)
    assert figures(out / "trajectory.tum", dive)["nees_position"] is None
    # without velocities the reference is interpolated by straight lines
    assert figures(out / "trajectory.tum", tmp_path / "ref.tum")["ate_rmse_m"] == pytest.approx(
        whole["ate_rmse_m"], abs=0.01
    )
    assert figures(dive, dive)["ate_rmse_m"] == 0.0


def test_a_wrong_frame_is_hinted_at(pair: tuple[Path, Path], tmp_path: Path) -> None:
    estimate, reference = pair
    rows = np.loadtxt(estimate)
    rows[:, 1:4] = np.column_stack([rows[:, 2], rows[:, 1], -rows[:, 3]])
    stamps = [line.split()[0] for line in estimate.read_text().splitlines()]
    lines = (
        f"{t} " + " ".join(f"{value:.6f}" for value in row[1:]) + "\n" for t, row in zip(stamps, rows, strict=True)
    )
    (tmp_path / "enu.tum").write_text("".join(lines))
    notes = figures(tmp_path / "enu.tum", reference)["notes"]
    assert any("--trajectory-frame enu" in line and "frames differ" in line for line in notes)
    right = figures(tmp_path / "enu.tum", reference, "--trajectory-frame", "enu")
    assert right["ate_rmse_m"] == pytest.approx(figures(*pair)["ate_rmse_m"], abs=1e-5)
    assert not any("frames differ" in line for line in right["notes"])


def test_a_clock_offset_is_an_error_with_both_spans(pair: tuple[Path, Path], tmp_path: Path) -> None:
    late = tmp_path / "late.tum"
    late.write_text(pair[0].read_text().replace("16546", "16547"))
    told(run("eval", late, pair[1]), 3, "no pose", "2022-06-08", "2022-06-09", "clock offset?", "+100000.000 s")
    told(run("eval", pair[0], pair[1], "--align", "yaw", "--max-dt", "0", "--reference-frame", "huh"), 2)


def test_max_dt(pair: tuple[Path, Path], tmp_path: Path) -> None:
    late = tmp_path / "late.tum"
    late.write_text(pair[0].read_text().replace(".000000001 ", ".250000001 "))
    assert figures(late, pair[1])["matched"] == 299
    assert figures(late, pair[1], "--match", "nearest")["matched"] == 300
    told(run("eval", late, pair[1], "--max-dt", "0.1"), 3, "--max-dt")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("cut.tum", "1 2 3\n", ("line 1", "3 columns")),
        ("empty.tum", "", ("empty",)),
        ("unknown.csv", "time,colour\n1,red\n", ("no columns of position",)),
        ("noise.txt", "\x00\x01\x02", ("no text",)),
    ],
)
def test_bad_files_end_with_3(
    pair: tuple[Path, Path], tmp_path: Path, name: str, content: str, words: list[str]
) -> None:
    (tmp_path / name).write_text(content)
    told(run("eval", tmp_path / name, pair[1]), 3, name, "remedy", *words)
    told(run("eval", pair[0], tmp_path / name), 3, name, "remedy", *words)


def test_what_is_not_there(pair: tuple[Path, Path], tmp_path: Path) -> None:
    told(run("eval", tmp_path / "no.tum", pair[1]), 3, "no.tum", "No such file")
    told(run("eval", pair[0], tmp_path / "no_dive"), 3, "no_dive")
    (tmp_path / "folder").mkdir()
    told(run("eval", pair[0], tmp_path / "folder"), 3, "folder")


def test_nothing_is_overwritten_unasked(pair: tuple[Path, Path], tmp_path: Path) -> None:
    taken = tmp_path / "mine.png"
    taken.write_text("mine")
    told(run("eval", *pair, "--plot", taken), 3, "mine.png", "--force")
    told(run("eval", *pair, "--plot", tmp_path / "a.xyz"), 2, ".png")
    told(run("eval", *pair, "--export", tmp_path), 3, "not empty")
    told(run("eval", *pair, "--export", tmp_path, "--force"), 3, "not empty")
    assert taken.read_text() == "mine"
    for _ in range(2):
        assert run("eval", *pair, "--export", tmp_path / "judged", "--force").returncode == 0


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 9])
def test_snapir_agrees_with_evo(tmp_path: Path, number: int) -> None:
    log = DATA / "snapir" / f"Trajectory{number}"
    if not log.exists():
        pytest.skip(f"no {log}: set UWGRAPH_DATA to the folder of the recordings")
    out = tmp_path / "out"
    assert run("smooth", log, "-o", out, "--initial", "reference", "--no-covariances").returncode == 0
    ours = figures(out, log, "--export", tmp_path / "judged", "--distance", "100")
    judged = tmp_path / "judged/reference.tum", tmp_path / "judged/trajectory.tum"
    assert ours["matched"] > 390
    agree(ours, evo("evo_ape", *judged))
    agree(figures(out, log, "--align", "se3"), evo("evo_ape", *judged, "--align"))
    row = ours["rpe"][0]
    theirs = evo("evo_rpe", *judged, "-d", "100", "-u", "m", "--all_pairs", "--pairs_from_reference")
    assert row["translation_rmse_m"] == pytest.approx(theirs["rmse"], abs=1e-6)
