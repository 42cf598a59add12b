"""The Snapir layout: one folder with ``IMU_*.csv``, ``DVL_*.csv`` and ``GT_*.csv``, stamps in seconds from the start.

At the source, y of the accelerometer and of the gyro point to the left while x and z are forward and down, a
left-handed frame; negating y of both gives the FRD body of the DVL and the reference. The date of the recordings is
known, the time of day is not: stamps count from midnight. There is no depth log; depth is the reference's altitude.

Recordings: ansfl/A-KIT (Cohen & Klein, Engineering Applications of AI 146, 2025).
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from uwgraph.dive.model import Dive
from uwgraph.dive.rig import DepthRig, DvlRig, ImuRig, Rig
from uwgraph.dive.tables import Column, Table, read_table
from uwgraph.dive.timing import unstretch
from uwgraph.errors import DataError
from uwgraph.time import from_seconds
from uwgraph.types import Depth, Dvl, Imu, Origin, Reference, TimeArray

NAME: Final = "snapir"
EXPECTS: Final = "a folder with IMU_*.csv, DVL_*.csv and GT_*.csv of one run"
CLOCKS_DIFFER: Final = True

START_NS: Final = 1_654_646_400_000_000_000
"""2022-06-08T00:00:00Z."""

SNAPIR_RIG: Final = Rig(
    imu=ImuRig(
        gyro_noise_density=1e-5,
        accel_noise_density=1e-3,
        gyro_bias_walk=1e-9,
        accel_bias_walk=1e-5,
        gyro_bias_sigma=1e-6,
        accel_bias_sigma=1e-2,
    ),
    dvl=DvlRig(
        translation_m=(-0.04, -0.02, 0.21),
        rotation_deg=(0.04, -0.067, -0.26),
        scale=0.9992,
        sigma=0.02,
        scale_sigma=0.002,
        misalignment_sigma_deg=0.1,
    ),
    depth=DepthRig(sigma=0.05),
)
"""FOG-grade IMU. The DVL's place, mounting and scale are what smoothing runs 1, 2, 4 and 6 estimates from IMU and DVL
alone (mounting about z 0.22 to 0.29 deg, sigma 0.06 to 0.12; the reference has no part in it)."""

_TIME: Final = "Time [s]"
_COLUMNS: Final = {
    "IMU": (_TIME, *(f"ACC {a} [m/s^2]" for a in "XYZ"), *(f"GYRO {a} [rad/s]" for a in "XYZ")),
    "DVL": (_TIME, *(f"DVL {a} [m/s]" for a in "XYZ")),
    "GT": (
        _TIME,
        *("Longitude [rad]", "Latitude [rad]", "Altitude [m]"),
        *("V North [m/s]", "V East [m/s]", "V Down [m/s]"),
        *("Roll [rad]", "Pitch [rad]", "Yaw [rad]"),
    ),
}
_FRD_OF_SOURCE: Final = np.array([1.0, -1.0, 1.0])


def matches(path: Path) -> str:
    found = [kind for kind in _COLUMNS if any(path.glob(f"{kind}_*.csv"))]
    return f"it holds {', '.join(f'{kind}_*.csv' for kind in found)}" if len(found) >= 2 else ""


def read(path: Path) -> Dive:
    files = {kind: _the_file(path, kind) for kind in _COLUMNS}
    tables = {kind: read_table(file, {name: Column() for name in _COLUMNS[kind]}) for kind, file in files.items()}
    _check_spans(path, tables)
    _check_radians(files["GT"], tables["GT"])
    notes: list[str] = []
    imu, dvl, reference = (_stamps(kind, files[kind], table, notes) for kind, table in tables.items())
    _, lon, lat, height, *motion = (tables["GT"][name] for name in _COLUMNS["GT"])
    return Dive(
        origin=Origin(lat=float(lat[0]), lon=float(lon[0])),
        rig=SNAPIR_RIG,
        imu=Imu(
            imu,
            f_s=_columns(tables["IMU"], "IMU", 1) * _FRD_OF_SOURCE,
            w_s=_columns(tables["IMU"], "IMU", 4) * _FRD_OF_SOURCE,
        ),
        dvl=Dvl(
            dvl,
            v_s=_columns(tables["DVL"], "DVL", 1),
            cov_s=np.full((len(dvl), 3, 3), np.nan),
            valid=np.ones(len(dvl), dtype=np.bool_),
        ),
        depth=Depth(reference, depth=-height, sigma=np.full(len(reference), SNAPIR_RIG.depth.sigma)),
        reference=Reference(
            reference, lat, lon, height, rph=np.stack(motion[3:], axis=-1), v_n=np.stack(motion[:3], axis=-1)
        ),
        provenance={
            "format": NAME,
            "source": [file.name for file in files.values()],
            "conversions": [
                "y of accelerometer and gyro negated: the source's IMU frame is left-handed, ours is FRD",
                *notes,
                "origin: the reference's first position",
            ],
            "caveats": [
                "time of day unknown: stamps count from 2022-06-08T00:00:00Z",
                "IMU samples are taken as means over the interval before their stamp",
                "depth from the reference: not independent",
                "the reference is an INS that used these sensors: not independent",
                "sensor noise is not stated by the source: figures of the vehicle's grade",
            ],
        },
    )


def _the_file(path: Path, kind: str) -> Path:
    found = sorted(path.glob(f"{kind}_*.csv"))
    if len(found) == 1:
        return found[0]
    raise DataError(
        f"{len(found)} files {kind}_*.csv instead of one",
        where=str(path),
        remedy=f"name the folder of one run, complete: {EXPECTS}",
    )


def _columns(table: Table, kind: str, first: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Three neighbouring columns as vectors, shape (N, 3)."""
    return np.stack([table[name] for name in _COLUMNS[kind][first : first + 3]], axis=-1)


