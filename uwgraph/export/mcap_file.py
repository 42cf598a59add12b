"""MCAP for Foxglove: JSON messages in order of time, in compressed and indexed chunks, written as they are made."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from uwgraph import __version__
from uwgraph.export.foxglove import Message, encode

_BLOCK: Final = 4096
"""Rows that are Python numbers at the same time."""

Progress = Callable[[float], None]
"""Told now and then which share is written, 0 to 1."""

Stamped = tuple[int, int, Message]
"""Time on the dive's clock, the sensor's own stamp [ns], and the message."""


@dataclass(frozen=True, eq=False)
class Topic:
    """One channel of the file."""

    name: str
    schema: Message
    """JSON schema; its title is the name under which Foxglove knows it."""
    count: int
    """How many messages there are."""
    messages: Iterable[Stamped]
    """In order of time."""


def write_mcap(
    topics: Sequence[Topic], path: Path, metadata: Mapping[str, str], progress: Progress = lambda share: None
) -> int:
    """Write every message of every topic and return their number; memory does not grow with it."""
    total = sum(topic.count for topic in topics)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(library=f"uwgraph {__version__}")
        writer.add_metadata("uwgraph", dict(metadata))
        for done, (t_ns, stamp_ns, channel, message) in enumerate(_merged(writer, topics)):
            writer.add_message(channel, log_time=t_ns, publish_time=stamp_ns, data=encode(message))
            if done % _BLOCK == 0:
                progress(done / total)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves out "-> None"
    return total


def rows(*arrays: NDArray[Any]) -> Iterator[tuple[Any, ...]]:
    """Rows of arrays of one length as Python numbers and lists, a block at a time."""
    for start in range(0, len(arrays[0]), _BLOCK):
        yield from zip(*(array[start : start + _BLOCK].tolist() for array in arrays), strict=True)


def _merged(writer: Writer, topics: Sequence[Topic]) -> Iterator[tuple[int, int, int, Message]]:
    """The messages of all topics in order of time, each with its channel."""
    schemas: dict[str, int] = {}
    channels = []
    for topic in topics:
        title = topic.schema["title"]
        if title not in schemas:
            schemas[title] = writer.register_schema(title, "jsonschema", encode(topic.schema))
        channels.append(writer.register_channel(topic.name, "json", schemas[title]))
    numbered = [_on(channel, topic.messages) for channel, topic in zip(channels, topics, strict=True)]
    yield from heapq.merge(*numbered, key=itemgetter(0))


def _on(channel: int, messages: Iterable[Stamped]) -> Iterator[tuple[int, int, int, Message]]:
    for t_ns, stamp_ns, message in messages:
        yield t_ns, stamp_ns, channel, message
