"""Compressed blocks of logs, inflated to a size that was stated and checked beforehand; bombs are never inflated."""

from __future__ import annotations

import bz2
from pathlib import Path
from typing import Final

import lz4.frame
import zstandard

MAX_BLOCK: Final = 1 << 28
"""Bytes: larger records, chunks and messages (256 MiB) are refused, before and after inflating."""
MAX_RATIO: Final = 200
"""A compressed file that would grow by more than this is refused (logs of sensors shrink 2 to 20 times)."""


class InflateError(ValueError):
    """What is wrong with a compressed block, in words."""


def inflate(data: bytes | memoryview, compression: str, size: int) -> bytes | memoryview:
    """``size`` bytes out of a block compressed with ``bz2``, ``lz4`` or ``zstd``; ``none`` and the empty name pass.

    Raises
    ------
    InflateError
        When the block is damaged or does not hold exactly ``size`` bytes; never inflates more than one byte beyond.
    """
    if compression in ("", "none"):
        inflated: bytes | memoryview = data
    elif compression not in ("bz2", "lz4", "zstd"):
        raise InflateError(f"compression {compression[:20]!r} is not known")
    else:
        inflated = _inflate(data, compression, size + 1)
    if len(inflated) != size:
        more = "more than " if len(inflated) > size else ""
        raise InflateError(f"a block of {size} bytes holds {more}{min(len(inflated), size)}")
    return inflated


def inflate_message(data: bytes | memoryview) -> bytes:
    """A message compressed with zstd, of at most :data:`MAX_BLOCK` bytes; raises :class:`InflateError`."""
    inflated = _inflate(data, "zstd", MAX_BLOCK + 1)
    if len(inflated) > MAX_BLOCK:
        raise InflateError(f"a message is larger than {MAX_BLOCK} bytes")
    return inflated


def inflate_file(source: Path, target: Path) -> None:
    """Write a zstd file inflated, to at most :data:`MAX_RATIO` times its size; raises :class:`InflateError`."""
    limit = MAX_RATIO * source.stat().st_size
    written = 0
    try:
        with source.open("rb") as file, target.open("wb") as out:
            reader = zstandard.ZstdDecompressor(max_window_size=MAX_BLOCK).stream_reader(file, read_across_frames=True)
            while block := reader.read(1 << 20):
                written += len(block)
                if written > limit:
                    raise InflateError(f"grows to more than {MAX_RATIO} times its size")
                out.write(block)
    except zstandard.ZstdError as error:
        raise InflateError(f"is no whole zstd file ({error})") from error


def _inflate(data: bytes | memoryview, compression: str, most: int) -> bytes:
    """At most ``most`` bytes of the block."""
    try:
        if compression == "bz2":
            return bz2.BZ2Decompressor().decompress(data, max_length=most)
        if compression == "lz4":
            inflated: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
            return inflated
        decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_BLOCK)
        return decompressor.stream_reader(data, read_across_frames=True).read(most)
    except (OSError, EOFError, RuntimeError, ValueError, zstandard.ZstdError) as error:
        raise InflateError(f"a block of {compression} is damaged ({error})") from error
