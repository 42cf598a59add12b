"""A log of ROS-like messages over any container of bytes: topics, first frames, and messages poured into sinks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, Final, Protocol

from uwgraph.dive.logs.log import Known, Progress, Sink, Topic
from uwgraph.dive.readers.ros_messages import is_known
from uwgraph.dive.readers.ros_types import MAX_DEFINITIONS, MAX_ELEMENTS, Decode, MessageType, TypeTrouble, number_paths
from uwgraph.errors import DataError

PEEK_BYTES: Final = 1 << 24
PEEK_MESSAGES: Final = 20_000
"""How far a log is read for the first frame of every topic."""
REPORT_EVERY: Final = 1024
"""Messages between two reports of progress."""
MAX_STAMP_NS: Final = (1 << 63) - 1

Message = tuple[int, int, "bytes | memoryview", int]
"""Channel, stamp (ns UTC), bytes, and where they are."""


@dataclass(frozen=True)
class Channel:
    """A source of messages in a container; a topic may have several."""

    id: int
    topic: str
    kind: MessageType
    count: int | None = None


class Storage(Protocol):
    """A container of messages as bytes."""

    @property
    def channels(self) -> Sequence[Channel]:
        """All of them."""

    @property
    def caveats(self) -> tuple[str, ...]:
        """What is damaged, as far as it was read."""

    def messages(self, wanted: Collection[int]) -> Iterator[Message]:
        """Those of some channels, from the start; raises DataError for what must not be read on."""

    def where(self, at: int) -> str:
        """File and offset in words."""

    def share(self) -> float:
        """How much of the container has been read, 0 to 1."""


class RosLog:
    """The log of a storage."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self._by_topic: dict[str, list[Channel]] = defaultdict(list)
        for channel in storage.channels:
            self._by_topic[channel.topic].append(channel)
        size = sum(map(len, {channel.kind.definition for channel in storage.channels}))
        if size > MAX_DEFINITIONS:
            raise DataError(
                f"its message definitions have {size} characters, more than {MAX_DEFINITIONS}",
                where=storage.where(0),
                remedy="copy the log again, or filter the topics that are needed into a new one",
            )

    @cached_property
    def topics(self) -> tuple[Topic, ...]:
        firsts = self._first_messages()
        return tuple(self._topic(channels, firsts) for _, channels in sorted(self._by_topic.items()))

    @property
    def known(self) -> Known:
        return Known()

    @property
    def caveats(self) -> tuple[str, ...]:
        return (*self._storage.caveats, *self._troubles)

    def pour(self, sinks: Mapping[str, tuple[Sink, ...]], progress: Progress) -> None:
        takers = {
            channel.id: (self._decoder(channel), tuple(sink.add for sink in sinks[topic]), channel)
            for topic in sinks
            for channel in self._readable(topic)
        }
        storage = self._storage
        for poured, (channel_id, t_ns, data, at) in enumerate(storage.messages(takers.keys())):
            decode, adds, channel = takers[channel_id]
            try:
                message = decode(data)
            except Exception as error:  # whatever damaged bytes make the decoder stumble on
                raise _undecodable(channel, error, storage.where(at)) from error
            if t_ns > MAX_STAMP_NS:
                raise DataError(
                    f"a message of {channel.topic} is stamped {t_ns} ns, which is no time",
                    where=storage.where(at),
                    remedy="copy the log again",
                )
            for add in adds:
                add(t_ns, message)
            if poured % REPORT_EVERY == 0:
                progress(storage.share())
        progress(1.0)

    def _topic(self, channels: Sequence[Channel], firsts: Mapping[int, Any]) -> Topic:
        chosen = self._chosen(channels)
        counts = [channel.count for channel in channels]
        message = next((firsts[channel.id] for channel in channels if channel.id in firsts), None)
        return Topic(
            name=chosen.topic,
            type=chosen.kind.name,
            count=None if None in counts else sum(count or 0 for count in counts),
            fields=chosen.kind.fields or tuple(islice(number_paths(message), MAX_ELEMENTS)),
            frame=_frame(message),
        )

    @staticmethod
    def _chosen(channels: Sequence[Channel]) -> Channel:
        """The channel whose type stands for the topic: the one with most messages."""
        return max(channels, key=lambda channel: channel.count or 0)

    def _readable(self, topic: str) -> list[Channel]:
        """The channels of a topic that have its type; raises DataError where it cannot be read."""
        channels = self._by_topic.get(topic, [])
        if not channels:
            raise DataError("the log has no such topic", where=topic, remedy="list what it has with --list")
        name = self._chosen(channels).kind.name
        return [channel for channel in channels if channel.kind.name == name]

    def _decoder(self, channel: Channel) -> Decode:
        try:
            return channel.kind.decoder()
        except TypeTrouble as error:
            raise DataError(
                f"messages of type {channel.kind.name} cannot be read: {error}",
                where=f"{self._storage.where(0)}: topic {channel.topic}",
                remedy="leave the topic out, or convert the log to ROS or JSON messages",
            ) from error

    @cached_property
    def _troubles(self) -> tuple[str, ...]:
        """Topics that nobody can read or that are of two kinds, by reason."""
        by_reason: dict[str, list[str]] = defaultdict(list)
        for topic, channels in sorted(self._by_topic.items()):
            first = self._chosen(channels)
            if len({channel.kind.name for channel in channels}) > 1:
                by_reason[f"only messages of type {first.kind.name} are taken of topics with several types"].append(
                    topic
                )
            if not first.kind.fields and (reason := first.kind.unread):
                by_reason[reason].append(topic)
        return tuple(f"{_listed(names)}: {reason}" for reason, names in by_reason.items())

    def _first_messages(self) -> dict[int, Any]:
        """The first message of every channel that tells more than its type, as far as it comes early."""
        waiting: dict[int, Decode] = {}
        for channel in self._storage.channels:
            with suppress(TypeTrouble):
                if channel.kind.encoding == "json" or is_known(channel.kind.name):
                    waiting[channel.id] = channel.kind.decoder()
        firsts: dict[int, Any] = {}
        read = 0
        everything = [channel.id for channel in self._storage.channels]
        for count, (channel_id, _, data, _) in enumerate(self._storage.messages(everything) if waiting else ()):
            read += len(data)
            if (decode := waiting.pop(channel_id, None)) is not None:
                with suppress(Exception):  # a damaged message: pour says where
                    firsts[channel_id] = decode(data)
            if not waiting or read > PEEK_BYTES or count > PEEK_MESSAGES:
                break
        return firsts


def _frame(message: Any) -> str:
    """``header.frame_id``, where a message has it."""
    header = message.get("header") if isinstance(message, dict) else getattr(message, "header", None)
    frame = header.get("frame_id") if isinstance(header, dict) else getattr(header, "frame_id", "")
    return frame[:100] if isinstance(frame, str) else ""


def _undecodable(channel: Channel, error: Exception, where: str) -> DataError:
    reason = str(error)[:120] or type(error).__name__
    return DataError(
        f"a message of {channel.topic} ({channel.kind.name}) cannot be read ({reason})",
        where=where,
        remedy="leave the topic out, or copy the log again",
    )


def _listed(names: Sequence[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
