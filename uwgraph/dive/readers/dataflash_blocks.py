"""The messages of a DataFlash file as tables, block by block.

A message is A3 95, its type, its body; its length and columns come from an FMT message before it. There is no
checksum: a message counts when another one, or the end of its block, follows it.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.void]
"""Messages of one type: a structured array with the columns of its format."""

HEADER: Final = b"\xa3\x95"
FMT: Final = 128
BLOCK: Final = 1 << 22
_MARGIN: Final = 600
"""Bytes of the next block that are read as well: two of the longest messages."""
_DEFINITION: Final = struct.Struct("<BB4s16s64s")
_FMT_LENGTH: Final = 3 + _DEFINITION.size
_NAME: Final = re.compile(r"\w{1,16}")

_CODES: Final[Mapping[str, str]] = {
    "b": "i1", "B": "u1", "M": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8",
    "g": "<f2", "f": "<f4", "d": "<f8", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
    "n": "S4", "N": "S16", "Z": "S64", "a": "V64",
}  # fmt: skip
"""Letters of ArduPilot's formats, and what they are in the file."""
_SCALES: Final[Mapping[str, float]] = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
"""Letters that bring a scale with them."""


@dataclass(frozen=True)
class Format:
    """One type of message."""

    name: str
    dtype: np.dtype[np.void]
    """Of the whole message, header included."""
    scales: Mapping[str, float]
    """What brings a column's number to the unit of its format; columns of text are not here."""
    scaled: frozenset[str]
    """Columns whose letter has a scale of its own."""
    whole: frozenset[str]
    """Columns of whole numbers."""


@dataclass(frozen=True)
class Block:
    """A stretch of the file and where the messages of each type begin in it, in file order."""

    data: bytes
    offsets: Mapping[int, list[int]]
    share: float
    """How much of the file is read at its end."""

    def rows(self, kind: int, this: Format) -> Rows:
        """The messages of a type as a table."""
        index = np.array(self.offsets[kind])[:, None] + np.arange(this.dtype.itemsize)
        rows: Rows = np.frombuffer(self.data, np.uint8)[index].reshape(-1).view(this.dtype)
        return rows

    def column(self, kind: int, this: Format, name: str) -> NDArray[Any]:
        """One column of them, as it is in the file."""
        fields: Mapping[str, Any] = this.dtype.fields or {}
        dtype, offset = fields[name][:2]
        index = np.array(self.offsets[kind])[:, None] + offset + np.arange(dtype.itemsize)
        column: NDArray[Any] = np.frombuffer(self.data, np.uint8)[index].reshape(-1).view(dtype)
        return column


class Blocks:
    """The messages of a file; what is learned of their formats is kept from one pass to the next."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file = file
        self.size = size
        self._lengths = [0] * 256
        self._lengths[FMT] = _FMT_LENGTH
        self.formats: dict[int, Format] = {}
        self.lost = 0
        """Bytes of the last pass that belong to no message."""
        self.first_lost = 0
        """Where the first of them is."""

    def __iter__(self) -> Iterator[Block]:
        """Read the file from its start."""
        at = 0
        self.lost = 0
        while at < self.size:
            self._file.seek(at)
            data = self._file.read(BLOCK + _MARGIN)
            if not data:  # the file became shorter
                return
            found, after = self._walk(data, at)
            at += after
            known = {kind: offsets for kind, offsets in found.items() if offsets and kind in self.formats}
            yield Block(data, known, at / self.size)

    def _walk(self, block: bytes, start: int) -> tuple[dict[int, list[int]], int]:
        """Where the messages of each type begin in the block, and where the next block does."""
        found: list[list[int]] = [[] for _ in range(256)]
        lengths, size = self._lengths, len(block)
        end = size if start + size >= self.size or size < BLOCK else BLOCK
        at, before = 0, -1
        while at < end:
            if block[at : at + 2] == HEADER and at + 2 < size and (length := lengths[kind := block[at + 2]]):
                if kind == FMT and at + length <= size:
                    self._learn(block[at + 3 : at + length])
                found[kind].append(at)
                before = at
                at += length
                continue
            if before >= 0:  # the message before ends where none begins: it is as doubtful
                found[block[before + 2]].pop()
                at = before
            after = self._next(block, at + 1, end)
            self._lose(start + at, after - at)
            at, before = after, -1
        if at > size:  # cut off
            found[block[before + 2]].pop()
            self._lose(start + before, size - before)
        return dict(enumerate(found)), min(at, size)

    def _next(self, block: bytes, at: int, end: int) -> int:
        """Where the next message is that is followed by another one; the end if there is none."""
        while 0 <= (at := block.find(HEADER, at)) < end - 2:
            length = self._lengths[block[at + 2]]
            if length and (block[at + length : at + length + 2] == HEADER or at + length == len(block)):
                return at
            at += 1
        return end

    def _lose(self, at: int, count: int) -> None:
        if not self.lost:
            self.first_lost = at
        self.lost += count

    def _learn(self, body: bytes) -> None:
        """Take a definition; the first one of a type stands."""
        kind, length, *texts = _DEFINITION.unpack(body)
        if self._lengths[kind] or length <= 3:
            return
        self._lengths[kind] = length
        definition = _format(length, *(text.rstrip(b"\0").decode("latin-1") for text in texts))
        if definition is not None:
            self.formats[kind] = definition


def _format(length: int, name: str, letters: str, columns: str) -> Format | None:
    """The format of a definition; None where its parts do not fit together."""
    names = columns.split(",") if columns else []
    sound = all(_NAME.fullmatch(text) for text in (name, *names)) and all(letter in _CODES for letter in letters)
    if not sound or len(letters) != len(names) or len(set(names)) != len(names):
        return None
    codes = [np.dtype(_CODES[letter]) for letter in letters]
    ends = np.cumsum([3, *(code.itemsize for code in codes)]).tolist()
    if ends[-1] != length:
        return None
    layout: Any = {"names": names, "formats": codes, "offsets": ends[:-1], "itemsize": length}
    numbers = {n: _SCALES.get(c, 1.0) for n, c, code in zip(names, letters, codes, strict=True) if code.kind in "iuf"}
    scaled = frozenset(n for n, c in zip(names, letters, strict=True) if c in _SCALES)
    whole = frozenset(n for n, code in zip(names, codes, strict=True) if code.kind in "iu")
    return Format(name, np.dtype(layout), numbers, scaled, whole)
