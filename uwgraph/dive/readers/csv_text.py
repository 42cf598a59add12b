"""The text of a table: its header, its separator, and its rows in batches of columns that are converted when asked for.

Everything is read as text and converted by column, so that a cell that is no number is named by row and column, and
columns that nobody wants cannot fail.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from uwgraph.errors import DataError

MAX_HEAD: Final = 1 << 16
"""Bytes in which header and first row must lie."""
MAX_COLUMNS: Final = 2048
BLOCK: Final = 1 << 20
"""Bytes a batch; no line may be longer."""
SEPARATORS: Final = (",", ";", "\t")

_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)", re.IGNORECASE)
_WHOLE: Final = re.compile(r"-?\d{10,19}")
_TIME: Final = re.compile(r"\d{4}[-/]\d\d[-/]\d\d([T ]\d\d:\d\d.*)?")
_DECIMAL_COMMA: Final = re.compile(r"[-+]?\d+,\d+")
_NO_VALUE: Final = ("", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None", "-")


@dataclass(frozen=True)
class Head:
    """How a table begins."""

    names: tuple[str, ...]
    separator: str
    lines: int
    """Before the first row."""
    first: tuple[str, ...]
    """The cells of the first row."""


def read_head(path: Path) -> Head:
    """Header and first row.

    Raises
    ------
    DataError
        When the file is no table of separated text with a header line.
    """
    lines = _first_lines(path)
    rows = [index for index, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    if not rows:
        raise DataError("holds no rows", where=str(path), remedy="is it the right file?")
    header, row = _header_and_row(lines, rows)
    separator = max(SEPARATORS, key=lines[header].count)
    names = tuple(_cells(lines[header].lstrip("# "), separator))
    first = tuple(_cells(lines[row], separator)) if row < len(lines) else ()
    _check(path, names, first, separator, header)
    return Head(names, separator, row, first)


def looks_like_table(path: Path) -> bool:
    """Whether the file begins as a table does."""
    try:
        return len(read_head(path).names) > 1
    except DataError:
        return False


def batches(path: Path, head: Head, told: Callable[[int], None], caveat: Callable[[str], None]) -> Iterator[Batch]:
    """The rows of the table, about a megabyte at a time.

    Parameters
    ----------
    path, head : Path, Head
        The file, and how it begins.
    told : callable
        Told how many bytes have been read.
    caveat : callable
        Told what is wrong with the end of the file.

    Raises
    ------
    DataError
        When a row does not have the header's columns, or is no text, naming it.
    """
    bad: list[str] = []

    def judge(row: Any) -> str:
        if not row.text.lstrip().startswith("#"):
            columns = f"{row.actual_columns} columns instead of {row.expected_columns}"
            bad.append(f"line {row.number} has {columns}: {row.text[:60]!r}")
        return "skip" if not bad else "error"

    with path.open("rb") as opened:
        end = _whole_end(opened)
        if end < opened.seek(0, io.SEEK_END):
            caveat(f"{path.name}: its last line is cut off; left out")
        opened.seek(0)
        source = _Part(opened, end, told)
        count = 0
        try:
            reader = pa.csv.open_csv(
                source,
                pa.csv.ReadOptions(
                    use_threads=False, block_size=BLOCK, skip_rows=head.lines, column_names=list(head.names)
                ),
                pa.csv.ParseOptions(delimiter=head.separator, invalid_row_handler=judge),
                pa.csv.ConvertOptions(column_types=dict.fromkeys(head.names, pa.string()), strings_can_be_null=False),
            )
            for batch in reader:
                yield Batch(path, head, batch, count)
                count += batch.num_rows
        except (pa.ArrowException, ValueError) as error:
            what = f"after row {count}: " + str(error).partition("\n")[0][:200]
            raise DataError(bad[0] if bad else what, where=str(path), remedy="repair or remove the line") from error


class Batch(Mapping[str, NDArray[Any]]):
    """Some rows; each column is converted when it is asked for."""

    def __init__(self, path: Path, head: Head, batch: pa.RecordBatch, before: int) -> None:
        self._path, self._head, self._batch, self._before = path, head, batch, before
        self._done: dict[str, NDArray[Any]] = {}

    @property
    def rows(self) -> int:
        return int(self._batch.num_rows)

    def __len__(self) -> int:
        return len(self._head.names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._head.names)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Numbers as float64, long whole ones as int64; times as datetime64, as timedelta64 where they have no zone."""
        if name not in self._done:
            index = self._head.names.index(name)
            self._done[name] = self._converted(pc.utf8_trim_whitespace(self._batch.column(index)), index)
        return self._done[name]

    def text(self, name: str) -> list[str]:
        """The cells as they are written, without the space around them."""
        cells: list[str] = pc.utf8_trim_whitespace(self._batch.column(self._head.names.index(name))).to_pylist()
        return cells

    def _converted(self, text: pa.Array, index: int) -> NDArray[Any]:
        first = self._head.first[index]
        if _TIME.fullmatch(first):
            return self._times(text, index)
        if _WHOLE.fullmatch(first):
            try:
                return np.asarray(text.cast(pa.int64()).to_numpy(zero_copy_only=False))
            except pa.ArrowException:
                pass
        try:
            return np.asarray(text.cast(pa.float64()).to_numpy(zero_copy_only=False))
        except pa.ArrowException:
            return np.array([self._number(cell, row, index) for row, cell in enumerate(text.to_pylist())])

    def _number(self, cell: str, row: int, index: int) -> float:
        if cell in _NO_VALUE:
            return np.nan
        if cell.lower() in ("true", "false"):
            return float(cell.lower() == "true")
        if _NUMBER.fullmatch(cell):
            return float(cell)
        comma = _DECIMAL_COMMA.fullmatch(cell) is not None
        raise self._fault(
            f"holds {cell[:40]!r}, which is no number",
            row,
            index,
            "export it with decimal points, not commas" if comma else "repair or remove the line",
        )

    def _times(self, text: pa.Array, index: int) -> NDArray[Any]:
        text = pc.replace_substring(text, "/", "-")
        for kind, unit in ((pa.timestamp("ns", "UTC"), "M8[ns]"), (pa.timestamp("ns"), "m8[ns]")):
            try:
                return np.asarray(text.cast(kind).cast(pa.int64()).to_numpy(zero_copy_only=False)).view(unit)
            except pa.ArrowException as error:
                message = str(error).partition("\n")[0][:160]
        raise self._fault(f"or a later one is no time ({message})", 0, index, "write 2022-06-08T09:00:00Z in every row")

    def _fault(self, problem: str, row: int, index: int, remedy: str) -> DataError:
        where = f"{self._path}: {self._head.names[index]}"
        return DataError(f"row {self._before + row + 1} {problem}", where=where, remedy=remedy)


