"""``uwgraph import``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uwgraph.cli.console import print_json, print_table

if TYPE_CHECKING:
    from uwgraph.dive.importing import ImportReport

EXAMPLES = "Example: [bold]uwgraph import logs/Trajectory1 dives/run1[/bold]"


def import_(
    src: Annotated[Path, typer.Argument(metavar="SRC", help="The recording: a folder as the logger left it.")],
    dest: Annotated[Path, typer.Argument(metavar="DEST", help="The dive folder to make.")],
    log_format: Annotated[
        str | None, typer.Option("--format", help="Name of the format; guessed, and told, if not given.")
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Write the streams as CSV instead of Parquet.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="JSON on standard output, for programs.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a dive folder that is already there.")] = False,
) -> None:
    """Turn a recording into a dive folder, and say what was guessed and converted."""
    from dataclasses import asdict

    from uwgraph.dive.importing import import_dive
    from uwgraph.evaluate.runlog import plain

    report = import_dive(src, dest, log_format, table_format="csv" if csv else "parquet", overwrite=force)
    if as_json:
        print_json(plain(asdict(report)))
    else:
        _print(report)


def _print(report: ImportReport) -> None:
    print(f"{report.source}: read as {report.format}: {report.reason}")
    rows = [(s.name, str(s.count), f"{s.rate_hz:.6g}", f"{s.span_s:.3f}", s.start) for s in report.streams]
    print_table(report.destination, ("stream", "samples", "rate [Hz]", "span [s]", "from"), rows)
    for heading, notes in (("conversions", report.conversions), ("caveats", report.caveats)):
        if notes:
            print(f"{heading}:")
            print("\n".join(f"  - {line}" for line in notes))
