"""The words of a report that are the same for every reader: what was compared, on what, and how it was judged."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from uwgraph.evaluate.entries import Contest, Entry
from uwgraph.evaluate.report_data import INSTANTS, MEASUREMENTS, REFUSED
from uwgraph.evaluate.report_table import MARKS, figure, value_of
from uwgraph.time import isoformat

ALIGNMENTS = {
    "none": "none: positions and headings are absolute",
    "origin": "moved onto the reference's first position",
    "yaw": "turned about the vertical and moved onto the reference, which hides errors of heading and position",
    "se3": "turned and moved onto the reference in all axes, which hides errors of heading, tilt and position",
}


def summary(contest: Contest) -> str:
    """How many estimators, on how long a way, judged at how many poses."""
    count = len(contest.entries)
    words = f"{count} estimator{'s' * (count != 1)} on the same measurements"
    if not contest.entries:
        return words
    m = _fullest(contest).judged.metrics
    way, duration = value_of(m, "distance_m"), value_of(m, "duration_s")
    if way:
        words += f", {figure(way)} m"
    if duration:
        words += f"{' in' if way else ','} {duration / 60.0:.1f} min"
    return words + (f"; {m['matched']} of {m['total']} poses matched with the reference." if "matched" in m else ".")


def legend(contest: Contest) -> str:
    """How to read the table."""
    words = ["Bold: the smallest of its column. Choose a heading to sort."]
    if any("nees_position" in entry.judged.metrics for entry in contest.entries):
        words.append(
            "NEES and NIS are divided by their degrees of freedom, so that 1 is expected. The interval of NEES is that "
            "of one independent draw, for errors along a dive are strongly correlated. "
            + "; ".join(f"{sign} {note}" for sign, note in MARKS.values() if sign)
            + "."
        )
    return " ".join(words)


def track_key(contest: Contest) -> str:
    """What the signs on the map are, of those that are there."""
    dive, entries = contest.dive, contest.entries
    signs = {
        "thick grey line: the reference": any(entry.judged.reference is not None for entry in entries),
        "circle: start, square: end": True,
        "ellipses: 3-sigma of the estimator in detail, to scale": True,
        "crosses: fixes": dive.fixes is not None and len(dive.fixes) > 0,
        "rings: the sun was seen": dive.sun is not None and bool((dive.sun.flags == 0).any()),
        "thin straight lines: closures that were accepted": any(
            verdicts is not None and verdicts.accepted.any()
            for verdicts in (entry.judged.solution.closures for entry in entries)
        ),
    }
    return f"North is up; {'; '.join(sign for sign, there in signs.items() if there)}."


def simulated(contest: Contest) -> Iterator[str]:
    """What of the dive did not come from a vehicle."""
    provenance = contest.dive.provenance
    if provenance.get("source") == "simulated":
        yield "Simulated: the whole dive, reference included, comes from a simulator."
    streams = provenance.get("simulated")
    if isinstance(streams, dict) and streams:
        said = "; ".join(f"{name} ({str(how).removeprefix('simulated: ')})" for name, how in streams.items())
        yield f"Simulated streams: {said}."
    elif streams:
        yield f"Simulated: {streams}."


def about(contest: Contest) -> Iterator[tuple[str, str]]:
    """Name and value of what a reader needs to do it again."""
    dive = contest.dive
    yield "dive", contest.title
    if contest.entries:
        entry = _fullest(contest)
        m, stamps = entry.judged.metrics, entry.judged.solution.t_ns
        yield "from, to", f"{isoformat(int(stamps[0]))} to {isoformat(int(stamps[-1]))}"
        if "alignment" in m:
            yield "alignment", ALIGNMENTS.get(m["alignment"], m["alignment"])
            yield "matched poses", f"{m['matched']} of {m['total']}"
    yield "streams", ", ".join(f"{name} {len(stream)}" for name, stream in dive.streams())
    for name in ("format", "source", "conversions", "caveats", "seed"):
        if dive.provenance.get(name) not in (None, [], ""):
            yield name, _in_words(dive.provenance[name])
    thinned = (
        f"thinned where a dive is long: {INSTANTS} instants, of every bunch of neighbours the one with the largest "
        f"error; of a sensor {MEASUREMENTS} measurements and {REFUSED} that were refused. Figures and sentences are of "
        "all."
    )
    yield "drawing", thinned
    yield "software", f"uwgraph {version('uwgraph')}"
    yield "written", datetime.now(UTC).isoformat(timespec="seconds")


def _fullest(contest: Contest) -> Entry:
    """The entry with the most matched poses speaks for all."""
    return max(contest.entries, key=lambda entry: entry.judged.metrics.get("matched", len(entry.judged.solution)))


def _in_words(value: Any) -> str:
    return "\n".join(str(item) for item in value) if isinstance(value, list | tuple) else str(value)
