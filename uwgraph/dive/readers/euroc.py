"""EuRoC in ASL layout (``mav0/imu0`` ...), or the flat pair of one IMU file and one reference file.

The source's IMU frame is x up, y right, z forward (Burri et al., IJRR 35, 2016; the camera looks along z), so FRD is
(z, y, -x). Its world has z up and an arbitrary heading: x is called north, -y east. The room is put at the nominal
coordinates of ETH Zurich, its floor 10 m below the surface of a sea, so that depth is positive. IMU samples are
instantaneous at the source; each becomes the mean of itself and its predecessor, and the first one is dropped.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BaseModel, Field
from scipy.spatial.transform import Rotation

from uwgraph.dive.logs.sampling import interval_means
from uwgraph.dive.model import Dive
from uwgraph.dive.rig import ImuRig, Rig
from uwgraph.dive.tables import Column, Table, read_table
from uwgraph.dive.yamlfile import read_settings
from uwgraph.errors import DataError
from uwgraph.frames import R_n_local, geodetic_from_ned, rph_from_matrix
from uwgraph.types import FloatArray, Imu, Origin, Reference

NAME: Final = "euroc"
EXPECTS: Final = (
    "a folder with mav0/imu0/data.csv and mav0/state_groundtruth_estimate0/data.csv, or with one IMU file "
    "(header '#timestamp [ns],w_RS_S_x ...') and one reference file (header '#timestamp, p_RS_R_x ...')"
)
CLOCKS_DIFFER: Final = False

ZURICH: Final = Origin(lat=float(np.radians(47.3769)), lon=float(np.radians(8.5417)))
FLOOR_DEPTH: Final = 10.0
"""m, where the room's floor is put."""

R_BS: Final = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Rotation from the source's IMU frame (up, right, forward) to FRD."""
R_NW: Final = np.diag([1.0, -1.0, -1.0])
"""Rotation from the source's world (z up) to NED, with its x called north."""

EUROC_IMU: Final = ImuRig(
    gyro_noise_density=1.6968e-4,
    accel_noise_density=2.0e-3,
    gyro_bias_walk=1.9393e-5,
    accel_bias_walk=3.0e-3,
    gyro_bias_sigma=0.1,
    accel_bias_sigma=0.2,
    gyro_range=7.86,
    accel_range=176.0,
)
"""ADIS16448 with the densities of the data set's ``sensor.yaml``."""

_IMU_FILE: Final = Path("mav0/imu0/data.csv")
_REFERENCE_FILE: Final = Path("mav0/state_groundtruth_estimate0/data.csv")
_GYRO: Final = tuple(f"w_RS_S_{a} [rad s^-1]" for a in "xyz")
_ACCEL: Final = tuple(f"a_RS_S_{a} [m s^-2]" for a in "xyz")
_POSITION: Final = tuple(f"p_RS_R_{a} [m]" for a in "xyz")
_QUATERNION: Final = tuple(f"q_RS_{a} []" for a in "wxyz")
_VELOCITY: Final = tuple(f"v_RS_R_{a} [m s^-1]" for a in "xyz")


class SensorFile(BaseModel):
    """The part of ``sensor.yaml`` that is used."""

    gyroscope_noise_density: Annotated[float, Field(gt=0)]
    gyroscope_random_walk: Annotated[float, Field(gt=0)]
    accelerometer_noise_density: Annotated[float, Field(gt=0)]
    accelerometer_random_walk: Annotated[float, Field(gt=0)]


def matches(path: Path) -> str:
    if (path / _IMU_FILE).is_file():
        return f"it holds {_IMU_FILE}"
    headers = [_header(file) for file in _candidates(path)]
    return "a file's header names w_RS_S_x and a_RS_S_x" if any(_is_imu(header) for header in headers) else ""


def read(path: Path) -> Dive:
    imu_file, reference_file = _files(path)
    imu = _read_imu(imu_file)
    sensor_file = imu_file.with_name("sensor.yaml")
    rig, noise = _rig(sensor_file)
    return Dive(
        origin=ZURICH,
        rig=rig,
        imu=imu,
        reference=_read_reference(reference_file),
        provenance={
            "format": NAME,
            "source": [imu_file.name, reference_file.name],
            "conversions": [
                "IMU axes (up, right, forward) turned to FRD: (z, y, -x)",
                "instantaneous IMU samples averaged with their predecessors to interval means; the first one dropped",
                f"world (z up) turned to NED with x called north; floor put at {FLOOR_DEPTH:g} m depth in Zurich",
                noise,
            ],
            "caveats": ["place and heading are nominal: the source's world has neither", "recorded in air"],
        },
    )


