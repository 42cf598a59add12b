"""Readers of other people's formats, on small recordings made here and on the real ones."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.dive.importing import import_dive
from uwgraph.dive.readers import READERS, euroc, guess_reader, reader_named, snapir
from uwgraph.errors import ConfigError, DataError
from uwgraph.frames import gravity_n, matrix_from_rph, ned_from_geodetic
from uwgraph.types import FloatArray

REAL = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
RUNS = (1, 2, 4, 6, 7, 9, 12)


def real(name: str) -> Path:
    if not (REAL / name).exists():
        pytest.skip(f"no {REAL / name}: set UWGRAPH_DATA to the folder of real recordings")
    return REAL / name


# --- Snapir


def write_csv(file: Path, header: tuple[str, ...], columns: FloatArray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(file, columns, delimiter=",", header=",".join(header), comments="", fmt="%.17g")


def make_snapir(folder: Path, seconds: int = 60) -> Path:
    """A level vehicle going north-east at 1 m/s at 5 m depth, with a y rate and a y force to tell the sign."""
    n = 100 * seconds
    imu = np.tile([0.0, 0.1, 0.2, -9.8, 0.01, 0.02, 0.03], (n, 1))
    imu[:, 0] = np.linspace(0, seconds, n)
    t = np.linspace(0, seconds, seconds)
    dvl = np.column_stack([t, np.tile([1.0, 0.1, 0.0], (seconds, 1))])
    gt = np.tile([0.0, 0.61, 0.57, -5.0, 0.7, 0.7, 0.0, 0.0, 0.0, np.pi / 4], (seconds, 1))
    gt[:, 0] = t
    for kind, columns in (("IMU", imu), ("DVL", dvl), ("GT", gt)):
        write_csv(folder / f"{kind}_made.csv", snapir._COLUMNS[kind], columns)
    return folder


def test_snapir_conversions(tmp_path: Path) -> None:
    dive = snapir.read(make_snapir(tmp_path / "run", seconds=200))
    assert dive.imu is not None
    assert dive.dvl is not None
    assert dive.depth is not None
    assert dive.reference is not None
    np.testing.assert_array_equal(dive.imu.f_s[0], [0.1, -0.2, -9.8])
    np.testing.assert_array_equal(dive.imu.w_s[0], [0.01, -0.02, 0.03])
    np.testing.assert_array_equal(dive.dvl.v_s[0], [1.0, 0.1, 0.0])
    assert (dive.depth.depth == 5.0).all()
    assert (dive.reference.lat == 0.57).all()
    assert (dive.reference.lon == 0.61).all()
    np.testing.assert_array_equal(dive.reference.rph[0], [0, 0, np.pi / 4])
    np.testing.assert_array_equal(np.diff(dive.imu.t_ns), 10**7)  # the stretch is undone
    np.testing.assert_array_equal(np.diff(dive.dvl.t_ns), 10**9)
    assert "depth from the reference: not independent" in dive.provenance["caveats"]


@pytest.mark.parametrize("kind", ["IMU", "DVL", "GT"])
def test_snapir_needs_all_three_files(tmp_path: Path, kind: str) -> None:
    run = make_snapir(tmp_path / "run")
    (run / f"{kind}_made.csv").unlink()
    with pytest.raises(DataError, match=rf"0 files {kind}_\*\.csv") as caught:
        import_dive(run, tmp_path / "dive")
    assert str(run) in caught.value.where
    assert not (tmp_path / "dive").exists()


def test_snapir_cut_at_a_line_end_is_found(tmp_path: Path) -> None:
    run = make_snapir(tmp_path / "run")
    lines = (run / "IMU_made.csv").read_text().splitlines(keepends=True)
    (run / "IMU_made.csv").write_text("".join(lines[:3000]))
    with pytest.raises(DataError, match="cut off") as caught:
        snapir.read(run)
    assert "IMU_made.csv" in caught.value.where


def test_snapir_in_degrees_is_refused(tmp_path: Path) -> None:
    run = make_snapir(tmp_path / "run")
    table = np.loadtxt(run / "GT_made.csv", delimiter=",", skiprows=1)
    table[:, [1, 2]] *= 180 / np.pi
    write_csv(run / "GT_made.csv", snapir._COLUMNS["GT"], table)
    with pytest.raises(DataError, match="no angle in radians") as caught:
        snapir.read(run)
    assert "Longitude" in caught.value.where
    assert "degrees" in caught.value.remedy


@pytest.mark.data
@pytest.mark.parametrize("run", RUNS)
def test_real_snapir(tmp_path: Path, run: int) -> None:
    write_dive(snapir.read(real(f"snapir/Trajectory{run}")), tmp_path / "dive")
    dive = read_dive(tmp_path / "dive")
    assert dive.imu is not None
    assert dive.dvl is not None
    assert dive.reference is not None
    # FRD: the accelerometer's tilt and the gyro's yaw agree with the reference in sign and size, the DVL's speed too
    seconds = dive.imu.f_s.reshape(400, 100, 3).mean(axis=1)
    down = matrix_from_rph(dive.reference.rph)[:, 2, :] * -9.795
    assert np.abs(seconds - down).mean() < 0.15
    assert all(np.corrcoef(seconds[:, axis], down[:, axis])[0, 1] > 0.25 for axis in (0, 1))
    turns = np.diff(np.unwrap(dive.reference.rph[:, 2]))
    assert np.corrcoef(dive.imu.w_s[:, 2].reshape(400, 100).mean(axis=1)[:-1], turns)[0, 1] > 0.7
    speed = np.linalg.norm(dive.dvl.v_s, axis=1)
    assert np.median(np.abs(speed - np.linalg.norm(dive.reference.v_n, axis=1))) < 0.04
    assert len({*np.diff(dive.imu.t_ns)}) == 1


@pytest.mark.data
@pytest.mark.slow
def test_import_of_a_real_snapir_run_tells_what_it_did(tmp_path: Path) -> None:
    report = import_dive(real("snapir/Trajectory12"), tmp_path / "dive")
    assert report.format == "snapir"
    assert sum("stretched" in note for note in report.conversions) == 3
    assert {s.name: s.count for s in report.streams} == {"imu": 40_000, "dvl": 400, "depth": 400, "reference": 400}
    rates = {s.name: s.rate_hz for s in report.streams}
    assert rates == pytest.approx({"imu": 100.0, "dvl": 1.0, "depth": 1.0, "reference": 1.0}, rel=1e-9)
    dive = read_dive(tmp_path / "dive")
    assert dive.rig.dvl.time_offset_s != 0
    assert dive.provenance["conversions"] == list(report.conversions)


# --- EuRoC


def euroc_world(n: int) -> tuple[FloatArray, Rotation, FloatArray, FloatArray, FloatArray]:
    """A smooth motion in the source's own frames: stamps [s], attitude, velocity, and exact gyro and specific force."""
    t = np.arange(n) / 200.0
    upright = Rotation.from_matrix([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # z forward, x up
    spin = np.array([0.2, 0.0, 0.0])  # about the source's x: to the left, seen from above
    attitude = upright * Rotation.from_rotvec(np.outer(t, spin))
    velocity = np.column_stack([np.sin(t), np.zeros(n), 0.1 * np.cos(t)])
    acceleration = np.column_stack([np.cos(t), np.zeros(n), -0.1 * np.sin(t)])
    force = attitude.inv().apply(np.add(acceleration, [0, 0, 9.808]))
    return t, attitude, velocity, np.tile(spin, (n, 1)), force


def make_euroc(folder: Path, asl: bool) -> Path:
    t, attitude, velocity, gyro, force = euroc_world(400)
    position = np.column_stack([1 - np.cos(t), np.zeros_like(t), 1.0 + 0.1 * np.sin(t)])
    ns = [str(1_403_715_523_912_143_104 + 5_000_000 * i) for i in range(len(t))]
    imu_file, reference_file = folder / "V.txt", folder / "V_truth.csv"
    if asl:
        imu_file, reference_file = folder / euroc._IMU_FILE, folder / euroc._REFERENCE_FILE
    imu_header = ("#timestamp [ns]", *euroc._GYRO, *euroc._ACCEL)
    truth_header = ("#timestamp", *euroc._POSITION, *euroc._QUATERNION, *euroc._VELOCITY, "b_w_RS_S_x [rad s^-1]")
    truth = np.column_stack([position, attitude.as_quat(scalar_first=True), velocity, np.zeros(len(t))])
    for file, header, rows in (
        (imu_file, imu_header, np.column_stack([gyro, force])),
        (reference_file, truth_header, truth),
    ):
        file.parent.mkdir(parents=True, exist_ok=True)
        lines = [stamp + "," + ",".join(f"{v:.17g}" for v in row) for stamp, row in zip(ns, rows, strict=True)]
        file.write_text("\n".join([", ".join(header), *lines]) + "\n")
    if asl:
        imu_file.with_name("sensor.yaml").write_text(
            "sensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0.0]\nrate_hz: 200\n"
            "gyroscope_noise_density: 1.0e-04\ngyroscope_random_walk: 2.0e-05\n"
            "accelerometer_noise_density: 3.0e-3\naccelerometer_random_walk: 4.0e-3\n"
        )
    return folder


def reference_agrees_with_imu(dive: Dive) -> tuple[FloatArray, FloatArray]:
    """Gyro minus the reference's turn, specific force minus that of the reference's velocity; shape (M, 3) each."""
    imu, reference = dive.imu, dive.reference
    assert imu is not None
    assert reference is not None
    t, i, j = np.intersect1d(imu.t_ns, reference.t_ns, return_indices=True)
    dt = (np.diff(t) * 1e-9)[:, None]
    R_nb = matrix_from_rph(reference.rph[j])
    turns = Rotation.from_matrix(R_nb[:-1].swapaxes(1, 2) @ R_nb[1:]).as_rotvec() / dt
    p_n = ned_from_geodetic(dive.origin, reference.lat[j], reference.lon[j], reference.height[j])
    half = R_nb[:-1] @ Rotation.from_rotvec(turns * dt / 2).as_matrix()
    force = np.diff(reference.v_n[j], axis=0) / dt - gravity_n(dive.origin, p_n)[:-1]
    return imu.w_s[i][1:] - turns, imu.f_s[i][1:] - np.einsum("nij,ni->nj", half, force)


@pytest.mark.parametrize("asl", [True, False])
def test_euroc_frames_and_means_are_consistent(tmp_path: Path, asl: bool) -> None:
    reader, _ = guess_reader(make_euroc(tmp_path, asl))
    dive = reader.read(tmp_path)
    gyro, force = reference_agrees_with_imu(dive)
    assert np.abs(gyro).max() < 3e-7  # the local vertical turns by v / R = 1.6e-7 rad/s
    assert np.abs(force).max() < 2e-3  # the source's g is not the ellipsoid's
    assert dive.imu is not None
    assert dive.reference is not None
    assert dive.imu.w_s[0] == pytest.approx([0, 0, -0.2])  # a turn to the left is negative in FRD
    assert dive.imu.f_s[:, 2].mean() == pytest.approx(-9.808, abs=0.1)
    np.testing.assert_allclose(dive.reference.height[0], -9.0, atol=1e-6)
    assert dive.rig.imu.gyro_noise_density == (1e-4 if asl else euroc.EUROC_IMU.gyro_noise_density)


def test_euroc_without_reference_or_noise(tmp_path: Path) -> None:
    make_euroc(tmp_path, asl=True)
    sensor = tmp_path / "mav0/imu0/sensor.yaml"
    sensor.write_text(sensor.read_text().replace("2.0e-05", "many"))
    with pytest.raises(ConfigError, match="gyroscope_random_walk"):
        euroc.read(tmp_path)
    (tmp_path / euroc._REFERENCE_FILE).unlink()
    sensor.unlink()
    with pytest.raises(DataError, match="state_groundtruth_estimate0"):
        euroc.read(tmp_path)


@pytest.mark.data
def test_real_euroc(tmp_path: Path) -> None:
    report = import_dive(real("euroc"), tmp_path / "dive")
    assert report.format == "euroc"
    dive = read_dive(tmp_path / "dive")
    gyro, force = reference_agrees_with_imu(dive)
    # the biases that the data set states, in our axes: the mapping of axes and signs is right
    np.testing.assert_allclose(gyro.mean(axis=0), [0.0758, 0.0207, 0.0022], atol=5e-4)
    np.testing.assert_allclose(force.mean(axis=0), [0.093, 0.103, 0.013], atol=5e-3)


# --- guessing


def test_guesses_say_why_and_refusals_what_is_expected(tmp_path: Path) -> None:
    reader, reason = guess_reader(make_snapir(tmp_path / "run"))
    assert reader is snapir
    assert "IMU_*.csv" in reason
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="none of the known formats") as caught:
        guess_reader(tmp_path / "empty")
    assert all(reader.NAME in caught.value.remedy and reader.EXPECTS in caught.value.remedy for reader in READERS)
    with pytest.raises(DataError, match="no such"):
        guess_reader(tmp_path / "nowhere")
    with pytest.raises(ConfigError, match="known formats"):
        reader_named("kitti")
