"""Tables: a CSV file, or a folder of them, each a topic whose fields are its columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from uwgraph.dive.logs.fields import resolve
from uwgraph.dive.logs.log import Known, Progress, Proposal, Sink, Topic
from uwgraph.dive.logs.quantity import quantity
from uwgraph.dive.logs.sinks import whole_ns
from uwgraph.dive.readers.csv_columns import Table, proposals_of, stated_unit, time_of
from uwgraph.dive.readers.csv_text import Batch, Head, batches, looks_like_table, read_head
from uwgraph.errors import DataError
from uwgraph.time import from_datetime
from uwgraph.types import TimeArray

NAME: Final = "csv"
EXPECTS: Final = "a CSV file with a header line, or a folder of them, one per sensor"
CLOCKS_DIFFER: Final = False

SUFFIXES: Final = (".csv", ".tsv")
OTHER_SUFFIXES: Final = (".txt", ".dat", ".log")
"""Taken when the file itself is named and begins as a table does."""
MAX_FILES: Final = 256
"""Tables in one folder."""


def matches(path: Path) -> str:
    if path.is_dir():
        count = len(_tables(path))
        return f"it holds {count} table{'s' if count > 1 else ''}" if count else ""
    if path.suffix.lower() in SUFFIXES:
        return f"its name ends in {path.suffix}"
    return "it begins as a table does" if path.suffix.lower() in OTHER_SUFFIXES and looks_like_table(path) else ""


@contextmanager
def open_log(path: Path) -> Iterator[CsvLog]:
    files = _tables(path) if path.is_dir() else [path]
    if not files or len(files) > MAX_FILES:
        raise DataError(f"holds {len(files)} tables", where=str(path), remedy=f"name {EXPECTS}, at most {MAX_FILES}")
    heads = {file: read_head(file) for file in files}
    yield CsvLog(heads, tuple(_topic(file, head) for file, head in heads.items()))


def proposals(topic: Topic) -> tuple[Proposal, ...]:
    return proposals_of(topic) if isinstance(topic, Table) else ()


@dataclass(frozen=True)
class CsvLog:
    """The tables of a recording."""

    heads: Mapping[Path, Head]
    topics: tuple[Table, ...]
    known: Known = field(default_factory=Known)
    found: list[str] = field(default_factory=list)

    @property
    def caveats(self) -> tuple[str, ...]:
        return tuple(self.found)

    def pour(self, sinks: Mapping[str, tuple[Sink, ...]], progress: Progress) -> None:
        files = [(file, topic) for file, topic in zip(self.heads, self.topics, strict=True) if topic.name in sinks]
        sizes = [file.stat().st_size for file, _ in files]
        for (file, topic), before in zip(files, np.cumsum([0, *sizes[:-1]]), strict=True):
            for batch in batches(
                file,
                self.heads[file],
                lambda done, before=before: progress(min(1.0, (before + done) / max(sum(sizes), 1))),  # type: ignore[misc]
                self.found.append,
            ):
                t_ns = _stamps(batch, topic)
                for sink in sinks[topic.name]:
                    sink.extend(t_ns, batch)


def _tables(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())


def _topic(file: Path, head: Head) -> Table:
    time, epoch, relative = time_of(head.names, head.first)
    units = {name: unit for name in head.names if (unit := stated_unit(name))}
    return Table(file.name, "table", fields=head.names, units=units, time=time, epoch=epoch, relative=relative)


def _stamps(batch: Batch, table: Table) -> TimeArray:
    """The stamps by the column that looks like time, for mappings that name none; zeros without one."""
    if not table.time:
        return np.zeros(batch.rows, dtype=np.int64)
    found = quantity(table.time, "time")
    name = resolve(found, table, f"{table.name}: time")
    epoch_ns = from_datetime(table.epoch) if table.epoch else 0
    return whole_ns(batch[name], round(found.scale * 1e9)) + epoch_ns
