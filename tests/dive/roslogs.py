"""Small ROS logs of a known motion, in every container, written by rosbags and by the mcap library."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.msg import denormalize_msgtype
from rosbags.typesys.store import Typestore

START_NS = 1_700_000_000_000_000_000
SECONDS = 10
RATES = {"/imu": 50, "/pressure": 10, "/dvl": 5, "/gnss": 1, "/odom": 10, "/camera/image_raw": 1, "/numbers": 2}
TYPES = {
    "/imu": "sensor_msgs/msg/Imu",
    "/pressure": "sensor_msgs/msg/FluidPressure",
    "/dvl": "geometry_msgs/msg/TwistWithCovarianceStamped",
    "/gnss": "sensor_msgs/msg/NavSatFix",
    "/odom": "nav_msgs/msg/Odometry",
    "/camera/image_raw": "sensor_msgs/msg/Image",
    "/numbers": "std_msgs/msg/Float64MultiArray",
}
LAT_DEG, LON_DEG = 43.1, 5.9
LATE_NS = 30_000_000
"""How long after its stamp a message is logged."""

Sample = tuple[str, int, Any]
"""Topic, stamp, message."""


def known(topic: str, t_s: float, t_ns: int) -> dict[str, Any]:
    """What the message of a topic says at a time: axes FLU and ENU, everything linear in time or constant."""
    header = {"stamp": {"sec": t_ns // 10**9, "nanosec": t_ns % 10**9}, "frame_id": "base_link"}
    values: dict[str, dict[str, Any]] = {
        "/imu": {
            "header": header,
            "linear_acceleration": {"x": 0.01 * t_s, "y": 0.02, "z": 9.81},
            "angular_velocity": {"x": 0.001, "y": 0.002 * t_s, "z": 0.003},
        },
        "/pressure": {"header": header, "fluid_pressure": 101_325.0 + 10_055.0 * (5.0 + 0.1 * t_s)},
        "/dvl": {
            "header": header,
            "twist": {
                "twist": {"linear": {"x": 1.0, "y": 0.1 * t_s, "z": -0.05}},
                "covariance": np.diag([1e-4, 2e-4, 3e-4, 0, 0, 0]).ravel(),
            },
        },
        "/gnss": {
            "header": header,
            "status": {"status": 0 if t_s < 3 else -1},
            "latitude": LAT_DEG + 1e-6 * t_s,
            "longitude": LON_DEG,
            "altitude": 1.5,
            "position_covariance": np.diag([4.0, 9.0, 16.0]).ravel(),
            "position_covariance_type": 2,
        },
        "/odom": {
            "header": {**header, "frame_id": "odom"},
            "pose": {
                "pose": {
                    "position": {"x": 2.0 * t_s, "y": t_s, "z": -5.0},
                    "orientation": {"z": float(np.sin(np.pi / 8)), "w": float(np.cos(np.pi / 8))},
                }
            },
            "twist": {"twist": {"linear": {"x": 1.0}}},
        },
        "/camera/image_raw": {
            "header": header,
            "height": 6,
            "width": 8,
            "encoding": "mono8",
            "step": 8,
            "data": np.arange(48, dtype=np.uint8),
        },
        "/numbers": {"data": np.array([t_s, 45.0 + t_s, -1.0])},
    }
    return values[topic]


def samples(store: Typestore, topics: dict[str, str] = TYPES, seconds: int = SECONDS) -> Iterator[Sample]:
    """Messages of all topics in the order of time."""
    ticks = [(n / rate, topic) for topic, rate in RATES.items() if topic in topics for n in range(seconds * rate)]
    for t_s, topic in sorted(ticks):
        t_ns = START_NS + round(t_s * 1e9)
        yield topic, t_ns, made(store, topics[topic], known(topic, t_s, t_ns))


def made(store: Typestore, type_name: str, values: dict[str, Any]) -> Any:
    """A message with those values and zeros for the rest."""
    fields = {}
    for name, (node, what) in store.fielddefs[type_name][1]:
        if node == Nodetype.NAME:
            fields[name] = made(store, str(what), values.get(name, {}))
        elif node == Nodetype.BASE:
            fields[name] = values.get(name, "" if what[0] == "string" else 0)
        elif what[0][0] == Nodetype.NAME:
            fields[name] = [made(store, what[0][1], {}) for _ in range(what[1] if node == Nodetype.ARRAY else 0)]
        else:
            dtype = np.dtype({"bool": "bool_", "byte": "uint8"}.get(what[0][1][0], what[0][1][0]))
            size = what[1] if node == Nodetype.ARRAY else 0
            fields[name] = np.asarray(values.get(name, np.zeros(size)), dtype=dtype)
    return store.types[type_name](**fields)


def store_of(distribution: str, extra: str = "", extra_name: str = "") -> Typestore:
    store = get_typestore(Stores(distribution))
    if extra:
        store.register(get_types_from_msg(extra, extra_name))
    return store


def write_rosbag1(path: Path, compression: str = "", topics: dict[str, str] = TYPES, seconds: int = SECONDS) -> Path:
    store = store_of("ros1_noetic")
    writer = Rosbag1Writer(path)
    if compression:
        writer.set_compression(Rosbag1Writer.CompressionFormat[compression])
    writer.chunk_threshold = 20_000
    with writer:
        links = {t: writer.add_connection(t, kind, typestore=store) for t, kind in topics.items()}
        for topic, t_ns, message in samples(store, topics, seconds):
            writer.write(links[topic], t_ns + LATE_NS, store.serialize_ros1(message, topics[topic]))
    return path


def write_rosbag2(
    path: Path,
    storage: str = "sqlite3",
    version: Any = 9,
    distribution: str = "ros2_humble",
    compression: str = "",
    topics: dict[str, str] = TYPES,
    seconds: int = SECONDS,
) -> Path:
    store = store_of(distribution)
    writer = Rosbag2Writer(path, version=version, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        links = {t: writer.add_connection(t, kind, typestore=store) for t, kind in topics.items()}
        for topic, t_ns, message in samples(store, topics, seconds):
            writer.write(links[topic], t_ns + LATE_NS, store.serialize_cdr(message, topics[topic]))
    return path


def as_in_foxy(folder: Path) -> Path:
    """A bag of rosbags brought to the tables and metadata of ROS 2 Foxy, which keeps no definitions."""
    metadata = folder / "metadata.yaml"
    lines = metadata.read_text().splitlines()
    drop = ("type_description_hash", "ros_distro", "custom_data")
    kept = [line for line in lines if not line.strip().startswith(drop)]
    metadata.write_text("\n".join(kept).replace("version: 8", "version: 4") + "\n")
    with sqlite3.connect(next(folder.glob("*.db3"))) as database:
        for table in ("message_definitions", "schema", "metadata"):
            database.execute(f"DROP TABLE {table}")
        database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    database.close()
    return folder


def write_mcap(
    path: Path,
    encoding: str = "cdr",
    compression: str = "NONE",
    topics: dict[str, str] = TYPES,
    seconds: int = SECONDS,
    **options: Any,
) -> Path:
    store = store_of("ros1_noetic" if encoding == "ros1" else "ros2_humble")
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType[compression], chunk_size=20_000, **options)
        writer.start(profile="" if encoding == "json" else {"cdr": "ros2"}.get(encoding, encoding))
        links = {topic: _channel(writer, store, encoding, topic, kind) for topic, kind in topics.items()}
        for topic, t_ns, message in samples(store, topics, seconds):
            writer.add_message(links[topic], t_ns + LATE_NS, _bytes(store, encoding, topics[topic], message), t_ns)
        writer.finish()
    return path


def _channel(writer: McapWriter, store: Typestore, encoding: str, topic: str, kind: str) -> int:
    if encoding == "json":
        schema = writer.register_schema(kind, "jsonschema", b'{"type": "object"}')
    else:
        version = 1 if encoding == "ros1" else 2
        text = store.generate_msgdef(kind, ros_version=version)[0].encode()
        name = denormalize_msgtype(kind) if version == 1 else kind
        schema = writer.register_schema(name, f"ros{version}msg", text)
    return writer.register_channel(topic, encoding, schema)


def _bytes(store: Typestore, encoding: str, kind: str, message: Any) -> bytes:
    if encoding == "json":
        return json.dumps(as_dict(message)).encode()
    return bytes(store.serialize_ros1(message, kind) if encoding == "ros1" else store.serialize_cdr(message, kind))


def as_dict(message: Any) -> Any:
    """A message as plain values, for JSON."""
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, list):
        return [as_dict(part) for part in message]
    if hasattr(message, "__dict__"):
        return {name: as_dict(value) for name, value in vars(message).items()}
    return message
