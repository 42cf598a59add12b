"""Messages that Foxglove knows, as JSON with their schemas (docs.foxglove.dev, message schemas), and plain ones.

Foxglove's schema parser knows no ``null`` and no union of types: what is not known is left out of a message.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

from uwgraph.time import NS

Message = dict[str, Any]
Vector = Sequence[float]


def _object(title: str, properties: Mapping[str, Any], required: Sequence[str] | None = None) -> Message:
    names = list(properties) if required is None else list(required)
    return {"type": "object", "title": title, "properties": dict(properties), "required": names}


_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string"}
_TIME: Final = _object(
    "time",
    {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": NS - 1},
    },
)
_VECTOR3: Final = _object("foxglove.Vector3", dict.fromkeys("xyz", _NUMBER))
_QUATERNION: Final = _object("foxglove.Quaternion", dict.fromkeys("xyzw", _NUMBER))
_POSE: Final = _object("foxglove.Pose", {"position": _VECTOR3, "orientation": _QUATERNION})
_COVARIANCE_TYPES: Final = ("UNKNOWN", "APPROXIMATED", "DIAGONAL_KNOWN", "KNOWN")
UNKNOWN, APPROXIMATED, _, KNOWN = range(4)

SCHEMAS: Final[Mapping[str, Message]] = {
    schema["title"]: schema
    for schema in (
        _object("foxglove.PoseInFrame", {"timestamp": _TIME, "frame_id": _TEXT, "pose": _POSE}),
        _object(
            "foxglove.PosesInFrame",
            {"timestamp": _TIME, "frame_id": _TEXT, "poses": {"type": "array", "items": _POSE}},
        ),
        _object(
            "foxglove.FrameTransform",
            {
                "timestamp": _TIME,
                "parent_frame_id": _TEXT,
                "child_frame_id": _TEXT,
                "translation": _VECTOR3,
                "rotation": _QUATERNION,
            },
        ),
        _object(
            "foxglove.LocationFix",
            {
                "timestamp": _TIME,
                "frame_id": _TEXT,
                "latitude": _NUMBER,
                "longitude": _NUMBER,
                "altitude": _NUMBER,
                "position_covariance": {"type": "array", "items": _NUMBER, "minItems": 9, "maxItems": 9},
                "position_covariance_type": {
                    "title": "foxglove.PositionCovarianceType",
                    "oneOf": [{"title": name, "const": k} for k, name in enumerate(_COVARIANCE_TYPES)],
                },
            },
        ),
    )
}
"""The well-known schemas that are written, by name."""


def plain_schema(name: str, columns: Mapping[str, str]) -> Message:
    """Schema of a flat message: ``columns`` are names and JSON types; any of them may be missing in a message."""
    return _object(name, {"timestamp": _TIME} | {key: {"type": kind} for key, kind in columns.items()}, ["timestamp"])


def encode(message: Message) -> bytes:
    """UTF-8 JSON; raises ValueError where a number is not finite."""
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode()


def timestamp(t_ns: int) -> Message:
    return {"sec": t_ns // NS, "nsec": t_ns % NS}


def pose(position: Vector, xyzw: Vector) -> Message:
    return {"position": _xyz(position), "orientation": _xyzw(xyzw)}


def pose_in_frame(t_ns: int, frame: str, position: Vector, xyzw: Vector) -> Message:
    return {"timestamp": timestamp(t_ns), "frame_id": frame, "pose": pose(position, xyzw)}


def poses_in_frame(t_ns: int, frame: str, poses: Sequence[Message]) -> Message:
    return {"timestamp": timestamp(t_ns), "frame_id": frame, "poses": list(poses)}


def frame_transform(t_ns: int, parent: str, child: str, translation: Vector, xyzw: Vector) -> Message:
    return {
        "timestamp": timestamp(t_ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": _xyz(translation),
        "rotation": _xyzw(xyzw),
    }


def location_fix(t_ns: int, frame: str, place_deg: Vector, cov_enu: Vector, cov_type: int) -> Message:
    """``place_deg`` is latitude, longitude [deg] and altitude [m]; ``cov_enu`` nine numbers, row by row, m^2."""
    latitude, longitude, altitude = place_deg
    return {
        "timestamp": timestamp(t_ns),
        "frame_id": frame,
        "latitude": latitude,
        "longitude": longitude,
        "altitude": altitude,
        "position_covariance": list(cov_enu),
        "position_covariance_type": cov_type,
    }


def _xyz(v: Vector) -> Message:
    return {"x": v[0], "y": v[1], "z": v[2]}


def _xyzw(q: Vector) -> Message:
    return {"x": q[0], "y": q[1], "z": q[2], "w": q[3]}
