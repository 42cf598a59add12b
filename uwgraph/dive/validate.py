"""What a stream must satisfy before anything is computed from it: shapes, finite numbers, stamps, units, frame.

Only what cannot be right is refused here; what merely looks odd is for ``uwgraph check``. Rows count from 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from uwgraph.dive.layout import LAYOUT, triangle_order
from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.frames import ned_from_geodetic
from uwgraph.time import isoformat
from uwgraph.types import (
    Altitude,
    BoolArray,
    Depth,
    Dvl,
    Fixes,
    FloatArray,
    Heading,
    Imu,
    Origin,
    Reference,
    RelativePoses,
    Stream,
    Sun,
    TimeArray,
    stream_fields,
)

EARLIEST_NS: Final = 631_152_000_000_000_000
"""1990-01-01, before which no stamp is believed."""
LATEST_NS: Final = 4_102_444_800_000_000_000
"""2100-01-01, after which none is."""
MAX_DISTANCE: Final = 500e3
"""m from the origin, beyond which a position is taken for a mistake."""
MAX_IMU_GAP_S: Final = 1.0
"""s without an inertial sample, beyond which nothing carries the attitude across."""
MAX_TURN: Final = 35.0
"""rad/s, above the full scale of any gyro in use."""
MAX_TURN_RMS: Final = 3.0
"""rad/s sustained, more than any vehicle turns for a whole dive."""

SHARED_STAMPS: Final = ("fixes", "sun", "odometry", "closures")
"""Streams with several sources, where two samples may share a stamp."""
OPTIONAL: Final = {
    "dvl": ("cov_s",),
    "depth": ("sigma",),
    "fixes": ("height", "cov_n"),
    "heading": ("sigma",),
    "sun": ("cov_b",),
    "altitude": ("sigma",),
    "reference": ("lat", "lon", "height", "rph", "v_n"),
}
"""Fields where NaN stands for 'not known'."""


def validate_dive(dive: Dive, where: str | Mapping[str, str] = "dive") -> None:
    """Validate every stream, and the streams against origin and rig.

    Parameters
    ----------
    dive : Dive
        The dive.
    where : str or mapping
        The folder, or the file of each stream, for the messages.

    Raises
    ------
    DataError
        For the first fault found.
    """
    files = where if isinstance(where, Mapping) else {}
    folder = "dive" if isinstance(where, Mapping) else where
    named = [*dive.streams(), *((f"images/{camera}", images) for camera, images in dive.images.items())]
    for name, stream in named:
        place = files.get(name, str(Path(folder) / name))
        validate_stream(name.partition("/")[0], stream, place)
        if isinstance(stream, Fixes | Reference):
            _near_origin(stream, dive.origin, place)
        if isinstance(stream, Imu):
            _gravity_down(stream, dive.rig.imu.R_bs, place)


def validate_stream(name: str, stream: Stream, where: str) -> None:
    """Validate one stream by itself.

    Parameters
    ----------
    name : str
        ``imu``, ``dvl``, ..., ``reference`` or ``images``.
    stream : Stream
        Its samples.
    where : str
        Its file, for the messages.

    Raises
    ------
    DataError
        When shapes disagree, a needed number is not finite, stamps are not int64 nanoseconds in order, or units or
        signs cannot be those of the convention.
    """
    _shapes(name, stream, where)
    _stamps(stream.t_ns, where, shared=name in SHARED_STAMPS)
    _finite(name, stream, where)
    if check := _CHECKS.get(type(stream)):
        check(stream, where)


def _shapes(name: str, stream: Stream, where: str) -> None:
    if stream.t_ns.ndim != 1 or len(stream) == 0:
        raise DataError("holds no samples", where=where, remedy="leave the stream out, or record it again")
    for key, array in stream_fields(stream):
        width = len(LAYOUT[name][key].columns)
        wanted = (len(stream), *{1: (), 3: (3,), 6: (3, 3), 21: (6, 6)}[width])
        if array.shape != wanted:
            raise DataError(
                f"has shape {array.shape}, {wanted} is needed", where=f"{where}: {key}", remedy="one row per stamp"
            )


def _stamps(t_ns: TimeArray, where: str, *, shared: bool) -> None:
    where = f"{where}: t_ns"
    if t_ns.dtype != np.int64:
        raise DataError(f"stamps are {t_ns.dtype}", where=where, remedy="use int64 nanoseconds: floats lose digits")
    outside = (t_ns < EARLIEST_NS) | (t_ns > LATEST_NS)
    if outside.any():
        row = int(outside.argmax())
        raise DataError(
            f"row {row + 1} holds {t_ns[row]}, which is no time between 1990 and 2100 in nanoseconds UTC",
            where=where,
            remedy=_stamp_remedy(int(t_ns[row])),
        )
    steps = np.diff(t_ns)
    wrong = steps < 0 if shared else steps <= 0
    if wrong.any():
        row = int(wrong.argmax()) + 1
        before, after = isoformat(int(t_ns[row - 1])), isoformat(int(t_ns[row]))
        if steps[row - 1] == 0:
            problem, remedy = f"rows {row} and {row + 1} have the same stamp, {after}", "remove one of them"
        else:
            problem = f"time runs backward from {before} in row {row} to {after} in row {row + 1}"
            remedy = "sort the rows if they were only shuffled; cut the recording there if the clock was set"
        raise DataError(f"{problem} ({int(wrong.sum())} such rows)", where=where, remedy=remedy)


def _stamp_remedy(stamp: int) -> str:
    for unit, scale in (("seconds", 10**9), ("milliseconds", 10**6), ("microseconds", 10**3)):
        if EARLIEST_NS <= stamp * scale <= LATEST_NS:
            return f"looks like {unit}: multiply by {scale}"
    return "stamps count from 1970-01-01 UTC; add the start of a recording that counts from its own start"


def _finite(name: str, stream: Stream, where: str) -> None:
    """Finite numbers everywhere, but NaN where it means 'not known' and samples marked as invalid."""
    counted = stream.valid if isinstance(stream, Dvl) else np.ones(len(stream), dtype=np.bool_)
    for key, array in stream_fields(stream):
        if array.dtype.kind != "f" or key == "cov_n":
            continue
        optional = key in OPTIONAL.get(name, ())
        bad = np.isinf(array) if optional else ~np.isfinite(array) & counted.reshape(-1, *[1] * (array.ndim - 1))
        if bad.any():
            row, *axes = (int(i) for i in np.argwhere(bad)[0])
            raise DataError(
                f"row {row + 1} holds {array[(row, *axes)]}",
                where=f"{where}: {_column(name, key, axes)}",
                remedy="remove the row" if not optional else "leave unknown values empty (NaN)",
            )


def _column(name: str, key: str, axes: list[int]) -> str:
    """The file's column of one element of a field."""
    columns = LAYOUT[name][key].columns
    if len(axes) < 2:
        return columns[sum(axes)]
    row, column = sorted(axes)
    n = triangle_order(len(columns))
    return columns[row * n - row * (row - 1) // 2 + column - row]


def _refuse(bad: BoolArray | np.bool_, problem: str, where: str, remedy: str) -> None:
    """An error that names the first bad row, if there is one."""
    if np.any(bad):
        raise DataError(f"row {int(np.argmax(bad)) + 1} {problem}", where=where, remedy=remedy)


def _imu(imu: Imu, where: str) -> None:
    gaps = np.diff(imu.t_ns) * 1e-9
    if len(gaps) and gaps.max() > MAX_IMU_GAP_S:
        row = int(gaps.argmax()) + 1
        raise DataError(
            f"no sample for {gaps.max():.1f} s after row {row} ({isoformat(int(imu.t_ns[row - 1]))})",
            where=f"{where}: t_ns",
            remedy="cut the recording into two dives there: nothing carries the attitude across such a gap",
        )
    turn = np.linalg.norm(imu.w_s, axis=1)
    rms = float(np.sqrt(np.mean(turn**2)))
    if turn.max() > MAX_TURN or rms > MAX_TURN_RMS:
        raise DataError(
            f"rates reach {turn.max():.3g} and have an rms of {rms:.3g}, which is no rad/s of a vehicle",
            where=f"{where}: w_x, w_y, w_z",
            remedy="looks like deg/s: multiply by pi/180" if rms < MAX_TURN_RMS * 60 else "w is in rad/s",
        )
    force = float(np.median(np.linalg.norm(imu.f_s, axis=1)))
    if not 5.0 < force < 20.0:
        units = (("g: multiply by 9.80665", 0.8, 1.2), ("mg: multiply by 0.00980665", 800, 1200))
        looks = [f"looks like {text}" for text, low, high in units if low < force < high]
        raise DataError(
            f"the specific force has a median of {force:.3g}, but 9.8 m/s^2 holds a vehicle up",
            where=f"{where}: f_x, f_y, f_z",
            remedy=looks[0] if looks else "f is the specific force in m/s^2, with gravity in it",
        )


def _gravity_down(imu: Imu, R_bs: FloatArray, where: str) -> None:
    f_b = R_bs @ imu.f_s.mean(axis=0)
    if f_b[2] > 0:
        raise DataError(
            f"the mean specific force in the body is ({f_b[0]:.2f}, {f_b[1]:.2f}, {f_b[2]:.2f}): the vehicle would "
            "hang upside down",
            where=f"{where}: f_x, f_y, f_z",
            remedy="an FRD sensor at rest reads (0, 0, -9.8); for an FLU one set rig.imu.rotation_deg to [180, 0, 0]",
        )


def _dvl(dvl: Dvl, where: str) -> None:
    speed = np.linalg.norm(dvl.v_s[dvl.valid], axis=1)
    if len(speed) and np.median(speed) > 20.0:
        raise DataError(
            f"the median speed is {np.median(speed):.3g} m/s",
            where=f"{where}: v_x, v_y, v_z",
            remedy="looks like cm/s or mm/s: divide by 100 or 1000",
        )
    _covariances(dvl.cov_s, f"{where}: cov_xx")


def _depth(depth: Depth, where: str) -> None:
    middle = float(np.median(depth.depth))
    if middle < -2.0:
        raise DataError(
            f"the median depth is {middle:.3g} m, above the sea",
            where=f"{where}: depth",
            remedy="depth is positive down: change the sign",
        )
    _refuse(
        depth.depth > 12_000.0,
        "is deeper than any sea",
        f"{where}: depth",
        "depth is in metres, pressure in pascals above that at the surface",
    )
    _sigmas(depth.sigma, f"{where}: sigma")


def _fixes(fixes: Fixes, where: str) -> None:
    _place(fixes.lat, fixes.lon, where)
    _covariances(fixes.cov_n, f"{where}: cov_nn")


def _heading(heading: Heading, where: str) -> None:
    _turns(heading.heading, f"{where}: heading_deg")
    _sigmas(heading.sigma, f"{where}: sigma_deg")


def _sun(sun: Sun, where: str) -> None:
    _refuse(
        np.abs(np.linalg.norm(sun.s_b, axis=1) - 1.0) > 1e-3,
        "is not a unit vector",
        f"{where}: s_x, s_y, s_z",
        "divide by its length",
    )
    _covariances(sun.information_b, f"{where}: info_xx")
    _covariances(sun.cov_b, f"{where}: cov_xx")


def _altitude(altitude: Altitude, where: str) -> None:
    _refuse(altitude.altitude <= 0.0, "is not above the bottom", f"{where}: altitude", "leave such samples out")
    _sigmas(altitude.sigma, f"{where}: sigma")


def _relative_poses(poses: RelativePoses, where: str) -> None:
    _refuse(
        poses.from_ns >= poses.t_ns,
        "does not begin before it ends",
        f"{where}: from_ns",
        "from_ns is the earlier moment: invert the pose where it was told the other way round",
    )
    _refuse(
        np.linalg.norm(poses.rotvec, axis=1) > np.pi + 1e-6,
        "turns by more than half a turn",
        f"{where}: rot_x_deg",
        "give the shortest rotation vector, degrees in files and radians in memory",
    )
    _covariances(poses.cov, f"{where}: cov_rxrx")
    unsure = np.diagonal(poses.cov, axis1=1, axis2=2).min(axis=1) > 0.0
    _refuse(~unsure, "has a variance of zero", f"{where}: cov_rxrx", "state how sure it is: nothing is known exactly")


def _reference(reference: Reference, where: str) -> None:
    _place(reference.lat, reference.lon, where)
    for column, angle in zip(("roll_deg", "pitch_deg", "heading_deg"), reference.rph.T, strict=True):
        _turns(angle, f"{where}: {column}")
    _refuse(
        np.abs(reference.height) > 20_000.0,
        "is beyond any sea and sky",
        f"{where}: height",
        "height is in metres above the sea surface, negative below it",
    )


def _place(lat: FloatArray, lon: FloatArray, where: str) -> None:
    _refuse(np.abs(lat) > np.pi / 2 + 1e-9, "is no latitude", f"{where}: lat_deg", "degrees north, -90 to 90")
    _refuse(np.abs(lon) > 2 * np.pi + 1e-9, "is no longitude", f"{where}: lon_deg", "degrees east, -180 to 360")


def _turns(angle: FloatArray, where: str) -> None:
    _refuse(np.abs(angle) > 2 * np.pi + 1e-9, "is more than a turn", where, "degrees in files, radians in memory")


def _sigmas(sigma: FloatArray, where: str) -> None:
    _refuse(sigma <= 0, "is not positive", where, "give the 1-sigma, or leave it empty (NaN) if unknown")


def _covariances(cov: FloatArray, where: str) -> None:
    """Positive semidefinite, wholly known or wholly NaN; infinite variances may stand on the diagonal."""
    unknown = np.isnan(cov)
    partly = unknown.any(axis=(1, 2)) & ~unknown.all(axis=(1, 2))
    _refuse(partly, "is known in part", where, "give all its elements, or none")
    bad: BoolArray = np.any(np.diagonal(cov, axis1=1, axis2=2) < 0, axis=1)
    known = np.isfinite(cov).all(axis=(1, 2))
    eigenvalues = np.linalg.eigvalsh(cov[known])
    bad[known] = eigenvalues[:, 0] < -1e-9 * np.abs(eigenvalues[:, -1])
    _refuse(bad, "is no covariance: it has a negative variance or eigenvalue", where, "check units and off-diagonals")


def _near_origin(stream: Fixes | Reference, origin: Origin, where: str) -> None:
    """Positions that only a mistake in units or order puts so far away."""
    ned = ned_from_geodetic(origin, stream.lat, stream.lon, np.nan_to_num(stream.height))
    distance = np.nan_to_num(np.linalg.norm(ned, axis=1))
    _refuse(
        distance > MAX_DISTANCE,
        f"lies more than {MAX_DISTANCE / 1e3:.0f} km from the origin",
        f"{where}: lat_deg, lon_deg",
        "latitudes and longitudes are in degrees; check them, and the origin in dive.yaml",
    )


_Check = Callable[[Any, str], None]
_CHECKS: Final[Mapping[type[Stream], _Check]] = {
    Imu: _imu,
    Dvl: _dvl,
    Depth: _depth,
    Fixes: _fixes,
    Heading: _heading,
    Sun: _sun,
    Altitude: _altitude,
    RelativePoses: _relative_poses,
    Reference: _reference,
}
