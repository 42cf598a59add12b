"""What every command shares: errors in words, exit codes, the progress bar, tables.

Standard output carries the result, standard error everything else.
"""

from __future__ import annotations

import json
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from uwgraph.errors import (
    EXIT_DATA,
    EXIT_INTERNAL,
    EXIT_INTERRUPTED,
    EXIT_SOLVE,
    EXIT_USAGE,
    ConfigError,
    DataError,
    InitialisationError,
    SolveError,
    UwgraphError,
)

_EXIT_CODES: Mapping[type[UwgraphError], int] = {
    ConfigError: EXIT_USAGE,
    DataError: EXIT_DATA,
    InitialisationError: EXIT_SOLVE,
    SolveError: EXIT_SOLVE,
}

Progress = Callable[[str, float], None]
"""Called with what is being done and how much of it is done, 0 to 1."""


@contextmanager
def errors_in_words(debug: bool) -> Iterator[None]:
    """Turn exceptions into a message and an exit code; ``debug`` adds the traceback.

    SIGTERM ends the block as Ctrl-C does, so that half-written output is cleared away.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        yield
    except KeyboardInterrupt:
        _fail("interrupted; nothing was written", EXIT_INTERRUPTED, debug)
    except UwgraphError as error:
        code = next((code for kind, code in _EXIT_CODES.items() if isinstance(error, kind)), EXIT_INTERNAL)
        _fail(str(error), code, debug)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(EXIT_INTERNAL)
    except OSError as error:
        _fail(f"{error.filename or 'the system'}: {error.strerror or error}", EXIT_DATA, debug)
    except Exception as error:
        hint = (
            "" if debug else "\n  remedy: this is a fault of uwgraph; run again as 'uwgraph --debug ...' and report it"
        )
        _fail(f"{type(error).__name__}: {error}{hint}", EXIT_INTERNAL, debug)


def _fail(message: str, code: int, debug: bool) -> NoReturn:
    if debug:
        traceback.print_exc()
    print(f"error: {message}", file=sys.stderr)
    sys.exit(code)


def note(message: str) -> None:
    """Tell people something on the way."""
    print(message, file=sys.stderr)


def refuse_existing(out: Path | None, force: bool) -> None:
    """Do not replace a file without being told to, and say so before long work is begun."""
    if out is not None and out.exists() and not force:
        raise DataError("there is such a file", where=str(out), remedy="choose another name, or --force to replace it")


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar on standard error while the block runs; silent where nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (TextColumn("{task.description:<24}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda doing, share: bar.update(task, description=doing, completed=min(max(share, 0.0), 1.0))


def print_json(value: Any) -> None:
    """The result for programs: one JSON document, and nothing else, on standard output; null for what is not finite."""
    from uwgraph.plain import json_values

    print(json.dumps(json_values(value), indent=2, allow_nan=False))


def print_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table for people on standard output."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=title, title_justify="left", show_header=bool(header))
    for name in header:
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    # a file or a pipe has no width: 80 columns would break the names
    Console(width=None if sys.stdout.isatty() else 120).print(table)


def print_metrics(metrics: Mapping[str, Any], title: str) -> None:
    """The figures of ``metrics.json`` as a table for people."""
    rows = []
    for name, value in metrics.items():
        if value is None or isinstance(value, dict | list):
            continue
        bounds = metrics.get(f"{name}_95")
        band = f"95 %: {bounds[0]:.2f} to {bounds[1]:.2f}" if bounds else ""
        rows.append((name, f"{value:.4g}" if isinstance(value, float) else str(value), band))
    print_table(title, (), rows)