def _candidates(path: Path) -> list[Path]:
    return sorted([*path.glob("*.csv"), *path.glob("*.txt")]) if path.is_dir() else []


def _header(file: Path) -> list[str]:
    with file.open("rb") as opened:
        line = opened.readline(4096).decode("utf-8", errors="replace")
    return [name.strip() for name in line.split(",")]


def _is_imu(header: list[str]) -> bool:
    return _GYRO[0] in header and _ACCEL[0] in header


def _files(path: Path) -> tuple[Path, Path]:
    """The IMU file and the reference file."""
    if (path / _IMU_FILE).is_file():
        return path / _IMU_FILE, path / _REFERENCE_FILE
    headers = {file: _header(file) for file in _candidates(path)}
    imus = [file for file, header in headers.items() if _is_imu(header)]
    references = [file for file, header in headers.items() if _POSITION[0] in header]
    if len(imus) != 1 or len(references) != 1:
        raise DataError(
            f"{len(imus)} IMU files and {len(references)} reference files instead of one of each",
            where=str(path),
            remedy=f"give {EXPECTS}",
        )
    return imus[0], references[0]


def _read(file: Path, names: tuple[str, ...]) -> tuple[Table, str]:
    """The named columns, and the name of the stamps' column, which varies between copies of the data set."""
    stamp = (
        next((name for name in _header(file) if name.startswith("#timestamp")), "#timestamp") if file.is_file() else ""
    )
    columns = {stamp: Column("int")} | {name: Column() for name in names}
    return read_table(file, columns, ignore_others=True), stamp


def _vectors(table: Table, names: tuple[str, ...]) -> FloatArray:
    return np.stack([table[name] for name in names], axis=-1)


def _read_imu(file: Path) -> Imu:
    table, stamp = _read(file, _GYRO + _ACCEL)
    if len(table[stamp]) < 2:
        raise DataError("holds a single sample", where=str(file), remedy="copy the recording again")
    return Imu(
        table[stamp][1:],
        f_s=interval_means(_vectors(table, _ACCEL)) @ R_BS.T,
        w_s=interval_means(_vectors(table, _GYRO)) @ R_BS.T,
    )


def _read_reference(file: Path) -> Reference:
    table, stamp = _read(file, _POSITION + _QUATERNION + _VELOCITY)
    p_n = _vectors(table, _POSITION) @ R_NW.T + [0.0, 0.0, FLOOR_DEPTH]
    lat, lon, height = geodetic_from_ned(ZURICH, p_n)
    R_local_n = np.swapaxes(R_n_local(ZURICH, lat, lon), -1, -2)
    R_nb = R_NW @ _rotations(file, _vectors(table, _QUATERNION)) @ R_BS.T
    v_n = _vectors(table, _VELOCITY) @ R_NW.T
    return Reference(
        table[stamp],
        lat,
        lon,
        height,
        rph=rph_from_matrix(R_local_n @ R_nb),
        v_n=np.einsum("nij,nj->ni", R_local_n, v_n),
    )


def _rotations(file: Path, wxyz: FloatArray) -> FloatArray:
    off = ~(np.abs(np.linalg.norm(wxyz, axis=1) - 1.0) < 1e-2)
    if off.any():
        row = int(off.argmax())
        raise DataError(
            f"line {row + 2} is no unit quaternion", where=f"{file}: {_QUATERNION[0]}", remedy="remove the line"
        )
    matrices: Any = Rotation.from_quat(wxyz, scalar_first=True).as_matrix()
    return np.asarray(matrices, dtype=np.float64)


def _rig(sensor_file: Path) -> tuple[Rig, str]:
    """The rig, and where its noise comes from."""
    if not sensor_file.is_file():
        return Rig(imu=EUROC_IMU), "IMU noise of the data set's ADIS16448: there is no sensor.yaml"
    noise = read_settings(SensorFile, sensor_file)
    imu = EUROC_IMU.model_copy(
        update={
            "gyro_noise_density": noise.gyroscope_noise_density,
            "gyro_bias_walk": noise.gyroscope_random_walk,
            "accel_noise_density": noise.accelerometer_noise_density,
            "accel_bias_walk": noise.accelerometer_random_walk,
        }
    )
    return Rig(imu=imu), "IMU noise from sensor.yaml"
