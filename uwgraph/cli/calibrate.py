"""``uwgraph calibrate``: noise, calibrations of others, and the rig's numbers from dives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from uwgraph.cli import calibrate_import, calibrate_noise
from uwgraph.cli.console import note, print_json, print_table, progress_bar, refuse_existing
from uwgraph.errors import ConfigError, DataError, SolveError

if TYPE_CHECKING:
    from uwgraph.calibrate import Calibration, Estimate
    from uwgraph.calibrate.parameters import What

DVL_EXAMPLES = """Examples:

[bold]uwgraph calibrate dvl dives/run1 dives/run2 -o rig.yaml[/bold] (dives with position fixes)

[bold]uwgraph calibrate dvl dives/run1 dives/run2 --reference -o rig.yaml[/bold]

[bold]uwgraph calibrate dvl dives/run3 --free dvl.scale --free dvl.time_offset_s --json[/bold]"""
CLOCK_EXAMPLES = "Example: [bold]uwgraph calibrate clock dives/run1 --heading-deg 124[/bold]"
MOUNTING_EXAMPLES = "Example: [bold]uwgraph calibrate mounting dives/run1 dives/run2 -o rig.yaml[/bold]"
DVL_HELP = "Scale, mounting, lever arm and clock of the DVL; what the motion does not show is refused, and said."
CLOCK_HELP = """Offset and rate of every sensor's clock against the IMU's: by correlation, refined in the graph.

A rate is told, not applied: a rig has none. An offset is that at the middle of the stream."""
MOUNTING_HELP = "Rotations and lever arms of compass, sun sensor, depth sensor, fixes and reference."
APPLY_EXAMPLES = """Examples:

[bold]uwgraph calibrate apply rig.yaml dives/run7[/bold] (in place)

