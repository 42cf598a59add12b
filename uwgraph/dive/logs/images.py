"""Images of a topic to numbered files as they come, so that memory stays flat whatever the log's size."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from uwgraph.dive.logs.sinks import NumberSink, Poured
from uwgraph.errors import DataError
from uwgraph.types import FloatArray, TimeArray

MAX_PIXELS: Final = 100_000_000
"""Larger images are refused before anything of them is unpacked."""
_SUFFIX: Final = {"PNG": ".png", "JPEG": ".jpg"}

_LAYOUTS: Final[Mapping[str, tuple[int, int, tuple[int, ...]]]] = {
    "mono8": (1, 1, (0,)),
    "mono16": (2, 1, (0,)),
    "8uc1": (1, 1, (0,)),
    "16uc1": (2, 1, (0,)),
    "rgb8": (1, 3, (0, 1, 2)),
    "bgr8": (1, 3, (2, 1, 0)),
    "8uc3": (1, 3, (2, 1, 0)),
    "rgba8": (1, 4, (0, 1, 2)),
    "bgra8": (1, 4, (2, 1, 0)),
    **{f"bayer_{order}{bits}": (bits // 8, 1, (0,)) for order in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)},
}
"""Bytes a sample, samples a pixel, and which of them are red, green and blue, of every encoding (lower case)."""

_PARTS: Final = ("data", "encoding", "height", "width", "step", "is_bigendian")


class ImageSink:
    """Writes every image into a folder, and keeps its stamp.

    Parameters
    ----------
    folder : Path
        Where the files go; made with the first one.
    max_rate_hz : float, optional
        Write no more than so many a second.
    """

    def __init__(self, folder: Path, max_rate_hz: float | None = None) -> None:
        self._folder = folder
        self._apart_ns = round(1e9 / max_rate_hz) if max_rate_hz else 0
        self._next_ns: int | None = None
        self._stamps = NumberSink(())
        self.files: list[str] = []
        self.skipped: list[str] = []
        """Why each image that was not written was not."""
        self.encodings: set[str] = set()

    def add(self, t_ns: int, message: Any) -> None:
        if self._next_ns is not None and self._apart_ns and 0 < self._next_ns - t_ns <= self._apart_ns:
            return
        try:
            content, suffix, encoding = _packed(message)
        except (ValueError, TypeError, AttributeError, OverflowError, OSError, Image.DecompressionBombError) as error:
            self.skipped.append(str(error)[:100] or type(error).__name__)
            return
        self._next_ns = t_ns + self._apart_ns
        self._folder.mkdir(parents=True, exist_ok=True)
        name = f"{len(self.files) + 1:06d}{suffix}"
        (self._folder / name).write_bytes(content)
        self.files.append(name)
        self.encodings.add(encoding)
        self._stamps.add(t_ns, message)

    def extend(self, t_ns: TimeArray, columns: Mapping[str, FloatArray]) -> None:
        raise DataError("a table holds no images", where=self._folder.name, remedy="take images out of the mapping")

    def poured(self) -> Poured:
        """The stamps of the images that were written."""
        return self._stamps.poured()

    def keep(self, rows: TimeArray) -> NDArray[np.str_]:
        """The names of the images of those rows; the files of all others are removed."""
        kept = {self.files[row] for row in rows}
        for name in self.files:
            if name not in kept:
                (self._folder / name).unlink()
        return np.array([self.files[row] for row in rows], dtype=np.str_)


def _packed(message: Any) -> tuple[bytes, str, str]:
    """Content, suffix and encoding of the file of an image message, raw or compressed; ValueError where it is none."""
    data, encoding, height, width, step, big_endian = (_part(message, name) for name in _PARTS)
    if data is None:
        raise ValueError("no image data")
    if encoding is None:
        return _as_it_is(bytes(data))
    content = np.frombuffer(data, dtype=np.uint8) if isinstance(data, bytes) else np.asarray(data, dtype=np.uint8)
    layout = str(encoding).lower()
    pixels = _pixels(content, layout, int(height), int(width), int(step or 0), bool(big_endian))
    packed = io.BytesIO()
    Image.fromarray(pixels).save(packed, "PNG", compress_level=1)
    return packed.getvalue(), ".png", layout


def _part(message: Any, name: str) -> Any:
    return message.get(name) if isinstance(message, Mapping) else getattr(message, name, None)


def _pixels(
    data: NDArray[np.uint8], encoding: str, height: int, width: int, step: int, big_endian: bool
) -> NDArray[Any]:
    """The array of a raw image, shape (h, w) or (h, w, 3), a mosaic left as it is."""
    if encoding not in _LAYOUTS:
        raise ValueError(f"encoding {encoding[:40]!r} is not known")
    size, samples, order = _LAYOUTS[encoding]
    row = width * size * samples
    if not (height > 0 and width > 0 and height * width <= MAX_PIXELS):
        raise ValueError(f"{width} x {height} pixels")
    step = step or row
    if step < row or len(data) < step * (height - 1) + row:
        raise ValueError(f"{len(data)} bytes are too few for {width} x {height} {encoding}")
    lines = np.ndarray((height, row), dtype=np.uint8, buffer=data, strides=(step, 1))
    values = np.ascontiguousarray(lines).view(">u2" if big_endian else "<u2") if size == 2 else lines
    if samples == 1:
        return np.ascontiguousarray(values.astype(np.uint16) if size == 2 else values)
    return np.ascontiguousarray(values.reshape(height, width, samples)[..., list(order)])


def _as_it_is(content: bytes) -> tuple[bytes, str, str]:
    """A PNG or JPEG file, whose head is looked at and whose pixels are not unpacked."""
    with Image.open(io.BytesIO(content), formats=tuple(_SUFFIX)) as image:
        if image.width * image.height > MAX_PIXELS:
            raise ValueError(f"{image.width} x {image.height} pixels")
        suffix = _SUFFIX[str(image.format)]
    return content, suffix, suffix[1:]
