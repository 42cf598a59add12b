"""``uwgraph eval``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from uwgraph.cli.console import note, print_json, print_metrics, print_table, refuse_existing
from uwgraph.cli.source import load_dive
from uwgraph.errors import ConfigError, DataError

if TYPE_CHECKING:
    from uwgraph.dive import Dive
    from uwgraph.evaluate.trajectory import Trajectory

EXAMPLES = """Examples:

[bold]uwgraph eval out/run1 dives/run1[/bold]

[bold]uwgraph eval slam.tum reference.tum --align yaw --plot errors.png[/bold]

[bold]uwgraph eval slam.txt gps.csv --trajectory-frame enu --distance 10 --distance 100[/bold]

[bold]uwgraph eval out/run1 dives/run1 --export judged[/bold]"""

TEXT = (".tum", ".txt", ".csv", ".tsv", ".dat", ".log", ".parquet", "")
"""Files of these suffixes are read as trajectories; all else is a recording."""
PICTURES = (".png", ".pdf", ".svg")
DRIFT = (
    ("distance_m", "travelled, m"),
    ("pairs", "pairs"),
    ("translation_rmse_m", "translation, m"),
    ("translation_rmse_percent", "translation, %"),
    ("heading_rmse_deg", "heading, deg"),
    ("rotation_rmse_deg", "rotation, deg"),
)

Frame = Literal["ned", "enu"]


def eval_(
    trajectory: Annotated[
        Path, typer.Argument(metavar="TRAJECTORY", help="A TUM, CSV or Parquet file, or a result of smooth.")
    ],
    reference: Annotated[
        Path, typer.Argument(metavar="REFERENCE", help="The same, or a dive or recording that has a reference.")
    ],
    alignment: Annotated[
        Literal["none", "origin", "yaw", "se3"],
        typer.Option(
            "--align",
            help="Move onto the reference before judging: the first position, a turn about the vertical, or rigidly. "
            "se3 hides exactly what an absolute heading gives.",
        ),
    ] = "none",
    match: Annotated[
        Literal["interpolate", "nearest"],
        typer.Option(help="At the stamps of the sparser one, interpolate the denser, or take its nearest pose."),
    ] = "interpolate",
    max_dt_s: Annotated[
        float | None, typer.Option("--max-dt", metavar="S", min=0.0, help="No pose farther away than so many seconds.")
    ] = None,
    trajectory_frame: Annotated[
        Frame | None,
        typer.Option(help="Axes of x, y, z: NED with FRD, or ENU with FLU (ROS). Default: as stated, or ned."),
    ] = None,
    reference_frame: Annotated[Frame | None, typer.Option(help="The same of the reference.")] = None,
    distances: Annotated[
        list[float] | None,
        typer.Option(
            "--distance",
            metavar="M",
            min=1e-6,
            max=1e9,
            help="Drift (RPE) over so many metres travelled; may be repeated.",
        ),
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the track and the errors.")] = None,
    export: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write both as TUM, as they were judged, which evo_ape judges alike."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Figures as JSON on standard output.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
) -> None:
    """Judge a trajectory by a reference: any two files, matched by time."""
    from uwgraph.atomic import atomic_file, atomic_folder, refuse_taken
    from uwgraph.evaluate.matching import Matching
    from uwgraph.evaluate.verdict import TRAJECTORY, export_verdict, judge_solution, judge_trajectory
    from uwgraph.export import is_result, read_result
    from uwgraph.export.track import solution_of_track

    _refuse_plot(plot, force)
    if export is not None:
        refuse_taken(export, TRAJECTORY if force else None)
    matching = Matching(match, max_dt_s)
    dive = load_dive(reference) if _is_recording(reference) else None
    if dive is not None and dive.imu is not None and is_result(trajectory) and matching == Matching():
        verdict = judge_solution(dive, solution_of_track(read_result(trajectory)), alignment, distances)
    else:
        verdict = judge_trajectory(
            _trajectory(trajectory, trajectory_frame),
            _trajectory(reference, reference_frame) if dive is None else _reference_of(dive, reference),
            alignment,
            matching,
            distances,
        )
    if plot is not None:
        from uwgraph.evaluate.plot import comparison_plot

        with atomic_file(plot) as file:
            comparison_plot(verdict.comparison, file, trajectory.name)
    if export is not None:
        with atomic_folder(export, TRAJECTORY if force else None) as folder:
            export_verdict(verdict, folder)
    if as_json:
        print_json(verdict.figures | {"notes": verdict.notes})
    else:
        print_metrics(verdict.figures, f"{trajectory} against {reference}")
        _print_drift(verdict.figures["rpe"])
    for line in verdict.notes:
        note(line)


def _is_recording(path: Path) -> bool:
    """Whether the path is a dive or a recording, not a trajectory in a file or a result."""
    from uwgraph.export import is_result

    if path.is_dir():
        return not is_result(path)
    return path.exists() and path.suffix.lower() not in TEXT


def _trajectory(path: Path, frame: Frame | None) -> Trajectory:
    from uwgraph.evaluate.trajectory_file import read_trajectory
    from uwgraph.export.result import STATES

    if _is_recording(path):
        return _reference_of(load_dive(path), path)
    return read_trajectory(path / STATES if path.is_dir() else path, frame)


def _reference_of(dive: Dive, path: Path) -> Trajectory:
    from uwgraph.dive.body_reference import body_reference
    from uwgraph.evaluate.trajectory import trajectory_of_places

    reference = body_reference(dive)
    if reference is None:
        raise DataError("the dive has no reference", where=str(path), remedy="name a file with its trajectory")
    return trajectory_of_places(reference, dive.origin)


def _refuse_plot(plot: Path | None, force: bool) -> None:
    """Tell before the work that the picture has no place to go, or no format."""
    if plot is not None and plot.suffix.lower() not in PICTURES:
        raise ConfigError(
            f"pictures are {', '.join(PICTURES)}", where=f"--plot {plot}", remedy="give the file one of these suffixes"
        )
    refuse_existing(plot, force)


def _print_drift(rows: Sequence[Mapping[str, Any]]) -> None:
    """The relative errors over distances, as a table of their own."""
    cells = ([_cell(row[name]) for name, _ in DRIFT] for row in rows)
    if rows:
        print_table("drift (RPE, RMS)", [title for _, title in DRIFT], cells)


def _cell(value: float | int | None) -> str:
    if value is None:
        return ""
    return str(value) if isinstance(value, int) else f"{value:.4g}"
