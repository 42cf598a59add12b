"""``uwgraph smooth``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from uwgraph.cli.console import note, print_json, print_metrics, progress_bar

EXAMPLES = """Examples:

[bold]uwgraph smooth dives/run1 -o out/run1 --plot[/bold]

[bold]uwgraph smooth logs/Trajectory1 -o out/run1 --initial reference --json[/bold]

[bold]uwgraph smooth dives/run1 -o out/run1 --heading-deg 124 --settings mine.yaml --force[/bold]"""


def smooth(
    dive: Annotated[Path, typer.Argument(metavar="DIVE", help="A dive folder, or a recording that import knows.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="OUT", help="Folder for the results.")],
    heading_deg: Annotated[
        float | None, typer.Option(metavar="DEG", help="True heading at the start, where nothing aboard tells it.")
    ] = None,
    initial: Annotated[
        Literal["auto", "reference"] | None,
        typer.Option(help="First state from the sensors, or from the reference's first second."),
    ] = None,
    keyframe_period_s: Annotated[
        float | None, typer.Option("--keyframe-period", metavar="S", help="Longest time between keyframes, seconds.")
    ] = None,
    time_limit_s: Annotated[
        float | None, typer.Option("--time-limit", metavar="S", help="Give up after so many seconds.")
    ] = None,
    no_covariances: Annotated[
        bool, typer.Option("--no-covariances", help="Leave out the 1-sigma of the states: faster.")
    ] = False,
    alignment: Annotated[
        Literal["none", "origin", "yaw", "se3"],
        typer.Option("--align", help="Move onto the reference before judging; se3 hides what a heading gives."),
    ] = "none",
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file of settings; options above win over it.")
    ] = None,
    plot: Annotated[bool, typer.Option("--plot", help="Draw track.png too.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Metrics as JSON on standard output.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier result.")] = False,
) -> None:
    """Smooth a dive: trajectory, states with 1-sigma, metrics against the reference where there is one."""
    from uwgraph.cli.job import smooth_and_write
    from uwgraph.cli.options import settings_from
    from uwgraph.cli.source import load_dive
    from uwgraph.dive.checks.presence import missing_in_words
    from uwgraph.evaluate.output import refuse_taken
    from uwgraph.graph import SmoothSettings

    asked = {
        "heading_deg": heading_deg,
        "initial": initial,
        "keyframe_period_s": keyframe_period_s,
        "time_limit_s": time_limit_s,
        "covariances": False if no_covariances else None,
    }
    wanted = settings_from(SmoothSettings, settings, asked)
    refuse_taken(out, overwrite=force)
    loaded = load_dive(dive)
    for line in missing_in_words(loaded):
        note(line)
    with progress_bar() as progress:
        figures = smooth_and_write(
            loaded,
            wanted,
            out,
            progress=progress,
            alignment=alignment,
            plot=plot,
            overwrite=force,
            title=dive.name,
        )
    if as_json:
        print_json(figures | {"output": str(out)})
    else:
        print_metrics(figures, str(dive))
        _tell_closures(figures)
        _tell_sigma(figures)
        note(f"results in {out}")


def _tell_closures(figures: Mapping[str, Any]) -> None:
    """How many places seen again the solution rests on."""
    if "closures_accepted" in figures:
        accepted, rejected = figures["closures_accepted"], figures["closures_rejected"]
        note(f"closures: {accepted} accepted, {rejected} rejected; closures.parquet says why")


def _tell_sigma(figures: Mapping[str, Any]) -> None:
    """How sure the solution is of its last state."""
    final = {name: sigma["final"] for name, sigma in figures.get("sigma", {}).items() if sigma["final"] is not None}
    if final:
        words = (f"{name.rpartition('_')[0]} {value:.3g} {name.rpartition('_')[2]}" for name, value in final.items())
        note(f"1-sigma at the end: {', '.join(words)}")
