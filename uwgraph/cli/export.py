"""``uwgraph export``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from uwgraph.cli.console import note, progress_bar
from uwgraph.errors import ConfigError, DataError

if TYPE_CHECKING:
    from uwgraph.export import Source

EXAMPLES = """Examples:

[bold]uwgraph export out/run1 -o run1.kml[/bold]

[bold]uwgraph export out/run1 -o run1.txt --format tum --frame enu[/bold]

[bold]uwgraph export dives/run1 -o run1.mcap[/bold]

[bold]uwgraph export dives/run1 -o usbl.geojson --stream fixes[/bold]"""

Stream = Literal["reference", "fixes"]


def export(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="A result of smooth, a dive folder, or a recording.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The file to make.")],
    file_format: Annotated[
        Literal["tum", "kitti", "euroc", "mcap", "geojson", "kml", "csv"] | None,
        typer.Option("--format", help="Guessed from the suffix of FILE if not given."),
    ] = None,
    frame: Annotated[
        Literal["ned", "enu", "euroc"] | None,
        typer.Option(
            help="World and body axes: NED and FRD, ENU and FLU (ROS), or EuRoC's. "
            "Default: ned for tum and kitti, enu for mcap, euroc for euroc."
        ),
    ] = None,
    stream: Annotated[
        Stream | None, typer.Option(help="Of a dive: its reference (default) or its fixes. MCAP takes the whole dive.")
    ] = None,
    rate_hz: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", min=1e-6, help="At most so many poses a second; none is interpolated."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is already there.")] = False,
) -> None:
    """Write a result, or a dive, in a format that others read: for evo, Foxglove, GIS and Google Earth."""
    from uwgraph.export import export as write
    from uwgraph.export import guess_format
    from uwgraph.export.formats import refuse_taken

    name = file_format or guess_format(out)
    refuse_taken(out, name, overwrite=force)
    content = _source(source, stream, whole=name == "mcap")
    with progress_bar() as progress:
        made = write(
            content,
            out,
            name,
            frame=frame,
            rate_hz=rate_hz,
            overwrite=force,
            progress=lambda share: progress("writing", share),
        )
    what = "messages" if name == "mcap" else "points"
    left = f"; {made.left_out} without a known pose left out" if made.left_out else ""
    note(f"{', '.join(made.files)}: {name}, {made.count} {what}, {made.frame}{left}")


def _source(path: Path, stream: Stream | None, *, whole: bool) -> Source:
    from uwgraph.cli.source import load_dive
    from uwgraph.dive.folder import HEADER
    from uwgraph.export import Source as Exportable
    from uwgraph.export import is_result, read_result, source_of_dive

    title = path.resolve().name
    if is_result(path) and not (path / HEADER).exists():
        if stream is not None:
            raise ConfigError("a result has no streams", where="--stream", remedy="name the dive folder instead")
        return Exportable(title, track=read_result(path))
    if whole and stream is not None:
        raise ConfigError("an MCAP file takes the whole dive", where="--stream", remedy="leave it out")
    _refuse_unknown(path)
    return source_of_dive(load_dive(path), title, None if whole else stream or "reference")


def _refuse_unknown(path: Path) -> None:
    """A folder that is nothing known could have been meant as a result, too."""
    from uwgraph.dive.readers import guess_reader

    try:
        guess_reader(path)
    except DataError as error:
        remedy = f"name a folder that 'uwgraph smooth' wrote, or {error.remedy}"
        raise DataError(error.problem, where=error.where, remedy=remedy) from error
