"""ROS 1 bags, version 2.0, in the order of the file (http://wiki.ros.org/Bags/Format/2.0).

The reader of rosbags needs the index of a bag that was closed properly, keeps all of it in memory, and inflates chunks
to whatever size they have. A vehicle that loses power closes nothing, so here the records are walked.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, Final

from rosbags.typesys.msg import normalize_msgtype

from uwgraph.dive.readers.damage import Damage
from uwgraph.dive.readers.inflate import MAX_BLOCK, InflateError, inflate
from uwgraph.dive.readers.ros_log import Channel, Message
from uwgraph.dive.readers.ros_types import MessageType
from uwgraph.errors import DataError

MAGIC: Final = b"#ROSBAG V2.0\n"
MAX_HEADER: Final = 1 << 20
"""Bytes of a record's header."""
_LENGTH: Final = struct.Struct("<I")
_TIME: Final = struct.Struct("<II")
_COUNT: Final = struct.Struct("<II")
_MESSAGE, _BAG, _CHUNK, _CHUNK_INFO, _CONNECTION = (bytes([op]) for op in (2, 3, 5, 6, 7))

Header = Mapping[bytes, bytes]
Record = tuple[Header, memoryview, int]
"""Header, data, and the byte where it (or the chunk that it is in) begins."""


class _BrokenError(ValueError):
    """What is wrong with a record, in words."""


@contextmanager
def open_bag(path: Path) -> Iterator[Rosbag1]:
    """A bag, open; raises DataError when it cannot be read at all."""
    try:
        with path.open("rb") as file:
            yield Rosbag1(path, file)
    except OSError as error:
        raise DataError(
            f"cannot be read ({error.strerror or error})", where=str(path), remedy="check the name and the permissions"
        ) from error


