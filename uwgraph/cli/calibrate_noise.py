"""``uwgraph calibrate noise``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uwgraph.cli.console import note, print_json, print_table, refuse_existing
from uwgraph.errors import DataError

if TYPE_CHECKING:
    from uwgraph.dive.imu_noise import ImuNoise
    from uwgraph.dive.noise_terms import SensorNoise, Term
    from uwgraph.dive.rig import ImuRig

EXAMPLES = """Examples:

[bold]uwgraph calibrate noise static.bag -o rig.yaml --plot allan.png[/bold]

[bold]uwgraph calibrate noise dives/run1 --to 90[/bold] (on deck, before the dive)"""


def noise(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A recording at rest, or a dive with a still part.")],
    from_: Annotated[
        str | None, typer.Option("--from", metavar="T", help="Look from here on: ISO 8601, or seconds from the start.")
    ] = None,
    to: Annotated[str | None, typer.Option("--to", metavar="T", help="Look up to here, likewise.")] = None,
    mapping: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Which topic is the IMU: a mapping file, as import writes it.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="RIG.yaml", help="Write the rig with what was found.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the Allan deviations.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON on standard output, for programs.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a rig file that is already there.")] = False,
) -> None:
    """Noise of the IMU from a recording at rest, by Allan deviation: densities and bias walks for the rig.

    The longest stretch without motion is taken. What it is too short to show is refused: left as it is.
    """
    from uwgraph.cli.options import instant
    from uwgraph.dive.imu_log import read_imu
    from uwgraph.dive.imu_noise import imu_noise
    from uwgraph.dive.logs.mapping import LogMapping
    from uwgraph.dive.logs.window import Window
    from uwgraph.dive.rigfile import write_rig
    from uwgraph.dive.yamlfile import read_settings

    refuse_existing(out, force)
    imu, rig = read_imu(
        log,
        None if mapping is None else read_settings(LogMapping, mapping),
        Window(instant(from_, "--from"), instant(to, "--to")),
    )
    found = imu_noise(imu, str(log))
    shown = [name for name, term in found.fields.items() if term.seen]
    if plot is not None:
        from uwgraph.evaluate.noise_plot import noise_plot

        noise_plot(found, plot, log.name)
    if as_json:
        print_json(_values(found))
    else:
        _print(found, rig.imu, str(log))
    if out is not None:
        if not shown:
            raise DataError(
                "shows none of the rig's densities, and no rig was written",
                where=str(log),
                remedy="; ".join(found.notes) or "record the IMU at rest, longer",
            )
        after = rig.model_copy(update={"imu": found.rig(rig.imu)})
        write_rig(
            after, out, (f"{', '.join(shown)}: Allan deviation of {log.name}, still for {found.duration_s:.0f} s",)
        )
        note(f"rig in {out}")


def _print(found: ImuNoise, rig: ImuRig, title: str) -> None:
    from uwgraph.dive.imu_noise import WORDS

    part = "all of it" if found.duration_s > found.recorded_s - 2.0 else f"of {found.recorded_s:.0f} s"
    print(f"{title}: still for {found.duration_s:.0f} s from {found.start_s:.0f} s on ({part}), {found.rate_hz:.4g} Hz")
    letters = ", ".join(f"{key} {word}" for key, word in WORDS.items())
    for name, sensor in (("gyro", found.gyro), ("accel", found.accel)):
        print_table(f"{name}: {letters}", ("", "x", "y", "z", "all axes"), _rows(name, sensor))
    changes = []
    for name, term in found.fields.items():
        before = f"{getattr(rig, name):.3g}"
        verdict = "" if term.seen else f"left: not seen, below {term.limit:.2g} (95 %)"
        changes.append((name, before, f"{term.value:.3g}" if term.seen else before, verdict))
    print_table("rig.imu", ("field", "before", "after", ""), changes)
    for line in found.notes:
        print(f"  - {line}")


def _rows(name: str, sensor: SensorNoise) -> list[tuple[str, ...]]:
    from uwgraph.dive.imu_noise import UNITS

    return [
        (
            f"{key} {UNITS[name][key]}",
            *(_figure(axis.terms[key]) for axis in sensor.axes),
            _figure(term) + (f" +- {term.sigma / term.value:.1%}" if term.seen else ""),
        )
        for key, term in sensor.terms.items()
    ]


def _figure(term: Term) -> str:
    return f"{term.value:.3g}" if term.seen else f"< {term.limit:.2g}"


def _values(found: ImuNoise) -> dict[str, Any]:
    """Everything that the tables say, as plain values."""

    def plain(term: Term) -> dict[str, Any]:
        value, sigma = (term.value, term.sigma) if term.seen else (None, None)
        return {"seen": term.seen, "value": value, "sigma": sigma, "limit_95": term.limit, "axes": term.axes}

    def sensor(noise: SensorNoise) -> dict[str, Any]:
        return {
            "tau_min_s": noise.tau_min_s,
            "sigmas_inflated_by": noise.inflation,
            "terms": {key: plain(term) for key, term in noise.terms.items()},
            "axes": {
                letter: {
                    "tau_s": axis.allan.tau_s.tolist(),
                    "allan_deviation": (axis.allan.variance**0.5).tolist(),
                    "trend_per_s": axis.trend,
                    "terms": {key: plain(term) for key, term in axis.terms.items()},
                }
                for letter, axis in zip("xyz", noise.axes, strict=True)
            },
        }

    return {
        "rate_hz": found.rate_hz,
        "still_from_s": found.start_s,
        "still_for_s": found.duration_s,
        "recorded_s": found.recorded_s,
        "rig_imu": {name: term.value for name, term in found.fields.items() if term.seen},
        "refused": {name: {"limit_95": term.limit} for name, term in found.fields.items() if not term.seen},
        "gyro": sensor(found.gyro),
        "accel": sensor(found.accel),
        "notes": list(found.notes),
    }
