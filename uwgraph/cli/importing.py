"""``uwgraph import``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uwgraph.cli.console import note, print_json, print_table, progress_bar
from uwgraph.errors import ConfigError

if TYPE_CHECKING:
    from uwgraph.dive.importing import ImportReport
    from uwgraph.dive.logs.guess import Left, Taken
    from uwgraph.dive.logs.reading import LogOptions, Survey
    from uwgraph.types import Origin

EXAMPLES = """Examples:

[bold]uwgraph import logs/Trajectory1 dives/run1[/bold]

[bold]uwgraph import --list dive.mcap[/bold]

[bold]uwgraph import dive.bag dives/run2 --mapping mine.yaml --origin 43.1,5.9 --from 60 --to 900[/bold]"""


def import_(
    src: Annotated[Path, typer.Argument(metavar="SRC", help="The recording: a file or folder as the logger left it.")],
    dest: Annotated[Path | None, typer.Argument(metavar="DEST", help="The dive folder to make.")] = None,
    log_format: Annotated[
        str | None, typer.Option("--format", help="Name of the format; guessed, and told, if not given.")
    ] = None,
    mapping: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Which topic becomes which stream; guessed if not given.")
    ] = None,
    mapping_out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the mapping that is used here too, to edit it.")
    ] = None,
    origin: Annotated[
        str | None, typer.Option(metavar="LAT,LON", help="Where the dive was, degrees; else its first fix.")
    ] = None,
    rig: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Rig file: mounting and noise of the sensors.")
    ] = None,
    first: Annotated[
        str | None, typer.Option("--from", metavar="T", help="Take from here: ISO 8601, or seconds from the start.")
    ] = None,
    last: Annotated[
        str | None, typer.Option("--to", metavar="T", help="Take up to here: ISO 8601, or seconds from the start.")
    ] = None,
    align: Annotated[
        bool | None,
        typer.Option(
            "--align-clocks/--no-align-clocks", help="Estimate clock offsets; by default as the format needs."
        ),
    ] = None,
    only_list: Annotated[bool, typer.Option("--list", help="Only list the topics; nothing is imported.")] = False,
    csv: Annotated[bool, typer.Option("--csv", help="Write the streams as CSV instead of Parquet.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="JSON on standard output, for programs.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a dive folder that is already there.")] = False,
) -> None:
    """Turn a recording into a dive folder, and say what was taken, left, guessed and converted."""
    from dataclasses import asdict

    from uwgraph.dive.importing import import_dive, survey_recording

    options = _options(mapping, mapping_out, origin, rig, first, last)
    if only_list:
        survey = survey_recording(src, log_format, options)
        _print_survey(survey, str(src), as_json)
        return
    if dest is None:
        raise ConfigError("DEST is missing", where="command line", remedy="name the dive folder to make, or ask --list")
    with progress_bar() as progress:
        report = import_dive(
            src,
            dest,
            log_format,
            table_format="csv" if csv else "parquet",
            overwrite=force,
            options=options,
            align=align,
            progress=progress,
        )
    if as_json:
        print_json(asdict(report))
    else:
        _print(report)


def _options(
    mapping: Path | None,
    mapping_out: Path | None,
    origin: str | None,
    rig: Path | None,
    first: str | None,
    last: str | None,
) -> LogOptions:
    from uwgraph.cli.options import instant
    from uwgraph.dive.logs.assemble import Wishes
    from uwgraph.dive.logs.mapping import LogMapping
    from uwgraph.dive.logs.reading import LogOptions
    from uwgraph.dive.logs.window import Window
    from uwgraph.dive.rigfile import read_rig
    from uwgraph.dive.yamlfile import read_settings

    return LogOptions(
        mapping=read_settings(LogMapping, mapping) if mapping else None,
        wishes=Wishes(
            origin=_origin(origin) if origin else None,
            rig=read_rig(rig) if rig else None,
            window=Window(instant(first, "--from"), instant(last, "--to")),
        ),
        mapping_out=mapping_out,
    )


def _origin(text: str) -> Origin:
    from math import radians

    from uwgraph.types import Origin

    try:
        lat, lon = (float(part) for part in text.split(","))
    except ValueError:
        lat = lon = float("nan")
    if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 360.0):
        raise ConfigError(f"{text!r} is no place", where="--origin", remedy="write degrees, as in --origin 43.1,5.9")
    return Origin(radians(lat), radians(lon))


def _print(report: ImportReport) -> None:
    print(f"{report.source}: read as {report.format}: {report.reason}")
    _print_taken(report.taken)
    _print_left_in_brief(report.left)
    rows = [(s.name, str(s.count), f"{s.rate_hz:.6g}", f"{s.span_s:.3f}", s.start) for s in report.streams]
    print_table(report.destination, ("stream", "samples", "rate [Hz]", "span [s]", "from"), rows)
    told = {"conversions": report.conversions, "caveats": report.caveats, "for smoothing": report.missing}
    for heading, notes in told.items():
        if notes:
            print(f"{heading}:")
            print("\n".join(f"  - {line}" for line in notes))
    if report.taken:
        note(f"the mapping is {report.destination}/mapping.yaml: edit a copy and give it with --mapping to change it")


def _print_survey(survey: Survey, source: str, as_json: bool) -> None:
    from dataclasses import asdict

    if as_json:
        fields = {topic.name: list(topic.fields) for topic in survey.topics}
        print_json(
            {
                "source": source,
                "taken": [asdict(taken) for taken in survey.taken],
                "left": [asdict(left) | {"fields": fields[left.topic]} for left in survey.left],
            }
        )
        return
    print(source)
    _print_taken(survey.taken)
    topics = {topic.name: topic for topic in survey.topics}
    if survey.left:
        print("left:")
    for item in survey.left:
        print(f"  - {_named(item)}: {item.why}")
        if found := topics[item.topic].fields:
            print(f"      fields: {', '.join(found)}")


def _print_taken(taken: Sequence[Taken]) -> None:
    if taken:
        print("taken:")
        print("\n".join(f"  - {item.stream} from {_named(item)}: {item.how}" for item in taken))


def _print_left_in_brief(left: Sequence[Left]) -> None:
    """One line a reason: an autopilot's log has dozens of topics that are of no use."""
    topics: dict[str, list[str]] = {}
    for item in left:
        topics.setdefault(item.why, []).append(item.topic)
    if topics:
        print("left (more of them with --list):")
        print("\n".join(f"  - {', '.join(names)}: {why}" for why, names in topics.items()))


def _named(item: Taken | Left) -> str:
    count = "" if item.messages is None else f", {item.messages} messages"
    return f"{item.topic} ({item.type}{count})"
