"""TUM, KITTI and EuRoC: evo reads them and sees the same poses; frames by name."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from evo.tools import file_interface
from hand_made import truth
from scipy.spatial.transform import Rotation

from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive
from uwgraph.dive.model import Dive
from uwgraph.errors import ConfigError, DataError
from uwgraph.export import Source, export, source_of_dive, track_of_solution
from uwgraph.export.axes import AXES, FrameName
from uwgraph.frames import R_n_local, matrix_from_rph, ned_from_geodetic
from uwgraph.types import Reference

SOURCE = Source("run1", track_of_solution(truth()))


def evo_traj(folder: Path, *arguments: object) -> str:
    command = [str(Path(sys.executable).with_name("evo_traj")), *map(str, arguments)]
    home = {"HOME": str(folder), "PATH": "/usr/bin:/bin", "MPLBACKEND": "Agg"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=home)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_evo_traj_opens_all_three(tmp_path: Path) -> None:
    solution = truth()
    length = np.linalg.norm(np.diff(solution.p_n, axis=0), axis=1).sum()
    for name, file in (("tum", "a.tum"), ("kitti", "a.kitti"), ("euroc", "a.csv")):
        export(SOURCE, tmp_path / file, name)
        told = evo_traj(tmp_path, name, tmp_path / file, "--full_check")
        assert f"{len(solution)}" in told
        assert f"{length:.2f}" in told
        assert "quaternions\tok" in told or name == "kitti"
        assert "SE(3) conform\tyes" in told


@pytest.mark.parametrize("frame", ["ned", "enu", "euroc"])
def test_evo_reads_the_same_poses_from_all_three(tmp_path: Path, frame: FrameName) -> None:
    solution, axes = truth(), AXES[frame]
    for name, file in (("tum", "a.txt"), ("kitti", "b.txt"), ("euroc", "c.csv")):
        export(SOURCE, tmp_path / file, name, frame=frame)
    tum = file_interface.read_tum_trajectory_file(tmp_path / "a.txt")
    kitti = file_interface.read_kitti_poses_file(tmp_path / "b.txt")
    euroc = file_interface.read_euroc_csv_trajectory(tmp_path / "c.csv")
    for path in (tum, kitti, euroc):
        poses = np.array(path.poses_se3)
        np.testing.assert_allclose(poses[:, :3, 3], solution.p_n @ axes.R_wn.T, atol=1e-6)
        np.testing.assert_allclose(poses[:, :3, :3], axes.R_wn @ solution.R_nb @ axes.R_xb.T, atol=2e-9)
    np.testing.assert_allclose(euroc.timestamps, solution.t_ns * 1e-9, atol=1e-6)
    stamps = [int(line.replace(".", "")) for line in (tmp_path / "b_times.txt").read_text().split()]
    assert stamps == solution.t_ns.tolist()


@pytest.mark.parametrize("frame", ["ned", "enu", "euroc"])
def test_frames_are_right_handed_and_upright(frame: FrameName) -> None:
    """The bow of a level vehicle that heads 30 degrees true, and its starboard and down, where each frame has them."""
    axes = AXES[frame]
    R = axes.R_wn @ matrix_from_rph(np.radians([0.0, 0.0, 30.0])) @ axes.R_xb.T
    north, east = np.cos(np.pi / 6), np.sin(np.pi / 6)
    bow, up_b = {
        "ned": ([1, 0, 0], [0, 0, -1]),
        "enu": ([1, 0, 0], [0, 0, 1]),
        "euroc": ([0, 0, 1], [1, 0, 0]),
    }[frame]
    along, up = {
        "ned": ([north, east, 0], [0, 0, -1]),
        "enu": ([east, north, 0], [0, 0, 1]),
        "euroc": ([north, -east, 0], [0, 0, 1]),
    }[frame]
    np.testing.assert_allclose(R @ bow, along, atol=1e-12)
    np.testing.assert_allclose(R @ up_b, up, atol=1e-12)
    for rotation in (axes.R_wn, axes.R_xb):
        assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_tum_names_its_frames_and_stamps_exactly(tmp_path: Path) -> None:
    export(SOURCE, tmp_path / "a.tum", frame="enu")
    head, _, *lines = (tmp_path / "a.tum").read_text().splitlines()
    assert "ENU world, FLU body" in head
    assert "43.100000000" in head
    assert [int(line.split()[0].replace(".", "")) for line in lines] == truth().t_ns.tolist()
    assert {len(line.split()) for line in lines} == {8}


def test_euroc_has_the_columns_of_the_data_set(tmp_path: Path) -> None:
    export(SOURCE, tmp_path / "a.csv", "euroc")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    header = (
        "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
        "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],"
        "b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1],"
        "b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]"
    )
    assert lines[0] == header
    assert int(lines[1].split(",")[0]) == truth().t_ns[0]
    assert {line.count(",") for line in lines} == {16}


def test_euroc_comes_back_through_import(short_dive: Dive, tmp_path: Path) -> None:
    """All but the place, which the format has no room for: the reader puts its world's origin at 10 m in Zurich."""
    export(source_of_dive(short_dive, "sim"), tmp_path / "asl", "euroc")
    import_dive(tmp_path / "asl", tmp_path / "dive")
    back, truth_, imu = read_dive(tmp_path / "dive"), short_dive.reference, short_dive.imu
    assert back.reference is not None
    assert back.imu is not None
    assert truth_ is not None
    assert imu is not None
    (p, R, v), (p_back, R_back, v_back) = in_n(short_dive, truth_), in_n(back, back.reference)
    np.testing.assert_allclose(p_back - p, np.tile([0.0, 0.0, 10.0], (len(p), 1)), atol=1e-6)
    np.testing.assert_allclose(R_back, R, atol=1e-9)
    np.testing.assert_allclose(v_back, v, atol=1e-9)
    assert back.reference.t_ns.tolist() == truth_.t_ns.tolist()
    # A mean over an interval is the value in its middle; the reader makes means of neighbours of it.
    assert (back.imu.t_ns == imu.t_ns[1:] - np.diff(imu.t_ns) // 2).all()
    np.testing.assert_allclose(back.imu.f_s, (imu.f_s[1:] + imu.f_s[:-1]) / 2, atol=1e-9)
    np.testing.assert_allclose(back.imu.w_s, (imu.w_s[1:] + imu.w_s[:-1]) / 2, atol=1e-12)
    assert back.rig.imu.gyro_noise_density == short_dive.rig.imu.gyro_noise_density
    # What counts is the turn made: it differs by what the two half intervals at the ends hold.
    assert np.degrees(Rotation.from_matrix(turned(back).T @ turned(short_dive)).magnitude()) < 0.05


def in_n(dive: Dive, reference: Reference) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, attitude and velocity in the dive's own n."""
    R = R_n_local(dive.origin, reference.lat, reference.lon)
    p = ned_from_geodetic(dive.origin, reference.lat, reference.lon, reference.height)
    return p, R @ matrix_from_rph(reference.rph), np.einsum("kij,kj->ki", R, reference.v_n)


def turned(dive: Dive) -> np.ndarray:
    """The rotation that the gyro adds up to."""
    assert dive.imu is not None
    step = np.median(np.diff(dive.imu.t_ns)) * 1e-9
    total = Rotation.identity()
    for turn in Rotation.from_rotvec(dive.imu.w_s * step):
        total = total * turn
    return np.asarray(total.as_matrix())


def test_rows_without_an_attitude_are_left_out_and_counted(short_dive: Dive, tmp_path: Path) -> None:
    source = source_of_dive(short_dive, "sim")
    assert source.track is not None
    rph = source.track.rph.copy()
    rph[:7, 1] = np.nan
    partly = Source("sim", replace(source.track, rph=rph))
    made = export(partly, tmp_path / "a.tum")
    assert (made.left_out, made.count) == (7, len(rph) - 7)
    assert export(partly, tmp_path / "a.geojson").left_out == 0
    nothing = Source("sim", replace(source.track, rph=rph * np.nan))
    with pytest.raises(DataError, match="attitude"):
        export(nothing, tmp_path / "b.tum")
    assert not (tmp_path / "b.tum").exists()


def test_fixes_alone_make_no_poses(short_dive: Dive, tmp_path: Path) -> None:
    fixes = source_of_dive(short_dive, "sim", "fixes")
    for name in ("a.tum", "a.mcap"):
        with pytest.raises(DataError, match="poses"):
            export(fixes, tmp_path / name)
    export(fixes, tmp_path / "a.csv")
    assert short_dive.fixes is not None
    assert len((tmp_path / "a.csv").read_text().splitlines()) == len(short_dive.fixes) + 1


def test_a_taken_place_is_refused_and_kept(tmp_path: Path) -> None:
    (tmp_path / "a_times.txt").write_text("mine")
    with pytest.raises(ConfigError, match="already there") as told:
        export(SOURCE, tmp_path / "a.kitti")
    assert "a_times.txt" in told.value.where
    assert (tmp_path / "a_times.txt").read_text() == "mine"
    assert not (tmp_path / "a.kitti").exists()
    (tmp_path / "asl").mkdir()
    (tmp_path / "asl/thesis.tex").write_text("years of work")
    with pytest.raises(ConfigError, match="something else"):
        export(SOURCE, tmp_path / "asl", "euroc", overwrite=True)
    export(SOURCE, tmp_path / "mine", "euroc")
    with pytest.raises(ConfigError, match="already there"):
        export(SOURCE, tmp_path / "mine", "euroc")
    export(SOURCE, tmp_path / "mine", "euroc", overwrite=True)


def test_csv_holds_what_is_known(tmp_path: Path) -> None:
    export(SOURCE, tmp_path / "a.csv")
    table = pd.read_csv(tmp_path / "a.csv")
    assert table["t_ns"].tolist() == truth().t_ns.tolist()
    assert table["sigma_north"].notna().all()
    assert table["heading_deg"].between(0, 360).all()


def test_csv_leaves_out_columns_nobody_knows(short_dive: Dive, tmp_path: Path) -> None:
    export(source_of_dive(short_dive, "sim"), tmp_path / "a.csv")
    header = (tmp_path / "a.csv").read_text().partition("\n")[0].split(",")
    assert "heading_deg" in header
    assert not [name for name in header if name.startswith(("sigma", "bias", "cov"))]
