"""``uwgraph map``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from uwgraph.cli.console import note, print_json, print_metrics, progress_bar
from uwgraph.errors import ConfigError

EXAMPLES = """Examples:

[bold]uwgraph map dives/reef --solution out/reef -o maps/reef[/bold]

[bold]uwgraph map dives/reef --camera down --right down_right --voxel 0.02 -o maps/reef --force[/bold]

[bold]uwgraph map dives/reef --solution out/reef-closed --from maps/reef -o maps/reef-closed[/bold]"""


def map_(
    dive: Annotated[Path, typer.Argument(metavar="DIVE", help="A dive folder with images/CAMERA/camera.yaml.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="MAP", help="Folder for the map.")],
    solution: Annotated[
        Path | None,
        typer.Option(metavar="OUT", help="What 'uwgraph smooth' wrote; without it the dive is smoothed now."),
    ] = None,
    along: Annotated[
        Literal["solution", "reference"],
        typer.Option(help="Map along the solution, or along the dive's reference."),
    ] = "solution",
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="MAP", help="Re-deform this map by the solution instead of measuring anew."),
    ] = None,
    camera: Annotated[
        str | None, typer.Option(metavar="NAME", help="The camera that looks down, if there are several.")
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="NAME", help="The other camera of a stereo pair; found if not named.")
    ] = None,
    voxel_m: Annotated[
        float | None,
        typer.Option("--voxel", metavar="M", help="Cells of the cloud; default: a hundredth of the usual altitude."),
    ] = None,
    pixel_m: Annotated[
        float | None, typer.Option("--pixel", metavar="M", help="Pixels of the picture; default: those of the images.")
    ] = None,
    n: Annotated[
        float | None, typer.Option("--n", metavar="N", help="Refractive index before a flat port: 1 in air.")
    ] = None,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file of settings; options above win over it.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Figures as JSON on standard output.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier map.")] = False,
) -> None:
    """Map the sea floor: a point cloud (PLY), a picture from above, and the graph of places."""
    from uwgraph.camera.eyes import choose_eyes
    from uwgraph.cli.options import settings_from
    from uwgraph.cli.source import load_track
    from uwgraph.dive.folder import read_dive
    from uwgraph.seafloor import MapSettings, deform_map, make_map
    from uwgraph.seafloor.links import closures_of_result

    asked = {"voxel_m": voxel_m, "pixel_m": pixel_m, "n": n}
    wanted = settings_from(MapSettings, settings, asked)
    if source is not None and (settings is not None or camera or right or any(v is not None for v in asked.values())):
        raise ConfigError(
            "a map that is re-deformed keeps its cameras and settings",
            where="--from",
            remedy="leave out --camera, --right, --voxel, --pixel, --n and --settings",
        )
    loaded = read_dive(dive)
    eyes = None if source is not None else choose_eyes(loaded, dive, camera, right)
    title = dive.resolve().name
    with progress_bar() as progress:
        track = load_track(loaded, solution, along, progress)
        ends = None if solution is None else closures_of_result(solution)
        if eyes is None:
            assert source is not None
            figures = deform_map(
                loaded, source, track, out, closures_ns=ends, overwrite=force, title=title, progress=progress
            )
        else:
            figures = make_map(
                loaded, eyes, track, out, wanted, closures_ns=ends, overwrite=force, title=title, progress=progress
            )
    if as_json:
        print_json(figures | {"output": str(out)})
    else:
        print_metrics(figures, str(dive))
        _tell_left_out(figures)
        note(f"map in {out}")


def _tell_left_out(figures: dict[str, Any]) -> None:
    counts = {**figures.get("left_out", {}), **figures.get("refused", {})}
    if counts:
        note("images left out: " + ", ".join(f"{count} {reason}" for reason, count in counts.items()))
