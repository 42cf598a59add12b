"""What every benchmark shares: its command line, its table, its JSON, and two processes at most.

Import it before NumPy: children and BLAS then keep to one thread each, so that times can be compared.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import platform
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import track
from rich.table import Table

RESULTS = Path(__file__).parent / "results"
PROCESSES = 2

T = TypeVar("T")
Row = dict[str, Any]


@dataclass(frozen=True)
class Figure:
    """A number that is held against a limit."""

    name: str
    value: float
    limit: float
    at_least: bool = False
    """Whether the limit is a lower one."""

    @property
    def met(self) -> bool:
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def row(self) -> Row:
        return {
            "figure": self.name,
            "value": self.value,
            "limit": f"{'>=' if self.at_least else '<='} {self.limit:g}",
            "": "met" if self.met else "MISSED",
        }


def parser(doc: str | None) -> argparse.ArgumentParser:
    """A parser with the options that all benchmarks have; ``doc`` is the module's docstring."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--json", action="store_true", help="print JSON instead of tables")
    made.add_argument("--save", action="store_true", help="also write benchmarks/results/NAME.json")
    return made


def finish(
    args: argparse.Namespace,
    name: str,
    tables: Mapping[str, Sequence[Row]],
    figures: Sequence[Figure] = (),
    details: Mapping[str, Any] | None = None,
) -> None:
    """Print the tables and figures (or JSON), and save them where asked."""
    report = {
        "benchmark": name,
        "command": " ".join(["benchmarks/" + Path(sys.argv[0]).name, *sys.argv[1:]]),
        "machine": machine(),
        "figures": [asdict(f) | {"met": f.met} for f in figures],
        **{title: list(rows) for title, rows in tables.items()},
        **(details or {}),
    }
    if args.json:
        print(json.dumps(report, indent=1))
    else:
        for title, rows in tables.items():
            show(title, rows)
        if figures:
            show(name, [f.row() for f in figures])
    if args.save:
        RESULTS.mkdir(exist_ok=True)
        (RESULTS / f"{name}.json").write_text(json.dumps(report, indent=1) + "\n")


def show(title: str, rows: Sequence[Row]) -> None:
    """A table of rows with the same keys."""
    table = Table(title=title, title_justify="left")
    for column in rows[0]:
        table.add_column(column, justify="right" if isinstance(rows[0][column], int | float) else "left")
    for row in rows:
        table.add_row(*(f"{v:.4g}" if isinstance(v, float) else escape(str(v)) for v in row.values()))
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def machine() -> dict[str, Any]:
    """Where and with what the figures were made."""
    return {
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "platform": platform.platform(terse=True),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **{package: version(package) for package in ("uwgraph", "gtsam", "numpy")},
    }


def in_processes(job: Callable[..., T], tasks: Iterable[tuple[Any, ...]]) -> list[T]:
    """``job(*task)`` of every task, in two fresh processes, in the order of the tasks; progress where people watch."""
    tasks = list(tasks)
    with ProcessPoolExecutor(min(PROCESSES, len(tasks)), mp_context=get_context("spawn")) as pool:
        done = pool.map(job, *zip(*tasks, strict=True))
        return list(track(done, "", len(tasks), console=Console(stderr=True), transient=True))


@dataclass(frozen=True)
class Timing:
    """Seconds of repeated runs."""

    median: float
    least: float
    most: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Timing:
        return cls(statistics.median(seconds), min(seconds), max(seconds))


def timed(job: Callable[[], T]) -> tuple[float, T]:
    """Wall seconds and the result."""
    start = time.perf_counter()
    result = job()
    return time.perf_counter() - start, result


def runs_of(data: Path, numbers: Sequence[int] | None) -> list[Path]:
    """The folders ``TrajectoryN`` of a recording campaign, all of them where no numbers are given."""
    if numbers:
        folders = [data / f"Trajectory{n}" for n in numbers]
    else:
        folders = sorted(data.glob("Trajectory*"), key=lambda f: (len(f.name), f.name))
    missing = [f for f in folders if not f.is_dir()]
    if missing or not folders:
        sys.exit(f"error: {missing[0] if missing else data / 'Trajectory*'} is not there")
    return folders
