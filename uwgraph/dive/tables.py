"""Tables on disk, CSV or Parquet, read into one array per column; every fault named by file, line and column."""

from __future__ import annotations

import difflib
import io
import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from uwgraph.errors import DataError

Kind = Literal["int", "float", "bool", "text"]
Table = dict[str, NDArray[Any]]

MAX_BYTES: Final = 2 << 30
"""Larger tables are refused: they are read into memory whole."""
BLOCK_ROWS: Final = 1 << 16
"""Rows that are copied, encoded and written at a time."""

_ARROW: Final = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_(), "text": pa.string()}
_NUMPY: Final[dict[Kind, Any]] = {"int": np.int64, "float": np.float64, "bool": np.bool_, "text": np.str_}
_WORDS: Final = {"int": "a whole number", "float": "a number", "bool": "true or false", "text": "text"}


@dataclass(frozen=True)
class Column:
    """A column that a table may or must have."""

    kind: Kind = "float"
    required: bool = True


def read_table(path: Path, columns: Mapping[str, Column], *, ignore_others: bool = False) -> Table:
    """Read the named columns of a ``.parquet`` file or of a comma-separated text file with one header line.

    Parameters
    ----------
    path : Path
        The file; at most :data:`MAX_BYTES`.
    columns : mapping
        What may be in it. Their order in the file is free; an empty number is NaN.
    ignore_others : bool
        Skip columns that are not named instead of refusing them.

    Returns
    -------
    dict
        One array per column found, all of the same length, at least 1. Whole numbers never pass through float64.

    Raises
    ------
    DataError
        When the file is missing, empty, cut off, too large or malformed, naming the line and column.
    """
    _check_file(path)
    read = _read_parquet if path.suffix == ".parquet" else _read_csv
    table = read(path, columns, ignore_others)
    if table.num_rows == 0:
        raise DataError("has a header but no samples", where=str(path), remedy="export it again, or leave it out")
    return {name: _array(path, name, table.column(name), columns[name].kind) for name in table.column_names}


def write_table(path: Path, table: Table) -> None:
    """Write columns as ``.parquet`` (checksummed pages) or ``.csv`` (shortest digits that read back exactly)."""
    rows = max((len(array) for array in table.values()), default=0)
    blocks = (
        pa.table({name: pa.array(array[start : start + BLOCK_ROWS]) for name, array in table.items()})
        for start in range(0, max(rows, 1), BLOCK_ROWS)
    )
    first = next(blocks)
    with _writer(path, first.schema) as writer:
        for block in itertools.chain([first], blocks):
            writer.write_table(block)


def _writer(path: Path, schema: Any) -> Any:
    """Numbers hardly repeat: a dictionary of them takes more memory and time than it saves."""
    if path.suffix != ".parquet":
        options = pa.csv.WriteOptions(quoting_style="needed", quoting_header="none")
        return pa.csv.CSVWriter(path, schema, write_options=options)
    text = [field.name for field in schema if pa.types.is_string(field.type)]
    return pa.parquet.ParquetWriter(path, schema, compression="zstd", write_page_checksum=True, use_dictionary=text)


def _check_file(path: Path) -> None:
    try:
        size = path.stat().st_size
        with path.open("rb"):
            pass
    except OSError as error:
        raise DataError(
            f"cannot be read ({error.strerror})", where=str(path), remedy="check the name and the permissions"
        ) from error
    if size == 0:
        raise DataError("the file is empty", where=str(path), remedy="copy or export it again")
    if size > MAX_BYTES:
        raise DataError(
            f"the file has {size / 1e9:.1f} GB, more than the limit of {MAX_BYTES / 1e9:.1f} GB",
            where=str(path),
            remedy="cut the recording into dives",
        )


def _wanted(path: Path, found: list[str], columns: Mapping[str, Column], ignore_others: bool) -> list[str]:
    """The columns to read of those found; unknown, doubled and missing ones are errors."""
    unknown = [name for name in found if name not in columns]
    if unknown and not ignore_others:
        near = difflib.get_close_matches(unknown[0], columns, n=1)
        raise DataError(
            f"unknown column {unknown[0]!r}",
            where=str(path),
            remedy=(f"did you mean {near[0]!r}? " if near else "") + f"known columns: {', '.join(columns)}",
        )
    wanted = [name for name in found if name in columns]
    if len(set(wanted)) < len(wanted):
        double = next(name for name in wanted if wanted.count(name) > 1)
        raise DataError(f"column {double!r} appears twice", where=str(path), remedy="remove or rename one of them")
    missing = [name for name, column in columns.items() if column.required and name not in wanted]
    if missing:
        raise DataError(
            f"column {missing[0]!r} is missing",
            where=str(path),
            remedy=f"the file needs {', '.join(name for name, c in columns.items() if c.required)}",
        )
    return wanted


def _array(path: Path, name: str, column: pa.ChunkedArray, kind: Kind) -> NDArray[Any]:
    if column.null_count and kind != "float":
        row = int(np.flatnonzero(column.is_null().to_numpy())[0]) + 1
        raise DataError(f"row {row} is empty", where=f"{path}: {name}", remedy="fill the cell or remove the row")
    array: NDArray[Any] = column.to_numpy().astype(_NUMPY[kind])
    return array


