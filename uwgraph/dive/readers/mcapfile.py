"""Bare MCAP files of any profile whose messages are ROS 1, ROS 2 (CDR) or JSON (https://mcap.dev/spec).

The records are those of the mcap library; what walks over them is here, because the file may be cut off, have no
summary, or state sizes that must not be believed.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema, Statistics
from rosbags.typesys.msg import normalize_msgtype

from uwgraph.dive.logs.log import Log, Proposal, Topic
from uwgraph.dive.readers import ros_messages
from uwgraph.dive.readers.damage import Damage, nothing_left
from uwgraph.dive.readers.inflate import MAX_BLOCK, InflateError, inflate
from uwgraph.dive.readers.ros_log import Channel, Message, RosLog
from uwgraph.dive.readers.ros_types import MessageType
from uwgraph.errors import DataError

NAME: Final = "mcap"
EXPECTS: Final = "a file *.mcap with ROS 1, ROS 2 or JSON messages"
CLOCKS_DIFFER: Final = False

MAGIC: Final = b"\x89MCAP0\r\n"
_RECORD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_CHUNK: Final = struct.Struct("<QQQII")
_LENGTH: Final = struct.Struct("<Q")
_FOOTER: Final = struct.Struct("<BQQQI")
_TAIL: Final = _FOOTER.size + len(MAGIC)
_KEPT: Final = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_UNREADABLE: Final = (McapError, struct.error, UnicodeDecodeError, ValueError)

Record = tuple[int, memoryview, int]
"""Opcode, content, and the byte where it (or the chunk that it is in) begins."""


def matches(path: Path) -> str:
    """Why the recording looks like this format; empty if it does not."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        return "the file begins as MCAP files do" if file.read(len(MAGIC)) == MAGIC else ""


@contextmanager
def open_log(path: Path) -> Iterator[Log]:
    """The log of an MCAP file; raises DataError when it cannot be read at all."""
    with open_storage(path) as storage:
        if not storage.channels:
            raise nothing_left(storage.caveats, str(path))
        yield RosLog(storage)


def proposals(topic: Topic) -> tuple[Proposal, ...]:
    """What a topic could become."""
    return ros_messages.proposals(topic)


@contextmanager
def open_storage(path: Path, distribution: str = "humble") -> Iterator[McapStorage]:
    """An MCAP file, open; ``distribution`` of ROS 2 for types that it does not define."""
    try:
        with path.open("rb") as file:
            yield McapStorage(path, file, distribution)
    except OSError as error:
        raise DataError(
            f"cannot be read ({error.strerror or error})", where=str(path), remedy="check the name and the permissions"
        ) from error