def _stamps(kind: str, file: Path, table: Table, notes: list[str]) -> TimeArray:
    """Stamps with the stretch undone, if there is one; a note says so."""
    stated = table[_TIME]
    if not np.isfinite(stated).all():
        row = int(np.argmin(np.isfinite(stated)))
        raise DataError(f"line {row + 2} holds {stated[row]}", where=f"{file}: {_TIME}", remedy="remove the line")
    t_s, stretch = unstretch(stated)
    if stretch:
        notes.append(
            f"{kind} stamps were stretched: stated period {stretch.stated_period_s:.8f} s, true period "
            f"{stretch.true_period_s:g} s, {stretch.ppm:.0f} ppm"
        )
    return from_seconds(t_s, START_NS)


def _check_spans(path: Path, tables: dict[str, Table]) -> None:
    """The three files of a run cover the same time; otherwise one of them is cut off."""
    spans = {kind: float(np.ptp(table[_TIME])) for kind, table in tables.items()}
    shortest = min(spans, key=lambda kind: spans[kind])
    longest = max(spans.values())
    if spans[shortest] < 0.99 * longest - 2.0:
        raise DataError(
            f"covers {spans[shortest]:.1f} s of the run's {longest:.1f} s: it is cut off",
            where=str(_the_file(path, shortest)),
            remedy="copy it again",
        )


def _check_radians(file: Path, table: Table) -> None:
    names = [name for name in _COLUMNS["GT"] if name.endswith("[rad]")]
    for name in names:
        limit = np.pi / 2 if name.startswith("Latitude") else 2 * np.pi
        wrong = np.abs(table[name]) > limit + 1e-9
        if wrong.any():
            row = int(wrong.argmax())
            raise DataError(
                f"line {row + 2} holds {table[name][row]:g}, which is no angle in radians",
                where=f"{file}: {name}",
                remedy="looks like degrees: multiply by pi/180",
            )
