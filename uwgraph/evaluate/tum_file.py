"""The TUM format read: lines of ``t x y z qx qy qz qw``, whoever wrote them."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv

from uwgraph.errors import DataError
from uwgraph.time import from_text
from uwgraph.types import FloatArray, TimeArray

COLUMNS: Final = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
MAX_BYTES: Final = 512 << 20
"""Larger files are refused, about four million poses: they are read into memory whole."""
MAX_METRES: Final = 1e8
"""Nothing that moves is so far away."""
UNIT_WITHIN: Final = 0.01
"""How far from 1 the length of a quaternion may be: four decimals are enough."""

PACKED: Final = {
    b"\x1f\x8b": "a gzip file",
    b"PK\x03\x04": "a zip file",
    b"\xff\xfe": "UTF-16 text",
    b"\xfe\xff": "UTF-16 text",
}
"""What files begin with that are often taken for text."""

_COMMENT: Final = re.compile(rb"^[ \t]*#.*$", re.MULTILINE)
_FRAMES: Final = re.compile(r"# ([A-Z]{3}) world, ([A-Z]{3})\b[^;]*body")
_ORIGIN: Final = re.compile(r"origin (-?[\d.]+) N, (-?[\d.]+) E")


@dataclass(frozen=True, eq=False)
class TumPoses:
    """What the file holds, in its own frames."""

    t_ns: TimeArray
    """Shape (K,)."""
    p: FloatArray
    """Shape (K, 3), m."""
    q: FloatArray
    """Quaternions xyzw body to world, of length 1, shape (K, 4)."""
    axes: tuple[str, str] | None
    """World and body axes (``ned``, ``frd``) where a comment of ours states them."""
    origin_deg: tuple[float, float] | None
    """Latitude and longitude of the world's origin where a comment of ours states them."""


def read_tum(path: Path) -> TumPoses:
    """Poses of a TUM file of at most :data:`MAX_BYTES`; stamps keep every digit.

    Raises
    ------
    DataError
        When the file is missing, empty, too large, cut off or no TUM file, or holds what cannot be a pose, naming the
        line.
    """
    text = read_bytes(path)
    rows = _COMMENT.sub(b"", text) if b"#" in text else text
    if not rows.strip():
        raise DataError("holds no poses", where=str(path), remedy="is it the right file?")
    table = _table(path, rows)
    numbers = np.column_stack([table.column(name).to_numpy() for name in COLUMNS[1:]])
    stamps = [_stamp(path, rows, row, cell) for row, cell in enumerate(table.column("t").to_pylist())]
    t_ns, p, q = np.array(stamps, dtype=np.int64), numbers[:, :3], numbers[:, 3:]
    length = _check(path, rows, t_ns, p, q)
    head = text[:4096].decode()
    axes, origin = _FRAMES.search(head), _ORIGIN.search(head)
    return TumPoses(
        t_ns,
        p,
        q / length[:, None],
        axes=(axes[1].lower(), axes[2].lower()) if axes else None,
        origin_deg=(float(origin[1]), float(origin[2])) if origin else None,
    )


def read_bytes(path: Path) -> bytes:
    """A file of text, of at most :data:`MAX_BYTES`.

    Raises
    ------
    DataError
        When it is missing, empty, too large or no text.
    """
    try:
        size = path.stat().st_size
        text = path.read_bytes().removeprefix(b"\xef\xbb\xbf") if size <= MAX_BYTES else b""
    except OSError as error:
        raise DataError(
            f"cannot be read ({error.strerror})", where=str(path), remedy="check the name and the permissions"
        ) from error
    if size > MAX_BYTES:
        raise DataError(
            f"has {size / 1e6:.0f} MB, more than the limit of {MAX_BYTES / 1e6:.0f} MB",
            where=str(path),
            remedy="thin it out ('uwgraph export --rate HZ'), or cut it",
        )
    if not text:
        raise DataError("the file is empty", where=str(path), remedy="copy or export it again")
    try:
        text.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _damaged(path, text, error.start) from error
    if b"\0" in text:
        raise _damaged(path, text, text.index(b"\0"))
    return text


def _damaged(path: Path, text: bytes, at: int) -> DataError:
    for mark, what in PACKED.items():
        if text.startswith(mark):
            return DataError(
                f"this is {what}, not plain text", where=str(path), remedy="unpack it, or save it as UTF-8"
            )
    line = text.count(b"\n", 0, at) + 1
    return DataError(f"line {line} is no text", where=str(path), remedy="is it the right file, and a whole copy of it?")