class _Part(io.RawIOBase):
    """A file up to a byte, telling how far it has been read."""

    def __init__(self, opened: io.BufferedReader, end: int, told: Callable[[int], None]) -> None:
        self._opened, self._left, self._end, self._told = opened, end, end, told

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        content = self._opened.read(self._left if size < 0 else min(size, self._left))
        self._left -= len(content)
        self._told(self._end - self._left)
        return content


def _first_lines(path: Path) -> list[str]:
    try:
        with path.open("rb") as opened:
            head = opened.read(MAX_HEAD).rstrip(b"\0")
    except OSError as error:
        raise DataError(
            f"cannot be read ({error.strerror})", where=str(path), remedy="check the name and the permissions"
        ) from error
    if b"\0" in head or head.startswith(b"\x1f\x8b"):
        raise DataError("is no text", where=str(path), remedy="unpack or export it as CSV first")
    # whole lines only, and no half character at the cut
    if len(head) == MAX_HEAD or not head.endswith(b"\n"):
        head = head[: head.rfind(b"\n") + 1]
    try:
        return head.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        line = head.count(b"\n", 0, error.start) + 1
        raise DataError(f"line {line} is not UTF-8 text", where=str(path), remedy="save it as UTF-8") from error


def _header_and_row(lines: Sequence[str], rows: Sequence[int]) -> tuple[int, int]:
    """The lines of header and first row: the header is the line before the numbers, even as a comment."""
    first = rows[0]
    separator = max(SEPARATORS, key=lines[first].count)
    cells = _cells(lines[first], separator)
    if _is_header(cells):
        return first, rows[1] if len(rows) > 1 else len(lines)
    if first > 0 and lines[first - 1].startswith("#") and lines[first - 1].count(separator) == len(cells) - 1:
        return first - 1, first
    return first, first + 1


def _is_header(cells: Sequence[str]) -> bool:
    return not any(_NUMBER.fullmatch(cell) or _TIME.fullmatch(cell) for cell in cells)


def _check(path: Path, names: tuple[str, ...], first: tuple[str, ...], separator: str, header: int) -> None:
    where = str(path)
    if not _is_header(names):
        raise DataError(f"line {header + 1} holds numbers, not column names", where=where, remedy="add a header line")
    if len(names) > MAX_COLUMNS:
        raise DataError(f"has {len(names)} columns", where=where, remedy=f"at most {MAX_COLUMNS} are read")
    double = next((name for name in names if names.count(name) > 1), None)
    if double is not None:
        raise DataError(f"column {double!r} appears twice", where=where, remedy="rename one of them")
    if first and len(first) != len(names):
        comma = separator == "," and len(first) == 2 * len(names)
        raise DataError(
            f"the first row has {len(first)} columns instead of {len(names)}",
            where=where,
            remedy="decimal commas? export it with decimal points" if comma else "repair the file, or export it again",
        )
    if separator != "," and any(_DECIMAL_COMMA.fullmatch(cell) for cell in first):
        raise DataError("has decimal commas", where=where, remedy="export it with decimal points")


def _cells(line: str, separator: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:
        return line.split(separator)


def _whole_end(opened: io.BufferedReader) -> int:
    """Where the last whole line ends: a logger that lost power leaves half a line, or zeros."""
    size = opened.seek(0, io.SEEK_END)
    start = opened.seek(max(0, size - BLOCK))
    tail = opened.read().rstrip(b"\0")
    return start + tail.rfind(b"\n") + 1