def _read_parquet(path: Path, columns: Mapping[str, Column], ignore_others: bool) -> pa.Table:
    try:
        with pa.parquet.ParquetFile(path, page_checksum_verification=True) as file:
            wanted = _wanted(path, file.schema_arrow.names, columns, ignore_others)
            table = file.read(columns=wanted)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(
            f"is not a whole Parquet file ({_first_line(error)})", where=str(path), remedy="copy or export it again"
        ) from error
    return pa.table({name: _cast(path, name, table.column(name), columns[name].kind) for name in wanted})


def _cast(path: Path, name: str, column: pa.ChunkedArray, kind: Kind) -> pa.ChunkedArray:
    """The column in the wanted type, where no digit is lost by it."""
    is_number = pa.types.is_integer(column.type) or (pa.types.is_floating(column.type) and kind == "float")
    fits = {
        "int": is_number,
        "float": is_number,
        "bool": pa.types.is_boolean(column.type),
        "text": pa.types.is_string(column.type) or pa.types.is_large_string(column.type),
    }[kind]
    if not fits:
        raise DataError(
            f"holds {column.type}, but {_WORDS[kind]} ({_ARROW[kind]}) is needed",
            where=f"{path}: {name}",
            remedy="convert the column before writing the file",
        )
    try:
        return column.cast(_ARROW[kind], safe=kind != "float")
    except pa.ArrowException as error:
        raise DataError(_first_line(error), where=f"{path}: {name}", remedy=f"store it as {_ARROW[kind]}") from error


def _read_csv(path: Path, columns: Mapping[str, Column], ignore_others: bool) -> pa.Table:
    text = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    _check_text(path, text)
    header, _, body = text.partition(b"\n")
    names = [name.strip().strip('"') for name in header.decode().split(",")]
    _check_header(path, names)
    wanted = _wanted(path, names, columns, ignore_others)
    if not body.strip():
        return pa.table({name: pa.array([], _ARROW[columns[name].kind]) for name in wanted})
    try:
        return pa.csv.read_csv(
            io.BytesIO(body.rstrip() + b"\n"),
            # one thread, so that faults come with their row number
            read_options=pa.csv.ReadOptions(use_threads=False, column_names=names),
            parse_options=pa.csv.ParseOptions(ignore_empty_lines=False),
            convert_options=pa.csv.ConvertOptions(
                include_columns=wanted,
                column_types={name: _ARROW[columns[name].kind] for name in wanted},
                null_values=["", "nan", "NaN", "NAN"],
            ),
        )
    except (pa.ArrowException, ValueError) as error:
        raise _csv_fault(path, names, body, _first_line(error)) from error


def _check_text(path: Path, text: bytes) -> None:
    try:
        text.decode("utf-8")
    except UnicodeDecodeError as error:
        line = text.count(b"\n", 0, error.start) + 1
        raise DataError(
            f"line {line} is not UTF-8 text", where=str(path), remedy="is it a CSV file? save it as UTF-8"
        ) from error
    if b"\0" in text:
        line = text.count(b"\n", 0, text.index(b"\0")) + 1
        raise DataError(
            f"line {line} holds NUL bytes", where=str(path), remedy="the copy is damaged, or the disk was: copy again"
        )
    if not text.endswith((b"\n", b"\r")):
        line = text.count(b"\n") + 1
        raise DataError(
            f"the file ends in the middle of line {line}",
            where=str(path),
            remedy="copy it again; if the last line is whole, end it with a newline",
        )


def _check_header(path: Path, names: list[str]) -> None:
    if all(re.fullmatch(r"[-+]?[\d.]+([eE][-+]?\d+)?|nan|", name) for name in names):
        raise DataError("line 1 holds numbers, not column names", where=str(path), remedy="add a header line")
    if len(names) == 1 and re.search(r"[;\t ]", names[0]):
        raise DataError(
            "the header has no commas", where=str(path), remedy="separate columns by commas, with decimal points"
        )


def _csv_fault(path: Path, names: list[str], body: bytes, message: str) -> DataError:
    """Arrow's message in our words, with the line of the file."""
    if found := re.search(r"Row #(\d+): Expected (\d+) columns, got (\d+)", message):
        row, expected, got = map(int, found.groups())
        last = body.rstrip().count(b"\n") + 1
        return DataError(
            f"line {row + 1} has {got} columns instead of {expected}",
            where=str(path),
            remedy="the file is cut off: copy it again" if row == last else "repair or remove the line",
        )
    if found := re.search(r"column #(\d+): Row #(\d+): CSV conversion error to \w+: invalid value '(.*)", message):
        name = names[int(found[1])]
        return DataError(
            f"line {int(found[2]) + 1} holds {found[3].rstrip(chr(39))[:40]!r}, which is not of the column's type",
            where=f"{path}: {name}",
            remedy="repair or remove the line",
        )
    return DataError(message, where=str(path), remedy="repair the file, or export it again")


def _first_line(error: BaseException) -> str:
    return str(error).partition("\n")[0][:200]