class Rosbag1:
    """The messages of one bag."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self.damage = Damage()
        self._path = path
        self._file = file
        self._size = path.stat().st_size
        if (magic := file.read(len(MAGIC))) != MAGIC:
            raise DataError(
                f"begins with {magic[:13]!r}, not as bags of version 2.0 do",
                where=str(path),
                remedy="convert an older bag with 'rosbag fix' or 'rosbag migrate'",
            )

    @property
    def caveats(self) -> tuple[str, ...]:
        return self.damage.caveats

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """From the index, or where there is none from reading the whole file."""
        return self._indexed() or self._scanned()

    def messages(self, wanted: Collection[int]) -> Iterator[Message]:
        for header, data, at in self._records():
            if header.get(b"op") != _MESSAGE:
                continue
            try:
                channel = _number(header, b"conn")
                seconds, nanoseconds = _TIME.unpack(header[b"time"])
            except (_BrokenError, KeyError, struct.error):
                self.damage.skip(at, "a message without its stamp or connection")
                continue
            if channel in wanted:
                yield channel, seconds * 1_000_000_000 + nanoseconds, data, at

    def where(self, at: int) -> str:
        return f"{self._path}: byte {at}" if at else str(self._path)

    def share(self) -> float:
        return self._file.tell() / max(self._size, 1)

    def _records(self) -> Iterator[Record]:
        """Connections and messages up to the index, those in chunks included."""
        for header, length, at in self._top(len(MAGIC), self.damage):
            op = header.get(b"op")
            if op == _CHUNK:
                yield from self._chunk(header, self._data(length, at), at)
            elif op in (_CONNECTION, _MESSAGE):
                yield header, self._data(length, at), at

    def _top(self, at: int, damage: Damage) -> Iterator[tuple[Header, int, int]]:
        """Header, length of the data and place of the records of the file; its position is then at the data."""
        while at < self._size:
            self._file.seek(at)
            try:
                header, length = self._head()
            except _BrokenError as error:
                damage.end(at, str(error))
                return
            after = self._file.tell() + length
            if after > self._size:
                damage.end(at, "the bag is cut off")
                return
            yield header, length, at
            at = after

    def _head(self) -> tuple[Header, int]:
        header = _fields(memoryview(self._file.read(self._length(MAX_HEADER))))
        return header, self._length(self._size)

    def _length(self, most: int) -> int:
        number = self._file.read(_LENGTH.size)
        if len(number) < _LENGTH.size:
            raise _BrokenError("the bag is cut off")
        (length,) = _LENGTH.unpack(number)
        if length > most:
            raise _BrokenError(f"a record of {length} bytes")
        return int(length)

    def _data(self, length: int, at: int) -> memoryview:
        if length > MAX_BLOCK:
            raise self._too_large(length, at)
        return memoryview(self._file.read(length))

    def _too_large(self, length: int, at: int) -> DataError:
        return DataError(
            f"a block of {length} bytes is larger than {MAX_BLOCK}",
            where=self.where(at),
            remedy="write the bag in smaller chunks, with 'rosbag record --chunksize'",
        )

    def _chunk(self, header: Header, content: memoryview, at: int) -> Iterator[Record]:
        """The records of a chunk; a damaged one is left out, or ends where it is damaged."""
        try:
            size = _number(header, b"size")
            if size > MAX_BLOCK:
                raise self._too_large(size, at)
            data = memoryview(inflate(content, header.get(b"compression", b"").decode("utf-8", "replace"), size))
            position = 0
            while position < len(data):
                fields, position = _sized(data, position)
                body, position = _sized(data, position)
                yield _fields(fields), body, at
        except (_BrokenError, InflateError) as error:
            self.damage.skip(at, str(error)[:100])

    def _indexed(self) -> tuple[Channel, ...]:
        """The connections that the index lists; none where the bag was not closed, or is damaged."""
        self._file.seek(len(MAGIC))
        found, counts, chunks, damage = _Found(), Counter[int](), 0, Damage()
        try:
            bag, _ = self._head()
            index = _number(bag, b"index_pos")
            if bag.get(b"op") != _BAG or not len(MAGIC) < index < self._size:
                return ()
            for header, length, at in self._top(index, damage):
                if header.get(b"op") == _CONNECTION:
                    found.take(header, self._data(length, at))
                elif header.get(b"op") == _CHUNK_INFO:
                    counts.update(dict(_COUNT.iter_unpack(self._data(length, at))))
                    chunks += 1
            whole = not damage.caveats and chunks == _number(bag, b"chunk_count")
        except (_BrokenError, DataError, struct.error):
            return ()
        return found.listed(counts) if whole and counts.keys() <= found.channels.keys() else ()

    def _scanned(self) -> tuple[Channel, ...]:
        found, counts = _Found(), Counter[int]()
        for header, data, at in self._records():
            try:
                if header.get(b"op") == _CONNECTION:
                    found.take(header, data)
                elif header.get(b"op") == _MESSAGE:
                    counts[_number(header, b"conn")] += 1
            except _BrokenError as error:
                self.damage.skip(at, str(error))
        return found.listed(counts)


class _Found:
    """Connections, as they come."""

    def __init__(self) -> None:
        self.channels: dict[int, tuple[str, MessageType]] = {}

    def take(self, header: Header, data: memoryview) -> None:
        about = _fields(data)
        try:
            topic, name = header[b"topic"].decode(), about[b"type"].decode()
            kind = MessageType(
                name=normalize_msgtype(name),
                encoding="ros1",
                definition=about.get(b"message_definition", b"").decode("utf-8", "replace"),
            )
        except (KeyError, UnicodeDecodeError) as error:
            raise _BrokenError("a connection without its topic or type") from error
        self.channels.setdefault(_number(header, b"conn"), (topic, kind))

    def listed(self, counts: Counter[int]) -> tuple[Channel, ...]:
        return tuple(Channel(id_, topic, kind, counts[id_]) for id_, (topic, kind) in sorted(self.channels.items()))


def _fields(header: memoryview) -> Header:
    """The fields ``name=value`` of a header, each after its length."""
    fields: dict[bytes, bytes] = {}
    position = 0
    while position < len(header):
        field, position = _sized(header, position)
        name, equals, value = bytes(field).partition(b"=")
        if not equals:
            raise _BrokenError("a header without fields")
        fields[name] = value
    return fields


def _sized(data: memoryview, position: int) -> tuple[memoryview, int]:
    """What comes after its length at ``position``, and the position behind it."""
    start = position + _LENGTH.size
    if start > len(data):
        raise _BrokenError("a record is cut off")
    end = start + _LENGTH.unpack_from(data, position)[0]
    if end > len(data):
        raise _BrokenError("a record is longer than what it is in")
    return data[start:end], end


def _number(header: Header, name: bytes) -> int:
    """An unsigned number of a header, of 4 or 8 bytes."""
    value = header.get(name, b"")
    if len(value) not in (4, 8):
        raise _BrokenError(f"a header without {name.decode()}")
    return int.from_bytes(value, "little")
