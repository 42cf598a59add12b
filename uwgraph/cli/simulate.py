"""``uwgraph simulate``."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from uwgraph.cli.console import note, progress_bar
from uwgraph.errors import ConfigError

if TYPE_CHECKING:
    from uwgraph.dive import Dive

EXAMPLES = """Examples:

[bold]uwgraph simulate dives/lawn[/bold]

[bold]uwgraph simulate dives/far --pattern transit --duration 7200 --grade fog --seed 3[/bold]

[bold]uwgraph simulate dives/aided --on dives/run1 --grade mems --add sun-heading[/bold]

[bold]uwgraph simulate dives/v102 --on logs/euroc --add dvl --add depth[/bold]"""


class Added(StrEnum):
    """Streams that can be added to a real dive."""

    dvl = "dvl"
    depth = "depth"
    fixes = "fixes"
    sun = "sun"
    sun_heading = "sun-heading"


def simulate(
    dest: Annotated[Path, typer.Argument(metavar="DEST", help="The dive folder to make.")],
    pattern: Annotated[Literal["lawnmower", "helix", "transit"] | None, typer.Option(help="The mission.")] = None,
    duration_s: Annotated[float | None, typer.Option("--duration", metavar="S", help="How long, seconds.")] = None,
    depth: Annotated[float | None, typer.Option(metavar="M", help="Working depth, metres.")] = None,
    speed: Annotated[float | None, typer.Option(metavar="M/S", help="Speed through the water, m/s.")] = None,
    grade: Annotated[Literal["fog", "mems", "noise_free"] | None, typer.Option(help="Quality of the IMU.")] = None,
    no_sun: Annotated[bool, typer.Option("--no-sun", help="Carry no sun sensor.")] = False,
    on: Annotated[
        Path | None,
        typer.Option(metavar="DIVE", help="A real dive to work on: --grade degrades its IMU, --add adds streams."),
    ] = None,
    add: Annotated[
        list[Added] | None, typer.Option(help="With --on: a stream derived from the dive's reference; repeatable.")
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same dive.")] = 0,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file of settings; options above win over it.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a dive folder that is already there.")] = False,
) -> None:
    """Make a dive: a truth on the ellipsoid and its sensors' logs, or a real dive with simulated sensors added."""
    asked = {"pattern": pattern, "duration_s": duration_s, "depth": depth, "speed": speed, "grade": grade}
    with progress_bar() as progress:
        progress("simulating", 0.1)
        if on is None:
            if add:
                raise ConfigError("--add needs a dive to add to", where="--add", remedy="name it with --on DIVE")
            dive = _made(asked, settings, no_sun, seed)
        else:
            if (
                settings is not None
                or no_sun
                or any(value is not None for name, value in asked.items() if name != "grade")
            ):
                raise ConfigError("of a mission's options only --grade goes with --on", where="--on")
            dive = _added(on, grade, add or [], seed)
        progress("writing", 0.9)
        _write(dive, dest, on, force)
    note(f"{dest}: " + ", ".join(f"{name} {len(stream)}" for name, stream in dive.streams()))


def _made(asked: dict[str, Any], settings: Path | None, no_sun: bool, seed: int) -> Dive:
    from uwgraph.cli.options import settings_from
    from uwgraph.simulate import SimulationSettings
    from uwgraph.simulate import simulate as simulate_dive

    wanted = settings_from(SimulationSettings, settings, asked)
    return simulate_dive(wanted.model_copy(update={"sun": None}) if no_sun else wanted, seed)


def _added(source: Path, grade: Literal["fog", "mems", "noise_free"] | None, add: list[Added], seed: int) -> Dive:
    from uwgraph import simulate as room
    from uwgraph.cli.source import load_dive

    dive = load_dive(source)
    if grade is not None:
        dive = room.degrade_imu(dive, grade, seed)
    adders: dict[Added, Callable[[Dive], Dive]] = {
        Added.dvl: lambda d: room.add_dvl(d, seed=seed),
        Added.depth: lambda d: room.add_depth(d, seed=seed),
        Added.fixes: lambda d: room.add_fixes(d, seed=seed),
        Added.sun: lambda d: room.add_sun(d, seed=seed),
        Added.sun_heading: lambda d: room.add_sun_heading(d, seed=seed),
    }
    for name in add:
        dive = adders[name](dive)
    return dive


def _write(dive: Dive, dest: Path, source: Path | None, force: bool) -> None:
    from uwgraph.dive.folder import write_dive

    write_dive(dive, dest, images_from=source if dive.images else None, overwrite=force)