[bold]uwgraph calibrate apply rig.yaml logs/run7 -o dives/run7 --clocks[/bold]"""

app = typer.Typer(
    help="The rig's numbers: noise, scale, mounting, lever arms, clocks.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("noise", epilog=calibrate_noise.EXAMPLES)(calibrate_noise.noise)
app.command("import", epilog=calibrate_import.EXAMPLES)(calibrate_import.import_)

Dives = Annotated[list[Path], typer.Argument(metavar="DIVE...", help="Dives of one vehicle with one rig.")]
Out = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="RIG.yaml", help="Write the rig, and its covariance as RIG.json.")
]
Start = Annotated[
    Path | None,
    typer.Option("--rig", metavar="RIG.yaml", help="Put this rig onto the dives first; their clocks stay."),
]
Free = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="Free these instead, as in dvl.scale or depth.translation_m; repeatable."),
]
Referenced = Annotated[bool, typer.Option("--reference", help="Take the reference's positions as fixes.")]
ReferenceSigma = Annotated[
    float | None, typer.Option(metavar="M", help="1-sigma of a reference position per axis (1), one every 20 s.")
]
ReferenceHeading = Annotated[
    float | None, typer.Option("--reference-heading", metavar="DEG", help="Its heading aids too, with this 1-sigma.")
]
CommonClock = Annotated[bool, typer.Option("--common-clock", help="One clock offset for all dives, not one each.")]
Initial = Annotated[
    Literal["auto", "reference"] | None,
    typer.Option(help="First state from the sensors, or from the reference's first second."),
]
Heading = Annotated[
    float | None, typer.Option(metavar="DEG", help="True heading at the start, where nothing aboard tells it.")
]
Json = Annotated[bool, typer.Option("--json", help="JSON on standard output, for programs.")]
Force = Annotated[bool, typer.Option("--force", help="Replace files that are already there.")]


def _command(what: What) -> Callable[..., None]:
    """The command of one choice: the three differ in what they free and in nothing else."""

    def command(
        dives: Dives,
        out: Out = None,
        rig: Start = None,
        free: Free = None,
        reference: Referenced = False,
        reference_sigma: ReferenceSigma = None,
        reference_heading: ReferenceHeading = None,
        common_clock: CommonClock = False,
        initial: Initial = None,
        heading_deg: Heading = None,
        as_json: Json = False,
        force: Force = False,
    ) -> None:
        use = _Use(reference, reference_sigma, reference_heading, common_clock, initial, heading_deg)
        _calibrate(what, dives, free, rig, use, out, as_json, force)

    return command


app.command("dvl", epilog=DVL_EXAMPLES, help=DVL_HELP)(_command("dvl"))
app.command("clock", epilog=CLOCK_EXAMPLES, help=CLOCK_HELP)(_command("clock"))
app.command("mounting", epilog=MOUNTING_EXAMPLES, help=MOUNTING_HELP)(_command("mounting"))


@app.command("apply", epilog=APPLY_EXAMPLES)
def apply(
    rig: Annotated[Path, typer.Argument(metavar="RIG.yaml", help="The rig.")],
    dive: Annotated[Path, typer.Argument(metavar="DIVE", help="A dive folder, or a recording that import knows.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="DEST", help="Write another dive folder.")] = None,
    clocks: Annotated[
        bool, typer.Option("--clocks", help="Take the clock offsets over too; the dive's own stay otherwise.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a dive folder that is already there.")] = False,
) -> None:
    """Put a rig onto a dive."""
    from dataclasses import replace

    from uwgraph.cli.source import load_dive
    from uwgraph.dive.folder import HEADER, write_dive
    from uwgraph.dive.rigfile import apply_rig, read_rig, write_rig_into

    new = read_rig(rig)
    ours = (dive / HEADER).exists()
    if out is None and not ours:
        raise ConfigError(
            "a recording cannot be changed in place", where=str(dive), remedy="name a dive folder to make with -o"
        )
    changed = apply_rig(load_dive(dive), new, keep_clocks=not clocks)
    remark = f"rig of {rig.name}, clock offsets {'and all' if clocks else 'kept'}"
    if out is None:
        write_rig_into(dive, changed.rig, remark)
    else:
        earlier = changed.provenance.get("conversions") or []
        provenance = {**changed.provenance, "conversions": [*earlier, remark]}
        write_dive(replace(changed, provenance=provenance), out, images_from=dive if ours else None, overwrite=force)
    note(f"{out or dive}: {remark}")


class _Use:
    """How the dives are used; the same options for every choice."""

    def __init__(
        self,
        reference: bool,
        sigma: float | None,
        heading: float | None,
        common_clock: bool,
        initial: Literal["auto", "reference"] | None,
        heading_deg: float | None,
    ) -> None:
        from uwgraph.calibrate import ReferenceUse
        from uwgraph.cli.options import settings_from
        from uwgraph.graph import SmoothSettings

        if not reference and (sigma is not None or heading is not None):
            raise ConfigError("--reference-sigma and --reference-heading go with --reference", where="--reference")
        used = {"sigma_m": sigma, "heading_sigma_deg": heading}
        self.reference = settings_from(ReferenceUse, None, used) if reference else None
        asked = {"initial": initial, "heading_deg": heading_deg}
        given = any(value is not None for value in asked.values())
        self.settings = settings_from(SmoothSettings, None, asked) if given else None
        self.common_clock = common_clock


def _calibrate(
    what: What,
    dives: list[Path],
    free: list[str] | None,
    rig: Path | None,
    use: _Use,
    out: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    from uwgraph.calibrate import calibrate_dives
    from uwgraph.calibrate.report import as_plain, doubts, report_file, write_calibration
    from uwgraph.cli.source import load_dive
    from uwgraph.dive.rigfile import read_rig

    if out is not None:
        if report_file(out) == out:
            raise ConfigError("a rig file is YAML, and its report takes this name", where="-o", remedy="name RIG.yaml")
        refuse_existing(out, force)
        refuse_existing(report_file(out), force)
    start = None if rig is None else read_rig(rig)
    loaded = [load_dive(dive) for dive in dives]
    with progress_bar() as progress:
        found = calibrate_dives(
            loaded,
            free or what,
            names=_names(dives),
            reference=use.reference,
            common_clock=use.common_clock,
            rig=start,
            settings=use.settings,
            progress=progress,
        )
    if not found.converged:
        raise SolveError(
            f"does not stand still after {found.iterations} rounds: its numbers are not to be trusted",
            where=", ".join(map(str, dives)),
            remedy="free fewer numbers with --free, give more of the rig with --rig, or dives with more motion",
        )
    if as_json:
        print_json(as_plain(found))
    else:
        _print(found)
    for doubt in doubts(found):
        note(f"doubt: {doubt}")
    if out is not None:
        if not any(e.observable for e in found.estimates):
            raise DataError(
                "the dives tell nothing that was freed, and no rig was written",
                where=", ".join(map(str, dives)),
                remedy="; ".join(u.text for u in found.unseen),
            )
        write_calibration(found, out)
        note(f"rig in {out}, covariance in {report_file(out)}")


def _names(dives: list[Path]) -> list[str]:
    """Folder names, or whole paths where those are not unique."""
    short = [dive.resolve().name for dive in dives]
    return short if len(set(short)) == len(short) else [str(dive) for dive in dives]


def _print(found: Calibration) -> None:
    from uwgraph.calibrate.report import CRITERION

    header = ("", "before", "after", "1-sigma", "of data", "dives", "scatter")
    print_table(f"calibrate {found.what}: {', '.join(found.rigs)}", header, map(_row, found.estimates))
    if found.clocks:
        print_table("clocks of each dive", header[:-2], [_row(e)[:-2] for e in found.clocks])
    rows = [
        (dive, sensor, *(f"{x:.4g}" for x in (c.offset_s, c.sigma_s, c.rate_ppm, c.rate_sigma_ppm)))
        if c.observable
        else (dive, sensor, c.how, "", "", "")
        for dive, clocks in found.correlations.items()
        for sensor, c in clocks.items()
    ]
    if rows:
        print_table("clocks by correlation", ("", "", "offset s", "1-sigma", "rate ppm", "1-sigma"), rows)
    print(CRITERION)
    for statement in found.unseen:
        print(f"  - {statement.text}")
    for e in found.estimates:
        if e.inflated > 1.0:
            print(f"  - {e.name}: the dives scatter more than they should; its 1-sigma is {e.inflated:.1f} times wider")


def _row(e: Estimate) -> tuple[str, ...]:
    from uwgraph.calibrate.report import figure

    return (
        e.name,
        f"{e.before:.5g}",
        figure(e.after, e.sigma) if e.observable else "not told",
        f"{e.sigma:.2g}",
        f"{e.data_sigma:.2g}",
        str(e.dives),
        f"{e.scatter:.2g}" if e.scatter == e.scatter else "",
    )
