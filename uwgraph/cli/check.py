"""``uwgraph check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLES = "Example: [bold]uwgraph check dives/run1[/bold]. The exit code is 3 when there are errors."


def check(
    dive: Annotated[Path, typer.Argument(metavar="DIVE", help="A dive folder, or a recording that import knows.")],
    as_json: Annotated[bool, typer.Option("--json", help="JSON on standard output, for programs.")] = False,
) -> None:
    """Look for what is wrong with a dive: clocks, gaps, frames, units, noise."""
    from rich.console import Console

    from uwgraph.cli.source import load_dive
    from uwgraph.dive.check import check_dive
    from uwgraph.dive.check_table import render

    report = check_dive(load_dive(dive, validate=False))
    if as_json:
        print(report.to_json())
    else:
        Console().print(render(report))
    if report.exit_status:
        raise typer.Exit(report.exit_status)
