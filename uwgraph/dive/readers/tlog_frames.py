"""The MAVLink frames of a ``.tlog``: eight bytes of receive time (microseconds UTC, big endian), then the frame.

A frame counts when its checksum is right, so that damage costs the frames it hits and nothing else. Checksums and
layouts of the messages are pymavlink's.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any, BinaryIO, Final, NamedTuple

from uwgraph.errors import ConfigError

STAMP: Final = 8
_HEADERS: Final = {0xFE: 6, 0xFD: 10}
"""Length of the header of MAVLink 1 and 2, by first byte."""
_CRC, _SIGNATURE, _SIGNED = 2, 13, 1
_LONGEST: Final = STAMP + 10 + 255 + _CRC + _SIGNATURE
_BOOT_US: Final = {"time_boot_ms": 1000, "time_usec": 1, "usec": 1}
"""Fields with a time since the sender's start, and their microseconds."""
_TOKEN: Final = re.compile(r"\d*[A-Za-z]")
_MARKS: Final = re.compile(rb"[\xfd\xfe]")
_BLOCK: Final = 1 << 20
_FIRST_US, _LAST_US = 631_152_000_000_000, 4_102_444_800_000_000
"""1990 to 2100."""


class Field(NamedTuple):
    """Where a field lies in the payload."""

    offset: int
    size: int

    def whole(self, payload: bytes) -> int:
        """As an unsigned whole number; bytes that were not sent are zero."""
        return int.from_bytes(payload[self.offset : self.offset + self.size], "little")

    def text(self, payload: bytes) -> str:
        """As text, up to the first zero byte."""
        raw = payload[self.offset : self.offset + self.size].partition(b"\0")[0]
        return raw.decode("ascii", errors="backslashreplace")


@dataclass(frozen=True, eq=False)
class Kind:
    """A message of the dialect: what frames and stamps need of it."""

    name: str
    type: Any
    """pymavlink's class."""
    boot: Field | None
    """The time since its sender's start ..."""
    boot_us: int
    """... and its unit in microseconds."""
    runs: bool
    """Whether that time is the sender's present one, not that of a measurement."""
    seed: bytes
    """What its checksum has besides the frame."""
    label: Field | None
    """What tells messages of this kind apart: the name of a named value."""


class Frame(NamedTuple):
    """One message as it was received."""

    at: int
    """Byte of the file where its stamp begins."""
    received_us: int
    source: tuple[int, int]
    """System and component."""
    kind: Kind
    payload: bytes
    """As sent: trailing zeros may be missing."""
    whole: bytes
    """From the first byte of the header to the checksum, or signature."""

    @property
    def boot_us(self) -> int:
        """Time since its sender's start, 0 where the message does not say."""
        return self.kind.boot.whole(self.payload) * self.kind.boot_us if self.kind.boot else 0

    @property
    def label(self) -> str:
        return self.kind.label.text(self.payload) if self.kind.label else ""


def dialect() -> ModuleType:
    """pymavlink's ArduPilot dialect; raises ConfigError where it is not installed."""
    try:
        from pymavlink.dialects.v20 import ardupilotmega
    except ImportError as error:
        raise ConfigError(
            "MAVLink logs need pymavlink, which is not installed",
            where="tlog",
            remedy="pip install 'uwgraph[ardusub]'",
        ) from error
    module: ModuleType = ardupilotmega
    return module


def begins_with_frame(block: bytes, at: int = 0) -> bool:
    """Whether a stamp and a frame may begin here."""
    mark = at + STAMP
    return (
        mark < len(block) and block[mark] in _HEADERS and _FIRST_US < int.from_bytes(block[at:mark], "big") < _LAST_US
    )


class Frames:
    """The frames of a file, from its start on; read in blocks, so that memory does not grow with it."""

    def __init__(self, file: BinaryIO, size: int, dialect: ModuleType) -> None:
        self._file = file
        self.size = size
        self._kinds = {number: _kind(message) for number, message in dialect.mavlink_map.items()}
        self._checksum = dialect.x25crc
        self.lost = 0
        """Bytes of the last pass that are no frames."""
        self.first_lost = 0
        self.unknown = 0
        """Frames of the last pass that the dialect does not know, or knows otherwise."""

    def __iter__(self) -> Iterator[Frame]:
        start = 0
        self.lost = self.unknown = 0
        while start < self.size:
            self._file.seek(start)
            block = self._file.read(_BLOCK + 2 * _LONGEST)
            is_last = start + len(block) >= self.size or len(block) < _BLOCK
            at, end = 0, len(block) if is_last else _BLOCK
            while at < end:
                length = _length(block, at)
                frame = self._frame(block, at, length, start) if length else None
                if frame is not None:
                    yield frame
                    at += length
                elif length and (at + length == len(block) or begins_with_frame(block, at + length)):
                    self.unknown += 1
                    at += length
                else:
                    after = self._next(block, at + 1, end)
                    self.first_lost = self.first_lost if self.lost else start + at
                    self.lost += after - at
                    at = after
            start += at or len(block) or self.size

    def _frame(self, block: bytes, at: int, length: int, start: int) -> Frame | None:
        """The frame of a stated length, if its message is known and its checksum is right."""
        whole = block[at + STAMP : at + length]
        if whole[0] == 0xFD:
            number, source, header = int.from_bytes(whole[7:10], "little"), (whole[5], whole[6]), 10
        else:
            number, source, header = whole[5], (whole[3], whole[4]), 6
        kind = self._kinds.get(number)
        if kind is None:
            return None
        end = header + whole[1]
        if self._checksum(whole[1:end] + kind.seed).crc != whole[end] + (whole[end + 1] << 8):
            return None
        received_us = int.from_bytes(block[at : at + STAMP], "big")
        return Frame(start + at, received_us, source, kind, whole[header:end], whole)

    def _next(self, block: bytes, at: int, end: int) -> int:
        """Where the next sound frame begins; the end if there is none."""
        for mark in _MARKS.finditer(block, at + STAMP, end + STAMP):
            begin = mark.start() - STAMP
            length = _length(block, begin)
            if length and self._frame(block, begin, length, 0) is not None:
                return begin
        return end


def _length(block: bytes, at: int) -> int:
    """Bytes of the frame that begins here, its stamp included; 0 where none does or it is cut off."""
    if not begins_with_frame(block, at) or at + STAMP + 3 > len(block):
        return 0
    mark, payload, flags = block[at + STAMP : at + STAMP + 3]
    length = STAMP + _HEADERS[mark] + payload + _CRC
    if mark == 0xFD:
        if flags & ~_SIGNED:
            return 0
        length += _SIGNATURE * flags
    return length if at + length <= len(block) else 0


def _kind(message: Any) -> Kind:
    """The dialect's message class as frames need it."""
    name = next((name for name in _BOOT_US if name in message.ordered_fieldnames), None)
    return Kind(
        name=message.msgname,
        type=message,
        boot=_field(message, name) if name else None,
        boot_us=_BOOT_US[name] if name else 0,
        runs=name == "time_boot_ms",
        seed=bytes((message.crc_extra,)),
        label=_field(message, "name") if message.msgname.startswith("NAMED_VALUE_") else None,
    )


def _field(message: Any, name: str) -> Field:
    """The place of a field in the payload."""
    tokens = _TOKEN.findall(message.unpacker.format)
    index = message.ordered_fieldnames.index(name)
    return Field(struct.calcsize("<" + "".join(tokens[:index])), struct.calcsize("<" + tokens[index]))
