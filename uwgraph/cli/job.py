"""Smooth, judge, write: the one job behind ``smooth`` and ``demo``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from uwgraph.cli.console import Progress

if TYPE_CHECKING:
    from uwgraph.dive import Dive
    from uwgraph.evaluate import Alignment
    from uwgraph.graph import SmoothSettings


def smooth_and_write(
    dive: Dive,
    settings: SmoothSettings,
    out: Path,
    *,
    progress: Progress,
    alignment: Alignment = "none",
    plot: bool = False,
    overwrite: bool = False,
    title: str = "",
) -> dict[str, Any]:
    """Write the output folder of a dive and return its metrics."""
    from uwgraph.evaluate import judge, write_solution
    from uwgraph.evaluate.output import refuse_taken
    from uwgraph.evaluate.runlog import run_log
    from uwgraph.graph import smooth

    refuse_taken(out, overwrite=overwrite)
    solution = smooth(dive, settings, progress)
    progress("writing", 0.95)
    judged = judge(dive, solution, alignment)

    def picture(folder: Path) -> None:
        from uwgraph.evaluate.plot import track_plot

        track_plot(judged.solution, judged.reference, folder / "track.png", title)

    config = {"smooth": settings.model_dump(mode="json"), "rig": dive.rig.model_dump(mode="json")}
    write_solution(
        solution,
        out,
        judged.metrics,
        config,
        run_log(dive, solution),
        overwrite=overwrite,
        extras=picture if plot else None,
    )
    progress("done", 1.0)
    return judged.metrics
