"""``uwgraph compare``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from uwgraph.cli.console import note, print_json, print_table, progress_bar
from uwgraph.errors import EXIT_SOLVE, ConfigError

if TYPE_CHECKING:
    from uwgraph.evaluate.entries import Contest
    from uwgraph.filters import EstimatorSettings

EXAMPLES = """Examples:

[bold]uwgraph compare dives/run1 -o out/compared[/bold]

[bold]uwgraph compare logs/Trajectory1 -o out/compared --initial reference --estimators eskf,aukf,smooth[/bold]

[bold]uwgraph compare dives/run1 -o out/compared --delay sun=2 --settings mine.yaml --json[/bold]"""

DEFAULT = "dr,eskf,ukf,aukf,smooth"
KINDS = ("dvl", "depth", "fixes", "heading", "sun", "odometry", "closures")
COLUMNS = (
    ("rmse m", "horizontal_rmse_m"),
    ("max m", "horizontal_max_m"),
    ("final m", "final_error_m"),
    ("final %", "final_error_percent"),
    ("depth m", "depth_rmse_m"),
    ("hdg deg", "heading_rmse_deg"),
    ("NEES pos", "nees_position"),
    ("NEES hdg", "nees_heading"),
    ("time s", "runtime_s"),
    ("MB", "memory_mb"),
)


def compare(
    dive: Annotated[Path, typer.Argument(metavar="DIVE", help="A dive folder, or a recording that import knows.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="OUT", help="Folder for the results.")],
    estimators: Annotated[
        str,
        typer.Option(metavar="NAMES", help="Of dr, eskf, aeskf, rts, ukf, aukf, kinematic, smooth; with commas."),
    ] = DEFAULT,
    heading_deg: Annotated[
        float | None, typer.Option(metavar="DEG", help="True heading at the start, where nothing aboard tells it.")
    ] = None,
    initial: Annotated[
        Literal["auto", "reference"] | None,
        typer.Option(help="First state from the sensors, or from the reference's first second."),
    ] = None,
    delay: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND=S", help="How late measurements reach the filters, e.g. sun=2; repeatable."),
    ] = None,
    alignment: Annotated[
        Literal["none", "origin", "yaw", "se3"],
        typer.Option("--align", help="Move onto the reference before judging; se3 hides what a heading gives."),
    ] = "none",
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file with 'smooth' and 'filter'; options win over it.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Estimators at a time; more than one distort the times.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="comparison.json on standard output.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier result.")] = False,
) -> None:
    """Run filters and the smoother on the same measurements, and judge them by the same ruler."""
    from uwgraph.cli.source import load_dive
    from uwgraph.dive.checks.presence import missing_in_words
    from uwgraph.evaluate.contest import run_contest
    from uwgraph.evaluate.contest_output import FILES, comparison, write_contest
    from uwgraph.evaluate.output import refuse_taken

    chosen = _settings(settings, {"heading_deg": heading_deg, "initial": initial}, delay or [])
    refuse_taken(out, overwrite=force, files=FILES)
    loaded = load_dive(dive)
    for line in missing_in_words(loaded):
        note(line)
    names = [name.strip() for name in estimators.split(",") if name.strip()]
    with progress_bar() as progress:
        contest = run_contest(loaded, names, chosen, title=dive.name, alignment=alignment, jobs=jobs, progress=progress)
        progress("writing", 1.0)
        config = {**chosen.model_dump(mode="json"), "rig": loaded.rig.model_dump(mode="json")}
        write_contest(contest, out, config, overwrite=force)
    if as_json:
        print_json(comparison(contest) | {"output": str(out)})
    else:
        _tell(contest, str(dive))
        note(f"results in {out}: open {out / 'report.html'} in a browser")
    if "matched" not in contest.entries[0].judged.metrics and alignment != "none":
        note(f"--align {alignment}: there is no reference to align with")
    for name, why in contest.failed.items():
        note(f"{name} gave no result: {why}")
    if contest.failed:
        sys.exit(EXIT_SOLVE)


def _settings(file: Path | None, asked: Mapping[str, Any], delays: list[str]) -> EstimatorSettings:
    from uwgraph.cli.options import settings_from
    from uwgraph.dive.yamlfile import parse_settings
    from uwgraph.filters import EstimatorSettings

    stated = settings_from(EstimatorSettings, file, {}).model_dump(exclude_unset=True)
    first = {name: value for name, value in asked.items() if value is not None}
    late = {"delays_s": {**stated.get("filter", {}).get("delays_s", {}), **dict(map(_delay, delays))}}
    for kind in late["delays_s"]:
        if kind not in KINDS:
            raise ConfigError(f"no sensor is called {kind!r}", where="delay", remedy=f"use {', '.join(KINDS)}")
    return parse_settings(
        EstimatorSettings,
        {"smooth": {**stated.get("smooth", {}), **first}, "filter": {**stated.get("filter", {}), **late}},
        "command line",
    )


def _delay(text: str) -> tuple[str, float]:
    kind, _, seconds = text.partition("=")
    try:
        return kind.strip(), float(seconds)
    except ValueError:
        raise ConfigError(f"{text!r} is no delay", where="--delay", remedy="write e.g. --delay sun=2") from None


def _tell(contest: Contest, title: str) -> None:
    """One row an estimator."""
    rows = []
    for entry in contest.entries:
        figures = entry.judged.metrics
        rows.append([entry.name, *(_cell(figures, key) for _, key in COLUMNS)])
    print_table(f"{title}: {_matched(contest)}", ["", *(name for name, _ in COLUMNS)], rows)


def _matched(contest: Contest) -> str:
    figures = contest.entries[0].judged.metrics
    if "matched" not in figures:
        return "no reference to judge by"
    way = f"{figures['distance_m']:.0f} m" if figures["distance_m"] else "no way"
    return f"{figures['matched']} of {figures['total']} poses matched, {way}, alignment {figures['alignment']}"


def _cell(figures: Mapping[str, Any], key: str) -> str:
    value, bounds = figures.get(key), figures.get(f"{key}_95")
    if value is None:
        return ""
    outside = bounds is not None and not bounds[0] <= value <= bounds[1]
    return f"{value:.3g}{' !' if outside else ''}"
