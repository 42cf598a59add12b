"""Trajectories read from files of others and of ours: TUM, and tables as CSV or Parquet."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

import numpy as np

from uwgraph.dive.logs.axes import turn, turned_attitude
from uwgraph.errors import DataError
from uwgraph.evaluate.pose_columns import PoseColumns, read_pose_columns
from uwgraph.evaluate.reference import known_rows
from uwgraph.evaluate.trajectory import Trajectory, trajectory_of, trajectory_of_places
from uwgraph.evaluate.tum_file import MAX_METRES, UNIT_WITHIN, read_bytes, read_tum
from uwgraph.frames import matrix_from_rph, origin_from, rph_from_matrix
from uwgraph.types import BoolArray, FloatArray, Origin, Reference

FrameName = Literal["ned", "enu"]
Axes = tuple[str, str]
"""World and body axes: ``ned``, ``frd``."""

AXES: Final[dict[FrameName, Axes]] = {"ned": ("ned", "frd"), "enu": ("enu", "flu")}
_EUROC: Final[Axes] = ("nwu", "urf")
_XYZW: Final = ("qx", "qy", "qz", "qw")
_PLACES: Final = (("lat", "lon"), ("north", "east"), ("x", "y"))
_KNOWN: Final = "lat, lon and height or depth; north, east, down; x, y, z; qx, qy, qz, qw or roll, pitch, heading"


def read_trajectory(path: str | Path, frame: FrameName | None = None) -> Trajectory:
    """The trajectory of a TUM file, or of a table (``.parquet``, or text with a header line) with columns it knows.

    Parameters
    ----------
    frame : {"ned", "enu"}, optional
        World and body axes of x, y, z and of quaternions: NED and FRD, or ENU and FLU. By default those that the file
        states (files of uwgraph do), else NED, and the trajectory says that this was assumed. Columns that are called
        north, east, down, lat, lon, roll, pitch or heading state them.

    Raises
    ------
    DataError
        When the file is missing, empty, cut off, too large, or holds no poses in time order, naming line and column.
    """
    file = Path(path)
    if file.suffix != ".parquet" and _looks_like_tum(file):
        return _from_tum(file, frame)
    return _from_table(file, frame)


def as_if(trajectory: Trajectory, frame: FrameName) -> Trajectory:
    """A trajectory whose frame was assumed to be NED, had it been another."""
    world, body = AXES[frame]
    turned = trajectory_of(
        trajectory.t_ns,
        _to_ned(trajectory.p_n, world),
        R_nb=turn(world) @ trajectory.R_nb @ turn(body).T,
        origin=trajectory.origin,
    )
    return replace(turned, frame=_words((world, body)))


def _looks_like_tum(file: Path) -> bool:
    """Whether the first line that is no comment holds numbers between spaces; raises where it is no text."""
    with_header = re.compile(rb"[A-Za-z_]{2,}|[,;]")
    for line in read_bytes(file).splitlines():
        if line.strip() and not line.lstrip().startswith(b"#"):
            return with_header.search(re.sub(rb"(?i)\b(nan|inf)\b", b"0", line)) is None
    return True


def _from_tum(file: Path, frame: FrameName | None) -> Trajectory:
    poses = read_tum(file)
    axes = AXES[frame] if frame else poses.axes or AXES["ned"]
    world, body = axes
    origin = Origin(*np.radians(poses.origin_deg).tolist()) if poses.origin_deg else None
    return replace(
        trajectory_of(poses.t_ns, _to_ned(poses.p, world), R_nb=turned_attitude(poses.q, body, world), origin=origin),
        frame=_words(axes),
        assumed=frame is None and poses.axes is None,
    )


def _from_table(file: Path, frame: FrameName | None) -> Trajectory:
    columns = read_pose_columns(file)
    _check(file, columns)
    angles = columns.in_unstated_degrees
    caveats = (f"{file.name}: {', '.join(angles)} taken as degrees, as no unit is stated",) if angles else ()
    return replace(_of_columns(file, columns, frame), caveats=caveats)


def _of_columns(file: Path, columns: PoseColumns, frame: FrameName | None) -> Trajectory:
    if columns.has("lat", "lon"):
        return _placed(columns)
    if columns.has("north", "east"):
        ned = np.column_stack([columns.stack("north", "east"), _down(columns)])
        return _local(columns, ned, AXES["ned"])
    if not columns.has("x", "y"):
        found = ", ".join(columns.names.values()) or "none"
        raise DataError(
            f"has no columns of position; those known of it: {found}",
            where=str(file),
            remedy=f"name them {_KNOWN}, with the unit behind, as in 'x [m]'",
        )
    of_euroc = columns.names["x"].lstrip("# ").lower().startswith("p_rs_r")
    axes = AXES[frame] if frame else _EUROC if of_euroc else AXES["ned"]
    local = _local(columns, _to_ned(columns.stack("x", "y", "z"), axes[0]), axes)
    return replace(local, assumed=frame is None and not of_euroc)


def _local(columns: PoseColumns, p_n: FloatArray, axes: Axes) -> Trajectory:
    return replace(
        trajectory_of(
            columns.t_ns,
            p_n,
            R_nb=_attitude(columns, axes),
            rph=columns.stack("roll", "pitch", "heading") if axes == AXES["ned"] else None,
            v_n=columns.stack("v_n", "v_e", "v_d"),
            cov_p_n=_position_covariance(columns),
            cov_rph=_angle_covariance(columns),
        ),
        frame=_words(axes),
    )


def _placed(columns: PoseColumns) -> Trajectory:
    """Of latitude and longitude: in n of the origin that north, east and down imply, or else of the first place."""
    height = columns.found.get("up", -columns.stack("down")[:, 0])
    rph = columns.stack("roll", "pitch", "heading")
    if columns.has(*_XYZW):
        rph = rph_from_matrix(_attitude(columns, AXES["ned"]))
    lat, lon = columns.found["lat"], columns.found["lon"]
    ned = columns.stack("north", "east", "down")
    origin = Origin(float(lat[0]), float(lon[0]))
    full = known_rows(ned) & np.isfinite(height)
    if full.any():
        k = int(full.argmax())
        origin = origin_from(float(lat[k]), float(lon[k]), float(height[k]), ned[k])
    reference = Reference(columns.t_ns, lat, lon, height, rph, columns.stack("v_n", "v_e", "v_d"))
    return replace(
        trajectory_of_places(reference, origin),
        cov_p_n=_position_covariance(columns),
        cov_rph=_angle_covariance(columns),
        frame="latitude, longitude",
    )


def _to_ned(p: FloatArray, world: str) -> FloatArray:
    """Positions in other axes, shape (K, 3), in NED; a height that is not known leaves the rest alone."""
    R = turn(world)
    source = np.abs(R).argmax(axis=1)
    ned: FloatArray = p[:, source] * R[np.arange(3), source]
    return ned


def _down(columns: PoseColumns) -> FloatArray:
    """Down of what tells the height beside north and east; a lone ``u`` may as well be a speed."""
    up = columns.stack("up" if columns.has("up") else "u")[:, 0]
    down: FloatArray = columns.found.get("down", -up)
    return down


def _attitude(columns: PoseColumns, axes: Axes) -> FloatArray:
    """R_nb of the quaternions, or of angles where the axes are ours, shape (K, 3, 3); NaN where not known."""
    world, body = axes
    if not columns.has(*_XYZW):
        angles = columns.stack("roll", "pitch", "heading")
        return matrix_from_rph(angles if axes == AXES["ned"] else np.full_like(angles, np.nan))
    xyzw = columns.stack(*_XYZW)
    R = np.full((len(xyzw), 3, 3), np.nan)
    known = known_rows(xyzw)
    R[known] = turned_attitude(xyzw[known], body, world)
    return R


def _position_covariance(columns: PoseColumns) -> FloatArray:
    cov = columns.stack("sigma_north", "sigma_east", "sigma_down")[:, :, None] ** 2 * np.eye(3)
    if columns.has("cov_north_east", "cov_north_down", "cov_east_down"):
        cross = columns.stack("cov_north_east", "cov_north_down", "cov_east_down")
        cov[:, [0, 0, 1], [1, 2, 2]] = cov[:, [1, 2, 2], [0, 0, 1]] = cross
    return cov


def _angle_covariance(columns: PoseColumns) -> FloatArray:
    cov: FloatArray = columns.stack("sigma_roll", "sigma_pitch", "sigma_heading")[:, :, None] ** 2 * np.eye(3)
    return cov


def _check(file: Path, columns: PoseColumns) -> None:
    """Places, stamps and quaternions that can be; NaN stands for heights and attitudes that are not known."""

    def refuse(names: Sequence[str], bad: BoolArray, problem: str) -> None:
        if bad.any():
            row = int(bad.argmax())
            shown = [f"{columns.found[name][row]:.6g}" for name in names] or [f"{columns.t_ns[row]} ns"]
            raise DataError(
                f"row {row + 1} {problem}: {', '.join(shown)}" + (" (SI units)" if names else ""),
                where=f"{file}: {', '.join(columns.names[name] for name in names) or 'time'}",
                remedy="repair or remove the row",
            )

    group = next((group for group in _PLACES if columns.has(*group)), ())
    limit = [np.pi / 2, 2 * np.pi] if group == ("lat", "lon") else [MAX_METRES] * len(group)
    for name in columns.found:
        size = np.abs(columns.found[name])
        if name in group:
            refuse([name], ~(size <= limit[group.index(name)]), "holds no position")
        else:
            refuse([name], size > MAX_METRES, "is no number of a pose")
    if columns.has(*_XYZW):
        refuse(
            _XYZW, np.abs(np.linalg.norm(columns.stack(*_XYZW), axis=1) - 1.0) > UNIT_WITHIN, "is no unit quaternion"
        )
    refuse((), np.concatenate([[False], np.diff(columns.t_ns) <= 0]), "has a stamp that does not come after the last")


def _words(axes: Axes) -> str:
    world, body = axes
    return f"{world.upper()} world, {body.upper()} body"
