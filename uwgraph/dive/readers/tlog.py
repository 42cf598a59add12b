"""MAVLink telemetry logs of a ground station (``.tlog``), through pymavlink's ArduPilot dialect.

A topic is a message of the vehicle, ``ATTITUDE``; of another source ``GPS_INPUT 1/220`` (system and component), and of
a named value ``NAMED_VALUE_FLOAT CamTilt``. Messages with a stamp of their own get it, on the vehicle's clock put to
the ground station's (:mod:`uwgraph.dive.readers.tlog_clocks`); the others are stamped when they were received.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np

from uwgraph.dive.folder import OriginSettings
from uwgraph.dive.logs.log import Known, Progress, Proposal, Sink, Topic
from uwgraph.dive.readers.mavlink_messages import MAVLINK, autopilot_rig, north_of, proposals_from
from uwgraph.dive.readers.tlog_clocks import Clock
from uwgraph.dive.readers.tlog_frames import Frame, Frames, Kind, begins_with_frame, dialect
from uwgraph.errors import DataError

NAME: Final = "tlog"
EXPECTS: Final = "a .tlog file, the telemetry log of QGroundControl or another MAVLink ground station"
CLOCKS_DIFFER: Final = False

MAX_TOPICS: Final = 1000
TELL_CLOCK_S: Final = 1.0
"""A difference between the clocks of ground station and vehicle that people should know of."""
_NO_AUTOPILOT: Final = 8
_PROGRESS_BYTES: Final = 1 << 20
Source = tuple[int, int]
"""System and component."""
Key = tuple[Kind, Source, str]
"""Message, who sent it, and the name of a named value."""


def matches(path: Path) -> str:
    if path.suffix.lower() != ".tlog" or not path.is_file():
        return ""
    with path.open("rb") as file:
        return "it begins with a stamp and a MAVLink frame" if begins_with_frame(file.read(16)) else ""


@contextmanager
def open_log(path: Path) -> Iterator[TelemetryLog]:
    """The log, after one pass over the file.

    Raises
    ------
    DataError
        When it holds no message.
    ConfigError
        When pymavlink is not installed.
    """
    if not path.is_file() or not path.stat().st_size:
        raise DataError("is no file, or empty", where=str(path), remedy=f"give {EXPECTS}")
    mavlink = dialect()
    with path.open("rb") as file:
        yield TelemetryLog(path, Frames(file, path.stat().st_size, mavlink), mavlink)


def proposals(topic: Topic) -> tuple[Proposal, ...]:
    return proposals_from(MAVLINK, topic)


class TelemetryLog:
    """An open log."""

    def __init__(self, path: Path, frames: Frames, mavlink: ModuleType) -> None:
        self._path = path
        self._frames = frames
        self._decoder = mavlink.MAVLink(None)
        self._decoding_error = mavlink.MAVError
        self._counts: Counter[Key] = Counter()
        self._clocks: dict[Source, Clock] = defaultdict(Clock)
        self._autopilots: Counter[Source] = Counter()
        self._parameters: dict[Source, dict[str, float]] = defaultdict(dict)
        self._origins: dict[Source, OriginSettings] = {}
        self._clock_errors_s: dict[Source, list[float]] = defaultdict(list)
        for frame in self._frames:
            self._look_at(frame)
        if not self._counts:
            lost = f" after byte {self._frames.first_lost}" if self._frames.lost else ""
            raise DataError(f"holds no MAVLink message{lost}", where=str(path), remedy="copy the log again")
        for clock in self._clocks.values():
            clock.settle()
        self._vehicle = (self._autopilots or self._senders()).most_common(1)[0][0]
        self._lost = self._frames.lost, self._frames.first_lost, self._frames.unknown

    @property
    def topics(self) -> tuple[Topic, ...]:
        return tuple(sorted((self._topic(key, n) for key, n in self._counts.items()), key=lambda topic: topic.name))

    @property
    def known(self) -> Known:
        return Known(autopilot_rig(self._parameters[self._vehicle]), self._origins.get(self._vehicle))

    @property
    def caveats(self) -> tuple[str, ...]:
        lost, at, unknown = self._lost
        starts = self._clocks[self._vehicle].starts
        errors_s = self._clock_errors_s[self._vehicle]
        told = []
        if lost:
            told.append(f"{lost} of {self._frames.size} bytes, from byte {at} on, are no messages and were skipped")
        if unknown:
            told.append(f"{unknown} messages have a wrong checksum or are unknown to pymavlink's dialect: left out")
        if starts == 0:
            told.append("the vehicle's clock cannot be told: messages are stamped when they were received")
        if starts > 1:
            told.append(f"the vehicle was started {starts - 1} times while this log was written")
        if errors_s and abs(error_s := float(np.median(errors_s))) > TELL_CLOCK_S:
            told.append(f"the ground station's clock, which is taken for UTC, is {error_s:+.1f} s off the vehicle's")
        return tuple(told)

    def pour(self, sinks: Mapping[str, tuple[Sink, ...]], progress: Progress) -> None:
        """Decode the messages of every topic that has sinks, in file order."""
        wanted = {key: sinks[name] for key in self._counts if (name := self._name(key)) in sinks}
        told = 0
        for frame in self._frames:
            if frame.at - told > _PROGRESS_BYTES:
                told = frame.at
                progress(told / self._frames.size)
            takers = wanted.get((frame.kind, frame.source, frame.label))
            message = self._decoded(frame) if takers else None
            if takers and message is not None:
                t_ns = 1000 * self._utc_us(frame)
                for sink in takers:
                    sink.add(t_ns, message)
        progress(1.0)

    def _look_at(self, frame: Frame) -> None:
        """Count a message, and take what it says of the vehicle and its clock."""
        source, kind = frame.source, frame.kind
        self._counts[kind, source, frame.label] += 1
        if len(self._counts) > MAX_TOPICS:
            raise DataError(
                f"has more than {MAX_TOPICS} kinds of messages at byte {frame.at}",
                where=str(self._path),
                remedy="is it a telemetry log?",
            )
        if kind.runs:
            self._clocks[source].see(frame.at, frame.received_us, frame.boot_us)
        match kind.name:
            case "HEARTBEAT":
                message = self._decoded(frame)
                if message is not None and message.autopilot != _NO_AUTOPILOT:
                    self._autopilots[source] += 1
            case "PARAM_VALUE":
                if (message := self._decoded(frame)) is not None:
                    self._parameters[source][str(message.param_id)] = float(message.param_value)
            case "GPS_GLOBAL_ORIGIN":
                message = self._decoded(frame)
                lat, lon = (message.latitude, message.longitude) if message is not None else (0, 0)
                if (lat or lon) and abs(lat) <= 90e7 and abs(lon) <= 180e7:
                    self._origins.setdefault(source, OriginSettings(lat_deg=lat * 1e-7, lon_deg=lon * 1e-7))
            case "SYSTEM_TIME":
                message = self._decoded(frame)
                if message is not None and message.time_unix_usec and len(self._clock_errors_s[source]) < 1000:
                    self._clock_errors_s[source].append((frame.received_us - message.time_unix_usec) * 1e-6)

    def _senders(self) -> Counter[Source]:
        """Messages by sender."""
        senders: Counter[Source] = Counter()
        for (_, source, _), count in self._counts.items():
            senders[source] += count
        return senders

    def _decoded(self, frame: Frame) -> Any:
        """pymavlink's message, with what is derived from it; None where its fields cannot be made out."""
        try:
            message = self._decoder.decode(bytearray(frame.whole))
        except self._decoding_error:
            return None
        if frame.kind.name == "VISION_POSITION_DELTA":
            seconds = message.time_delta_usec * 1e-6
            message.velocity = [delta / seconds if seconds > 0 else np.nan for delta in message.position_delta]
        return message

    def _utc_us(self, frame: Frame) -> int:
        clock = self._clocks.get(frame.source)
        if clock is None or not frame.boot_us:
            return frame.received_us
        return clock.utc_us(frame.at, frame.received_us, frame.boot_us)

    def _name(self, key: Key) -> str:
        kind, source, name = key
        parts = [kind.name, name, "" if source == self._vehicle else "{}/{}".format(*source)]
        return " ".join(part for part in parts if part)

    def _topic(self, key: Key, count: int) -> Topic:
        kind, source, _ = key
        says = north_of(self._parameters[source]) if kind.name == "ATTITUDE" else ""
        units = dict(kind.type.fieldunits_by_name)
        return Topic(self._name(key), kind.name, count, _numbers(kind.type), units=units, says=says)


def _numbers(message: Any) -> tuple[str, ...]:
    """Paths of the numbers of a message, derived ones included."""
    paths: list[str] = []
    lengths = dict(zip(message.ordered_fieldnames, message.array_lengths, strict=True))
    types = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
    for name in message.fieldnames:
        if types[name] != "char":
            paths += [f"{name}[{k}]" for k in range(lengths[name])] or [name]
    if message.msgname == "VISION_POSITION_DELTA":
        paths += [f"velocity[{k}]" for k in range(3)]
    return tuple(paths)
