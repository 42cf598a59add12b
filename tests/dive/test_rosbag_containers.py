"""The same motion in every container: the same topics, messages and dive."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import IndexType
from roslogs import (
    LAT_DEG,
    LATE_NS,
    LON_DEG,
    RATES,
    SECONDS,
    START_NS,
    TYPES,
    as_in_foxy,
    write_mcap,
    write_rosbag1,
    write_rosbag2,
)

from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive
from uwgraph.dive.readers import guess_reader, mcapfile, rosbag

Write = Callable[[Path], Path]

BARE = {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False, "index_types": IndexType.NONE}
CONTAINERS: dict[str, tuple[Any, Write]] = {
    "rosbag1": (rosbag, lambda work: write_rosbag1(work / "a.bag")),
    "rosbag1-bz2": (rosbag, lambda work: write_rosbag1(work / "a.bag", "BZ2")),
    "rosbag1-lz4": (rosbag, lambda work: write_rosbag1(work / "a.bag", "LZ4")),
    "foxy-sqlite3-v4": (rosbag, lambda work: as_in_foxy(write_rosbag2(work / "a", "sqlite3", 8, "ros2_foxy"))),
    "foxy-sqlite3-v8": (rosbag, lambda work: write_rosbag2(work / "a", "sqlite3", 8, "ros2_foxy")),
    "humble-sqlite3-v9": (rosbag, lambda work: write_rosbag2(work / "a", "sqlite3", 9, "ros2_humble")),
    "jazzy-sqlite3-file": (rosbag, lambda work: write_rosbag2(work / "a", "sqlite3", 9, "ros2_jazzy", "file")),
    "jazzy-sqlite3-message": (rosbag, lambda work: write_rosbag2(work / "a", "sqlite3", 9, "ros2_jazzy", "message")),
    "humble-mcap-v8": (rosbag, lambda work: write_rosbag2(work / "a", "mcap", 8, "ros2_humble")),
    "jazzy-mcap-v9": (rosbag, lambda work: write_rosbag2(work / "a", "mcap", 9, "ros2_jazzy")),
    "jazzy-mcap-file": (rosbag, lambda work: write_rosbag2(work / "a", "mcap", 9, "ros2_jazzy", "file")),
    "jazzy-mcap-message": (rosbag, lambda work: write_rosbag2(work / "a", "mcap", 9, "ros2_jazzy", "message")),
    "jazzy-mcap-storage": (rosbag, lambda work: write_rosbag2(work / "a", "mcap", 9, "ros2_jazzy", "storage")),
    "mcap-cdr": (mcapfile, lambda work: write_mcap(work / "a.mcap")),
    "mcap-cdr-lz4": (mcapfile, lambda work: write_mcap(work / "a.mcap", "cdr", "LZ4")),
    "mcap-cdr-zstd": (mcapfile, lambda work: write_mcap(work / "a.mcap", "cdr", "ZSTD")),
    "mcap-cdr-unchunked": (mcapfile, lambda work: write_mcap(work / "a.mcap", use_chunking=False)),
    "mcap-cdr-no-summary": (mcapfile, lambda work: write_mcap(work / "a.mcap", "cdr", "ZSTD", **BARE)),
    "mcap-ros1": (mcapfile, lambda work: write_mcap(work / "a.mcap", "ros1", "LZ4")),
    "mcap-json": (mcapfile, lambda work: write_mcap(work / "a.mcap", "json", "ZSTD")),
}


class Kept:
    """A sink that keeps everything."""

    def __init__(self) -> None:
        self.messages: list[tuple[int, Any]] = []

    def add(self, t_ns: int, message: Any) -> None:
        self.messages.append((t_ns, message))

    def extend(self, t_ns: Any, columns: Any) -> None:
        raise AssertionError("messages come one by one")


@pytest.fixture(params=CONTAINERS)
def container(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Any, Path]:
    reader, write = CONTAINERS[request.param]
    return reader, write(tmp_path)


def test_topics_and_messages(container: tuple[Any, Path]) -> None:
    reader, path = container
    assert guess_reader(path)[0] is reader
    shares: list[float] = []
    with reader.open_log(path) as log:
        topics = {topic.name: topic for topic in log.topics}
        sinks = {name: (Kept(), Kept()) for name in topics if name != "/pressure"}
        log.pour(sinks, shares.append)
        assert log.caveats == ()

    assert {name: topic.type for name, topic in topics.items()} == TYPES
    assert {name: topic.count for name, topic in topics.items()} == {t: rate * SECONDS for t, rate in RATES.items()}
    assert topics["/imu"].frame == "base_link"
    assert {"linear_acceleration.x", "angular_velocity.z"} <= set(topics["/imu"].fields)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    for name, (first, second) in sinks.items():
        assert [t for t, _ in first.messages] == [
            START_NS + LATE_NS + round(n / RATES[name] * 1e9) for n in range(SECONDS * RATES[name])
        ]
        assert len(second.messages) == len(first.messages)


def test_dive(container: tuple[Any, Path], tmp_path: Path) -> None:
    reader, path = container
    report = import_dive(path, tmp_path / "dive")
    dive = read_dive(tmp_path / "dive")

    assert report.format == reader.NAME
    assert {topic.topic for topic in report.left} == {"/numbers"}
    assert dive.imu is not None
    assert dive.dvl is not None
    assert dive.depth is not None
    assert dive.fixes is not None
    assert dive.reference is not None

    t_s = np.arange(SECONDS * 50) / 50
    middle = 0.5 * (t_s[1:] + t_s[:-1])
    assert dive.imu.t_ns.tolist() == (START_NS + np.round(t_s[1:] * 1e9).astype(np.int64)).tolist()
    ones = np.ones_like(middle)
    np.testing.assert_allclose(dive.imu.f_s, np.column_stack([0.01 * middle, -0.02 * ones, -9.81 * ones]), atol=1e-12)
    np.testing.assert_allclose(
        dive.imu.w_s, np.column_stack([0.001 * ones, -0.002 * middle, -0.003 * ones]), atol=1e-12
    )

    t_s = np.arange(SECONDS * 5) / 5
    np.testing.assert_allclose(dive.dvl.v_s, np.column_stack([t_s * 0 + 1.0, -0.1 * t_s, t_s * 0 + 0.05]), atol=1e-12)
    np.testing.assert_allclose(dive.dvl.cov_s[3], np.diag([1e-4, 2e-4, 3e-4]), atol=1e-12)
    assert dive.dvl.valid.all()

    np.testing.assert_allclose(dive.depth.depth, 5.0 + 0.1 * np.arange(SECONDS * 10) / 10, atol=0.02)

    assert len(dive.fixes) == 3
    np.testing.assert_allclose(np.degrees(dive.fixes.lat), LAT_DEG + 1e-6 * np.arange(3), atol=1e-12)
    np.testing.assert_allclose(np.degrees(dive.fixes.lon), LON_DEG, atol=1e-12)
    np.testing.assert_allclose(dive.fixes.cov_n[0], np.diag([9.0, 4.0, np.inf]), atol=1e-9)

    np.testing.assert_allclose(np.degrees(dive.reference.rph[0]), [0.0, 0.0, 45.0], atol=1e-6)
    np.testing.assert_allclose(dive.reference.v_n[0], [np.sqrt(0.5), np.sqrt(0.5), 0.0], atol=1e-6)
    np.testing.assert_allclose(dive.reference.height, -5.0, atol=1e-3)
    assert len(dive.images["camera"]) == SECONDS
