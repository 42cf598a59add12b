"""``uwgraph demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uwgraph.cli.console import note, print_metrics, progress_bar

EXAMPLES = "Example: [bold]uwgraph demo -o demo-output[/bold], then open demo-output/result/track.png"


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", metavar="OUT", help="Folder for the dive and the result.")] = Path(
        "demo-output"
    ),
    seed: Annotated[int, typer.Option(help="Another seed, another dive.")] = 0,
) -> None:
    """Simulate a 20-minute dive with a MEMS IMU and a sun sensor, smooth it, and draw the track.

    Run again, it replaces the dive and the result of the last time.
    """
    from uwgraph.cli.job import smooth_and_write
    from uwgraph.dive.folder import read_dive, write_dive
    from uwgraph.graph import SmoothSettings
    from uwgraph.simulate import simulate

    dive_folder, result = out / "dive", out / "result"
    with progress_bar() as progress:
        progress("simulating", 0.0)
        write_dive(simulate(seed=seed), dive_folder, overwrite=True)
        figures = smooth_and_write(
            read_dive(dive_folder),
            SmoothSettings(),
            result,
            progress=progress,
            plot=True,
            overwrite=True,
            title="simulated 20-minute dive",
        )
    print_metrics(figures, "simulated dive against its truth")
    note(f"dive:   {dive_folder}\nresult: {result}\ntrack:  {result / 'track.png'}")
