"""``uwgraph simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from uwgraph.cli.console import note, progress_bar

EXAMPLES = """Examples:

[bold]uwgraph simulate dives/lawn[/bold]

[bold]uwgraph simulate dives/far --pattern transit --duration 7200 --grade fog --seed 3[/bold]"""


def simulate(
    dest: Annotated[Path, typer.Argument(metavar="DEST", help="The dive folder to make.")],
    pattern: Annotated[Literal["lawnmower", "helix", "transit"] | None, typer.Option(help="The mission.")] = None,
    duration_s: Annotated[float | None, typer.Option("--duration", metavar="S", help="How long, seconds.")] = None,
    depth: Annotated[float | None, typer.Option(metavar="M", help="Working depth, metres.")] = None,
    speed: Annotated[float | None, typer.Option(metavar="M/S", help="Speed through the water, m/s.")] = None,
    grade: Annotated[Literal["fog", "mems", "noise_free"] | None, typer.Option(help="Quality of the IMU.")] = None,
    no_sun: Annotated[bool, typer.Option("--no-sun", help="Carry no sun sensor.")] = False,
    seed: Annotated[int, typer.Option(help="The same seed gives the same dive.")] = 0,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file of settings; options above win over it.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a dive folder that is already there.")] = False,
) -> None:
    """Make a dive: a truth on the ellipsoid, and what the vehicle's sensors would have logged."""
    from uwgraph.cli.options import settings_from
    from uwgraph.dive.folder import write_dive
    from uwgraph.simulate import SimulationSettings
    from uwgraph.simulate import simulate as simulate_dive

    asked = {"pattern": pattern, "duration_s": duration_s, "depth": depth, "speed": speed, "grade": grade}
    wanted = settings_from(SimulationSettings, settings, asked)
    if no_sun:
        wanted = wanted.model_copy(update={"sun": None})
    with progress_bar() as progress:
        progress("simulating", 0.1)
        dive = simulate_dive(wanted, seed)
        progress("writing", 0.9)
        write_dive(dive, dest, overwrite=force)
    note(f"{dest}: " + ", ".join(f"{name} {len(stream)}" for name, stream in dive.streams()))
