"""What an MCAP file tells: a track as poses, transforms, locations and states; a dive's sensors as plain numbers."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.dive.layout import table_from_stream
from uwgraph.dive.model import Dive
from uwgraph.dive.tables import Table
from uwgraph.export import foxglove
from uwgraph.export.axes import AXES, Axes
from uwgraph.export.mcap_file import Stamped, Topic, rows
from uwgraph.export.track import Track, table_of_track
from uwgraph.types import Fixes, FloatArray, TimeArray

MAX_PATH: Final = 5000
"""Poses of the whole path, which is one message."""
UNMEASURED: Final = 1e8
"""m^2; JSON has no infinity for the variance of a height that a fix does not know."""

_JSON_TYPES: Final = {"i": "integer", "f": "number", "b": "boolean", "U": "string"}
_R_EN: Final = AXES["enu"].R_wn


def track_topics(track: Track, axes: Axes) -> list[Topic]:
    """``/tf``, and under the track's name ``pose``, ``path``, ``location`` and ``state``."""
    posed = track.select(track.posed)
    topics = [_location(track, axes), _plain(f"/{track.name}/state", table_of_track(track), 0)]
    if len(posed):
        xyzw = Rotation.from_matrix(axes.rotation(posed)).as_quat()
        topics += _pose_topics(posed, axes, axes.position(posed), xyzw)
    return topics


def sensor_topics(dive: Dive) -> list[Topic]:
    """Every stream of the dive, with the columns and units of the dive folder.

    They are put on the dive's clock; a message's publish time is the sensor's own stamp.
    """
    topics = []
    for name, stream in dive.streams():
        sensor = getattr(dive.rig, name, None)
        offset = sensor.time_offset_ns if sensor is not None else 0
        topics.append(_plain(f"/{name}", table_from_stream(name, stream), offset))
        if isinstance(stream, Fixes):
            topics.append(_fix_locations(stream, offset))
    return topics


def _pose_topics(track: Track, axes: Axes, p: FloatArray, xyzw: FloatArray) -> list[Topic]:
    world, body = axes.world_id, axes.body_id

    def poses() -> Iterator[Stamped]:
        for t, position, quaternion in rows(track.t_ns, p, xyzw):
            yield t, t, foxglove.pose_in_frame(t, world, position, quaternion)

    def transforms() -> Iterator[Stamped]:
        for t, position, quaternion in rows(track.t_ns, p, xyzw):
            yield t, t, foxglove.frame_transform(t, world, body, position, quaternion)

    def path() -> Iterator[Stamped]:
        few = np.unique(np.linspace(0, len(track) - 1, MAX_PATH).round().astype(int))
        t = int(track.t_ns[0])
        yield t, t, foxglove.poses_in_frame(t, world, [foxglove.pose(*row) for row in rows(p[few], xyzw[few])])

    return [
        Topic("/tf", foxglove.SCHEMAS["foxglove.FrameTransform"], len(track), transforms()),
        Topic(f"/{track.name}/pose", foxglove.SCHEMAS["foxglove.PoseInFrame"], len(track), poses()),
        Topic(f"/{track.name}/path", foxglove.SCHEMAS["foxglove.PosesInFrame"], 1, path()),
    ]


def _location(track: Track, axes: Axes) -> Topic:
    track = track.select(track.placed)
    R_en = _R_EN @ np.swapaxes(track.R_n_local, -1, -2)
    cov = R_en @ track.cov_p_n @ np.swapaxes(R_en, -1, -2)
    messages = _locations(track.t_ns, 0, axes.body_id, track.lat, track.lon, track.height, cov)
    return Topic(f"/{track.name}/location", foxglove.SCHEMAS["foxglove.LocationFix"], len(track), messages)


def _fix_locations(fixes: Fixes, offset_ns: int) -> Topic:
    cov = fixes.cov_n[:, [1, 0, 2]][:, :, [1, 0, 2]] * np.array([[1, 1, -1], [1, 1, -1], [-1, -1, 1]])
    messages = _locations(fixes.t_ns, offset_ns, "fixes", fixes.lat, fixes.lon, fixes.height, cov)
    return Topic("/fixes/location", foxglove.SCHEMAS["foxglove.LocationFix"], len(fixes), messages)


def _locations(
    t_ns: TimeArray,
    offset_ns: int,
    frame: str,
    lat: FloatArray,
    lon: FloatArray,
    height: FloatArray,
    cov_enu: FloatArray,
) -> Iterator[Stamped]:
    """An unknown height is written as 0 with the variance :data:`UNMEASURED`, an unknown covariance as zeros."""
    place = np.column_stack([np.degrees(lat), np.degrees(lon), np.nan_to_num(height)])
    cov = cov_enu.copy()
    flat = ~np.isfinite(height)
    cov[flat, 2, :] = cov[flat, :, 2] = 0.0
    cov[flat, 2, 2] = np.inf
    unknown = np.asarray(np.isnan(cov).any(axis=(1, 2)))
    partly = np.isinf(cov).any(axis=(1, 2))
    cov = np.where(np.isfinite(cov), cov, UNMEASURED * np.eye(3)) * ~unknown[:, None, None]
    kind = np.where(unknown, foxglove.UNKNOWN, np.where(partly, foxglove.APPROXIMATED, foxglove.KNOWN))
    for t, where, nine, known in rows(t_ns, place, cov.reshape(-1, 9), kind):
        yield t + offset_ns, t, foxglove.location_fix(t + offset_ns, frame, where, nine, known)


def _plain(topic: str, table: Table, offset_ns: int) -> Topic:
    """A message per row with its finite numbers, for plots."""
    columns = {name: column for name, column in table.items() if name != "t_ns"}
    kinds = {name: _JSON_TYPES[column.dtype.kind] for name, column in columns.items()}

    def messages() -> Iterator[Stamped]:
        for stamp, *values in rows(table["t_ns"], *columns.values()):
            t = stamp + offset_ns
            known = {k: v for k, v in zip(columns, values, strict=True) if not isinstance(v, float) or isfinite(v)}
            yield t, stamp, {"timestamp": foxglove.timestamp(t)} | known

    return Topic(
        topic, foxglove.plain_schema(f"uwgraph{topic.replace('/', '.')}", kinds), len(table["t_ns"]), messages()
    )