def _table(path: Path, rows: bytes) -> pa.Table:
    plain = rows.translate(bytes.maketrans(b"\t\r", b"  "))
    while b"  " in plain:
        plain = plain.replace(b"  ", b" ")
    plain = plain.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")
    try:
        return pa.csv.read_csv(
            io.BytesIO(plain),
            pa.csv.ReadOptions(column_names=list(COLUMNS), use_threads=False),
            pa.csv.ParseOptions(delimiter=" ", quote_char=False),
            pa.csv.ConvertOptions(
                column_types={name: pa.string() if name == "t" else pa.float64() for name in COLUMNS},
                null_values=[],
            ),
        )
    except (pa.ArrowException, ValueError) as error:
        raise _fault(path, rows, str(error).partition("\n")[0][:160]) from error


def _fault(path: Path, rows: bytes, message: str) -> DataError:
    """The first line that is no pose, in words."""
    lines = list(_lines(rows))
    for number, cells in lines:
        if len(cells) != len(COLUMNS):
            cut = number == lines[-1][0] and len(cells) < len(COLUMNS)
            remedy = "the file is cut off: copy it again" if cut else f"every line must hold {' '.join(COLUMNS)}"
            return DataError(f"line {number} has {len(cells)} columns instead of 8", where=str(path), remedy=remedy)
        for name, cell in zip(COLUMNS, cells, strict=True):
            try:
                float(cell)
            except ValueError:
                return DataError(
                    f"line {number} holds {cell[:40].decode(errors='replace')!r}, which is no number",
                    where=f"{path}: {name}",
                    remedy="repair or remove the line",
                )
    return DataError(message, where=str(path), remedy="repair the file, or export it again")


def _stamp(path: Path, rows: bytes, row: int, cell: str) -> int:
    try:
        return from_text(cell)
    except ValueError as error:
        raise _bad(path, rows, row, "t", str(error), "write seconds") from error


def _check(path: Path, rows: bytes, t_ns: TimeArray, p: FloatArray, q: FloatArray) -> FloatArray:
    """The lengths of the quaternions, once nothing speaks against the poses."""
    with np.errstate(over="ignore", invalid="ignore"):
        length: FloatArray = np.linalg.norm(q, axis=1)
        off = np.abs(length - 1.0)
    _refuse(path, rows, ~(np.abs(p) < MAX_METRES).all(axis=1), "x y z", "holds no position", "repair or remove it")
    _refuse(
        path,
        rows,
        ~(off < UNIT_WITHIN),
        "qx qy qz qw",
        "holds no unit quaternion",
        "the order is qx qy qz qw; repair or remove the line",
    )
    back = np.concatenate([[False], np.diff(t_ns) <= 0])
    _refuse(
        path,
        rows,
        back,
        "t",
        "has a stamp that does not come after the one before",
        "sort the file by time (sort -n), and remove doubled lines",
    )
    if not rows.rstrip(b" \t").endswith((b"\n", b"\r")) and off[-1] > _rounding(rows):
        raise _bad(path, rows, len(t_ns) - 1, "qw", "is cut off", "copy the file again, or remove the line")
    return length


def _rounding(rows: bytes) -> float:
    """How far from 1 the digits of the last line leave a quaternion: more, and its last number has been cut short."""
    *_, qx, qy, qz, _ = rows.rstrip().rpartition(b"\n")[2].split()
    decimals = (-int(Decimal(cell.decode()).as_tuple().exponent) for cell in (qx, qy, qz))
    return float(2.0 * 10.0 ** -max(decimals))


def _refuse(path: Path, rows: bytes, bad: Any, columns: str, problem: str, remedy: str) -> None:
    if bad.any():
        raise _bad(path, rows, int(bad.argmax()), columns, problem, remedy)


def _bad(path: Path, rows: bytes, row: int, columns: str, problem: str, remedy: str) -> DataError:
    number, cells = next(line for index, line in enumerate(_lines(rows)) if index == row)
    shown = b" ".join(cells)[:80].decode(errors="replace")
    return DataError(f"line {number} {problem}: {shown!r}", where=f"{path}: {columns}", remedy=remedy)


def _lines(rows: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Numbers and cells of the lines that hold something."""
    for number, line in enumerate(io.BytesIO(rows), start=1):
        if cells := line.split():
            yield number, cells
