"""Images of logs: every encoding against pixels made here, files as they are, and what is refused."""

from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from uwgraph.dive.logs.images import ImageSink

START = 1_654_646_400_000_000_000
RNG = np.random.default_rng(5)
GREY8 = RNG.integers(0, 256, (5, 7), dtype=np.uint8)
GREY16 = RNG.integers(0, 65536, (5, 7), dtype=np.uint16)
COLOUR = RNG.integers(0, 256, (5, 7, 3), dtype=np.uint8)
ALPHA = np.dstack([COLOUR, GREY8])


def raw(encoding: str, pixels: NDArray[Any], pad: int = 0, big_endian: bool = False, **changed: Any) -> SimpleNamespace:
    """A raw image message whose rows have ``pad`` bytes more than they need."""
    stored = pixels.astype(pixels.dtype.newbyteorder(">")) if big_endian else pixels
    rows = stored.reshape(len(pixels), -1).view(np.uint8).reshape(len(pixels), -1)
    data = np.pad(rows, ((0, 0), (0, pad)), constant_values=9).ravel()
    message = {"height": len(pixels), "width": pixels.shape[1], "encoding": encoding, "step": rows.shape[1] + pad}
    return SimpleNamespace(**message | {"is_bigendian": int(big_endian), "data": data} | changed)


def written(folder: Path, message: Any) -> tuple[ImageSink, list[Path]]:
    sink = ImageSink(folder / "down")
    sink.add(START, message)
    return sink, sorted((folder / "down").glob("*"))


@pytest.mark.parametrize("pad", [0, 3])
@pytest.mark.parametrize(
    ("encoding", "sent", "expected"),
    [
        ("mono8", GREY8, GREY8),
        ("8UC1", GREY8, GREY8),
        ("mono16", GREY16, GREY16),
        ("bayer_rggb8", GREY8, GREY8),
        ("bayer_gbrg16", GREY16, GREY16),
        ("rgb8", COLOUR, COLOUR),
        ("bgr8", COLOUR[..., ::-1], COLOUR),
        ("rgba8", ALPHA, COLOUR),
        ("bgra8", ALPHA[..., [2, 1, 0, 3]], COLOUR),
    ],
)
def test_raw_images_keep_every_pixel(
    tmp_path: Path, encoding: str, sent: NDArray[Any], expected: NDArray[Any], pad: int
) -> None:
    sink, files = written(tmp_path, raw(encoding, np.ascontiguousarray(sent), pad))
    assert [file.name for file in files] == ["000001.png"]
    assert sink.encodings == {encoding.lower()}
    with Image.open(files[0]) as image:
        np.testing.assert_array_equal(np.asarray(image), expected)


def test_sixteen_bits_of_the_other_end(tmp_path: Path) -> None:
    _, files = written(tmp_path, raw("mono16", GREY16, big_endian=True))
    with Image.open(files[0]) as image:
        np.testing.assert_array_equal(np.asarray(image), GREY16)


@pytest.mark.parametrize(("kind", "suffix"), [("PNG", ".png"), ("JPEG", ".jpg")])
def test_compressed_images_stay_byte_for_byte(tmp_path: Path, kind: str, suffix: str) -> None:
    packed = io.BytesIO()
    Image.fromarray(COLOUR).save(packed, kind)
    _, files = written(tmp_path, {"format": "whatever", "data": packed.getvalue()})
    assert files[0].suffix == suffix
    assert files[0].read_bytes() == packed.getvalue()


def png_head(width: int, height: int) -> bytes:
    """The beginning of a PNG that says it is of that size, and nothing else."""
    packed = io.BytesIO()
    Image.fromarray(GREY8).save(packed, "PNG")
    head = bytearray(packed.getvalue())
    head[16:24] = width.to_bytes(4, "big") + height.to_bytes(4, "big")
    from zlib import crc32

    head[29:33] = crc32(bytes(head[12:29])).to_bytes(4, "big")
    return bytes(head)


@pytest.mark.parametrize(
    "message",
    [
        raw("mono8", GREY8, data=GREY8.ravel()[:-1]),
        raw("mono8", GREY8, height=2**31, width=2**31),
        raw("mono8", GREY8, height=0),
        raw("mono8", GREY8, step=3),
        raw("yuv422", GREY8),
        raw("", GREY8),
        {"format": "png", "data": b"not an image"},
        {"format": "png", "data": png_head(60_000, 60_000)},
        {"format": "png", "data": b""},
        {"format": "gif", "data": b"GIF89a" + bytes(50)},
        SimpleNamespace(),
        {"encoding": "mono8", "data": b"1234"},
        {"data": "text"},
    ],
)
def test_what_is_no_image_is_left_out_and_told(tmp_path: Path, message: Any) -> None:
    sink, files = written(tmp_path, message)
    assert files == []
    assert len(sink.skipped) == 1
    assert sink.skipped[0]


def test_files_of_images_that_are_not_kept_are_removed(tmp_path: Path) -> None:
    sink = ImageSink(tmp_path / "down", max_rate_hz=10.0)
    for k in range(10):
        sink.add(START + k * 50_000_000, raw("mono8", GREY8))
    assert sink.files == [f"{k:06d}.png" for k in range(1, 6)]
    assert list(np.diff(sink.poured().log_ns)) == [100_000_000] * 4
    assert list(sink.keep(np.array([1, 3]))) == ["000002.png", "000004.png"]
    assert sorted(file.name for file in (tmp_path / "down").iterdir()) == ["000002.png", "000004.png"]
