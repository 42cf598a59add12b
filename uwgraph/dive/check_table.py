"""A check report as a table for people."""

from __future__ import annotations

from rich.table import Table

from uwgraph.dive.check import CheckReport

COLOURS = {"error": "bold red", "warning": "yellow", "info": "cyan", "ok": "green"}


def render(report: CheckReport, *, everything: bool = False) -> Table:
    """One row per finding; what is ok only when ``everything`` is asked for."""
    table = Table("level", "stream", "check", "found", "remedy", title=report.summary)
    for level, *cells in report.rows():
        if everything or level != "ok":
            table.add_row(f"[{COLOURS[level]}]{level}[/]", *cells)
    return table
