"""Poses as lines of text: TUM, KITTI, and our own columns as CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uwgraph.dive.layout import table_from_stream
from uwgraph.dive.tables import Table, write_table
from uwgraph.evaluate.table import tum_lines
from uwgraph.export.axes import Axes
from uwgraph.export.track import Track, table_of_track
from uwgraph.time import NS
from uwgraph.types import Fixes


def write_tum(track: Track, path: Path, axes: Axes) -> None:
    """``t x y z qx qy qz qw``, the quaternion body to world; a comment names the frames and the origin."""
    lat, lon = np.degrees([track.origin.lat, track.origin.lon])
    head = f"# {axes}; origin {lat:.9f} N, {lon:.9f} E (WGS-84), seconds UTC\n# t x y z qx qy qz qw\n"
    path.write_text(
        head + tum_lines(track.t_ns, axes.position(track), axes.rotation(track)), encoding="utf-8", newline="\n"
    )


def write_kitti(track: Track, path: Path, axes: Axes) -> None:
    """Rows of [R | p], body to world, row by row; no comment, since KITTI's own tools take none."""
    T = np.concatenate([axes.rotation(track), axes.position(track)[:, :, None]], axis=2)
    np.savetxt(path, T.reshape(len(track), 12), fmt="%.9f")


def write_kitti_times(track: Track, path: Path) -> None:
    """Seconds UTC with 9 decimals, one line per pose."""
    lines = (f"{t // NS}.{t % NS:09d}\n" for t in track.t_ns.tolist())
    path.write_text("".join(lines), encoding="utf-8", newline="\n")


def write_csv(track: Track | None, fixes: Fixes | None, path: Path) -> None:
    """The columns of ``solution.parquet`` as far as they are known, or without a track those of a dive's ``fixes``."""
    if track is not None:
        write_columns(table_of_track(track), path)
    elif fixes is not None:
        write_columns(table_from_stream("fixes", fixes), path)


def write_columns(table: Table, path: Path) -> None:
    """A table as CSV, whatever the name of the file ends in."""
    written = path.with_name(path.name + ".csv")
    write_table(written, table)
    written.replace(path)
