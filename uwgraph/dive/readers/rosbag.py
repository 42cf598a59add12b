"""ROS bags: files ``*.bag`` of ROS 1, and the folders that ``ros2 bag record`` writes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from uwgraph.dive.logs.log import Log, Proposal, Topic
from uwgraph.dive.readers import ros_messages, rosbag1, rosbag2, sqlitebag
from uwgraph.dive.readers.damage import nothing_left
from uwgraph.dive.readers.ros_log import RosLog

NAME: Final = "rosbag"
EXPECTS: Final = "a ROS 1 file *.bag; or a ROS 2 folder with metadata.yaml and *.db3 or *.mcap, or one *.db3"
CLOCKS_DIFFER: Final = False


def matches(path: Path) -> str:
    """Why the recording looks like this format; empty if it does not."""
    if path.is_dir():
        return "a folder with the storage files of a ROS 2 bag" if rosbag2.bag_files(path) else ""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        start = file.read(16)
    if start.startswith(b"#ROSBAG V"):
        return "the file begins as ROS 1 bags do"
    return "a SQLite database *.db3" if start == sqlitebag.MAGIC and path.suffix == ".db3" else ""


@contextmanager
def open_log(path: Path) -> Iterator[Log]:
    """The log of a bag; raises DataError when it cannot be read at all."""
    with rosbag1.open_bag(path) if _is_rosbag1(path) else rosbag2.open_bag(path) as storage:
        if not storage.channels:
            raise nothing_left(storage.caveats, str(path))
        yield RosLog(storage)


def proposals(topic: Topic) -> tuple[Proposal, ...]:
    """What a topic could become."""
    return ros_messages.proposals(topic)


def _is_rosbag1(path: Path) -> bool:
    return path.is_file() and path.suffix not in (".db3", ".mcap", ".zstd")