class McapStorage:
    """The messages of one MCAP file in the order of the file."""

    def __init__(self, path: Path, file: BinaryIO, distribution: str) -> None:
        self.damage = Damage()
        self._path = path
        self._file = file
        self._distribution = distribution
        self._size = path.stat().st_size
        if file.read(len(MAGIC)) != MAGIC:
            raise DataError("does not begin as MCAP files do", where=str(path), remedy="name an MCAP file")

    @property
    def caveats(self) -> tuple[str, ...]:
        return self.damage.caveats

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """From the summary, or where there is none from reading the whole file."""
        return self._summarised() or self._scanned()

    def messages(self, wanted: Collection[int]) -> Iterator[Message]:
        for op, content, at in self._records():
            if op != Opcode.MESSAGE:
                continue
            if len(content) < _MESSAGE.size:
                self.damage.skip(at, "a message without its head")
                continue
            channel, _, log_time, _ = _MESSAGE.unpack_from(content)
            if channel in wanted:
                yield channel, log_time, content[_MESSAGE.size :], at

    def where(self, at: int) -> str:
        return f"{self._path}: byte {at}" if at else str(self._path)

    def share(self) -> float:
        return self._file.tell() / max(self._size, 1)

    def _records(self) -> Iterator[Record]:
        """Schemas, channels and messages up to the end of the data, those in chunks included."""
        at = len(MAGIC)
        while True:
            self._file.seek(at)
            head = self._file.read(_RECORD.size)
            if len(head) < _RECORD.size:
                self.damage.end(at, "the file is cut off")
                return
            op, length = _RECORD.unpack(head)
            if op in (Opcode.DATA_END, Opcode.FOOTER):
                return
            after = at + _RECORD.size + length
            if after > self._size or op == 0:
                self.damage.end(at, "the file is cut off" if op else "a record of no kind")
                return
            if op == Opcode.CHUNK:
                yield from self._chunk(self._content(length, at), at)
            elif op in _KEPT:
                yield op, self._content(length, at), at
            at = after

    def _content(self, length: int, at: int) -> memoryview:
        if length > MAX_BLOCK:
            raise DataError(
                f"a record of {length} bytes is larger than {MAX_BLOCK}",
                where=self.where(at),
                remedy="write the log in smaller chunks, such as with 'mcap compress --chunk-size'",
            )
        return memoryview(self._file.read(length))

    def _chunk(self, content: memoryview, at: int) -> Iterator[Record]:
        """The records of a chunk; a damaged one is left out, or ends where it is damaged."""
        try:
            data = self._inflated(content, at)
        except (InflateError, *_UNREADABLE) as error:
            self.damage.skip(at, str(error)[:100])
            return
        position = 0
        while position < len(data):
            if position + _RECORD.size > len(data):
                self.damage.skip(at, "a chunk ends within a record")
                return
            op, length = _RECORD.unpack_from(data, position)
            position += _RECORD.size
            if length > len(data) - position:
                self.damage.skip(at, "a record is longer than its chunk")
                return
            if op in _KEPT:
                yield op, data[position : position + length], at
            position += length

    def _inflated(self, content: memoryview, at: int) -> memoryview:
        _, _, size, checksum, name_length = _CHUNK.unpack_from(content)
        name_end = _CHUNK.size + name_length
        compression = str(content[_CHUNK.size : name_end], "utf-8")
        if size > MAX_BLOCK:
            raise DataError(
                f"a chunk inflates to {size} bytes, more than {MAX_BLOCK}",
                where=self.where(at),
                remedy="write the log in smaller chunks, such as with 'mcap compress --chunk-size'",
            )
        (length,) = _LENGTH.unpack_from(content, name_end)
        start = name_end + _LENGTH.size
        data = inflate(content[start : start + length], compression, size)
        if checksum and zlib.crc32(data) != checksum:
            raise InflateError("a chunk's checksum is wrong")
        return memoryview(data)

    def _summarised(self) -> tuple[Channel, ...]:
        """The channels that the summary lists; none where it is missing or damaged."""
        if self._size < 2 * len(MAGIC) + _FOOTER.size:
            return ()
        footer_at = self._size - _TAIL
        self._file.seek(footer_at)
        op, length, start, _, _ = _FOOTER.unpack(self._file.read(_FOOTER.size))
        whole = op == Opcode.FOOTER and length == _FOOTER.size - _RECORD.size and self._file.read() == MAGIC
        if not whole or not len(MAGIC) <= start < footer_at:
            return ()
        found = _Found(self._distribution)
        counts: dict[int, int] | None = None
        at = start
        try:
            while at < footer_at:
                self._file.seek(at)
                op, length = _RECORD.unpack(self._file.read(_RECORD.size))
                if op in _KEPT:
                    found.take(op, self._content(length, at))
                elif op == Opcode.STATISTICS:
                    counts = Statistics.read(_stream(self._content(length, at))).channel_message_counts
                at += _RECORD.size + length
        except (DataError, *_UNREADABLE):
            return ()
        if counts is not None and not counts.keys() <= found.channels.keys():
            return ()
        return found.listed(counts)

    def _scanned(self) -> tuple[Channel, ...]:
        found = _Found(self._distribution)
        counts: Counter[int] = Counter()
        for op, content, at in self._records():
            if op == Opcode.MESSAGE:
                counts[int.from_bytes(content[:2], "little")] += 1
                continue
            try:
                found.take(op, content)
            except _UNREADABLE as error:
                self.damage.skip(at, f"a {Opcode(op).name.lower()} that cannot be read ({str(error)[:60]})")
        return found.listed(counts)


class _Found:
    """Schemas and channels, as they come."""

    def __init__(self, distribution: str) -> None:
        self.channels: dict[int, ChannelRecord] = {}
        self._schemas: dict[int, Schema] = {}
        self._distribution = distribution

    def take(self, op: int, content: memoryview) -> None:
        if op == Opcode.SCHEMA:
            schema = Schema.read(_stream(content))
            self._schemas.setdefault(schema.id, schema)
        elif op == Opcode.CHANNEL:
            channel = ChannelRecord.read(_stream(content))
            self.channels.setdefault(channel.id, channel)

    def listed(self, counts: dict[int, int] | None) -> tuple[Channel, ...]:
        return tuple(
            Channel(id_, record.topic, self._kind(record), None if counts is None else counts.get(id_, 0))
            for id_, record in sorted(self.channels.items())
        )

    def _kind(self, record: ChannelRecord) -> MessageType:
        schema = self._schemas.get(record.schema_id) or Schema(id=0, name="", encoding="", data=b"")
        encoding = record.message_encoding
        return MessageType(
            name=normalize_msgtype(schema.name) if "/" in schema.name else schema.name,
            encoding=encoding,
            definition=schema.data.decode("utf-8", "replace"),
            definition_encoding=schema.encoding,
            distribution=self._distribution,
        )


def _stream(content: memoryview) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
