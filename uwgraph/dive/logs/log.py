"""A log of messages, whatever its container: topics, and messages poured into sinks in one pass.

A reader of a format opens its files as a :class:`Log`; the mapping says which topic becomes which stream. Messages are
never collected: each goes into the sink of its topic and is forgotten, so memory does not grow with the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

from uwgraph.dive.folder import OriginSettings
from uwgraph.dive.logs.mapping import StreamMapping
from uwgraph.dive.rig import Rig
from uwgraph.types import FloatArray, TimeArray

NOWHEN: Final = datetime(2000, 1, 1, tzinfo=UTC)
"""Where stamps that count from the start of their log are put, when nothing tells the date."""
Progress = Callable[[float], None]
"""Called with the share of the log that has been read, 0 to 1."""


@dataclass(frozen=True)
class Topic:
    """One kind of message in a log."""

    name: str
    """As the log names it: ``/imu/data``, ``IMU[0]``, ``imu.csv``."""
    type: str
    """``sensor_msgs/msg/Imu``, ``RAW_IMU``, ``csv``."""
    count: int | None = None
    """Messages, where the container says it before they are read."""
    fields: tuple[str, ...] = ()
    """Paths of its numbers, as far as known before reading: ``angular_velocity.x``, ``data``, ``header.stamp``."""
    frame: str = ""
    """What the log says of its axes (``header.frame_id``), where it can be known."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of its fields, in the log's own words, where the log states them."""
    says: str = ""
    """What else the log lets one know of it that its type does not tell: ``in water``, ``magnetic``."""


@dataclass(frozen=True)
class Known:
    """What a log says of the dive besides its topics, taken where the mapping says nothing."""

    rig: Rig = field(default_factory=Rig)
    """Grade and mounting of the sensors that such a vehicle carries."""
    origin: OriginSettings | None = None
    """Of the log's own local positions."""


class Sink(Protocol):
    """What takes the messages of one topic."""

    def add(self, t_ns: int, message: Any) -> None:
        """One message: the stamp of the log (ns UTC) and its body, fields by attribute or by key."""

    def extend(self, t_ns: TimeArray, columns: Mapping[str, FloatArray]) -> None:
        """Many at once, for logs that are tables already: one array a field path."""


class Log(Protocol):
    """An open log."""

    @property
    def topics(self) -> tuple[Topic, ...]:
        """What is in it."""

    @property
    def caveats(self) -> tuple[str, ...]:
        """What the user must know: a damaged end, clocks put together by guess."""

    @property
    def known(self) -> Known:
        """What it says besides; ``Known()`` where it says nothing."""

    def pour(self, sinks: Mapping[str, tuple[Sink, ...]], progress: Progress) -> None:
        """Read the log once, in file order, giving every message of a named topic to its sinks.

        Raises
        ------
        DataError
            When the log is damaged or hostile, naming the file and the offset.
        """


@dataclass(frozen=True)
class Proposal:
    """A stream that a topic could become."""

    stream: str
    """``imu``, ``dvl``, ... or ``images/CAMERA``."""
    mapping: StreamMapping
    rank: int = 0
    """Of several proposals for one stream the highest rank wins, then the topic with most messages."""
    note: str = ""
    """What the user must know when it is taken."""


@runtime_checkable
class LogReader(Protocol):
    """What the module of a log format offers."""

    NAME: str
    EXPECTS: str
    CLOCKS_DIFFER: bool

    def matches(self, path: Path) -> str:
        """Why the recording looks like this format; empty if it does not."""

    def open_log(self, path: Path) -> AbstractContextManager[Log]:
        """The log, open; raises DataError."""

    def proposals(self, topic: Topic) -> tuple[Proposal, ...]:
        """What a topic could become; none for one that is not known."""
