"""What the page draws, as plain values: thinned and rounded, for drawing only."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from uwgraph.evaluate.entries import Contest
from uwgraph.evaluate.report_colours import looks
from uwgraph.evaluate.report_directions import Directions
from uwgraph.evaluate.report_series import QUANTITIES, Course, History, evenly, histories, peaks, seconds, start_ns
from uwgraph.frames import ned_from_geodetic
from uwgraph.plain import json_values
from uwgraph.time import isoformat
from uwgraph.types import ClosureVerdicts, FloatArray, Innovations, Solution

INSTANTS = 1800
"""Drawn of an estimator's track and errors."""
MEASUREMENTS = 1200
"""Drawn of a sensor's innovations or residuals."""
REFUSED = 400
"""Drawn of a sensor's refused innovations beside them."""
LEVELS = 400
"""Drawn of anything smooth: running means, distributions."""
ELLIPSES = 24
MILLI = 3
"""Decimals of places and times: zoomed in, a centimetre or 0.1 s are steps."""


def page_data(contest: Contest, courses: Sequence[Course], found: Sequence[Directions]) -> dict[str, Any]:
    """The page's JSON; names are as given, and whoever shows them must treat them as text."""
    start = start_ns(contest)
    entries = []
    for course, look in zip(courses, looks([entry.name for entry in contest.entries]), strict=True):
        entries.append(
            {"name": course.entry.name, "colour": look.colour, "dash": look.dash}
            | _track(course)
            | {
                "distribution": _distribution(course.horizontal),
                "rpe": json_values(course.entry.judged.metrics.get("rpe") or []),
                "sensors": {h.kind: _history(h) for h in histories(course.entry.innovations, start)},
                "fading": _fading(course.entry.innovations, start),
            }
        )
    return {
        "start": isoformat(start),
        "judged": any(course.comparison is not None for course in courses),
        "quantities": [{"name": name, "unit": unit} for name, unit in QUANTITIES],
        "entries": entries,
        "reference": _reference(courses),
        "fixes": _fixes(contest, start),
        "sun": _sun(contest, start),
        "directions": [_direction(each, start) for each in found],
    }


def rounded(values: FloatArray, decimals: int | None = None) -> list[float | None]:
    """Values as JSON takes them: four digits of each unless told otherwise, None for what is not finite."""
    values = np.asarray(values, dtype=np.float64)
    if decimals is None:
        short = [float(f"{value:.4g}") for value in values.tolist()]
    else:
        short = np.round(values, decimals).tolist()
    # plus zero: no minus zero
    return [value + 0.0 if known else None for value, known in zip(short, np.isfinite(short).tolist(), strict=True)]


def _track(course: Course) -> dict[str, Any]:
    rows = peaks(course.error if course.comparison is not None else course.sigma, INSTANTS)
    solution = course.solution
    return {
        "t": rounded(course.t_s[rows], MILLI),
        "east": rounded(solution.p_n[rows, 1], MILLI),
        "north": rounded(solution.p_n[rows, 0], MILLI),
        "error": [rounded(column) for column in course.error[rows].T] if course.comparison is not None else None,
        "sigma": [rounded(column) for column in course.sigma[rows].T] if np.isfinite(course.sigma).any() else None,
        "ellipses": _ellipses(course),
        "closures": _closures(solution, solution.closures),
    }


def _ellipses(course: Course) -> list[list[float | None]]:
    """East, north, half axes of 3 sigma [m] and the direction of the first from east to north [deg]."""
    from uwgraph.evaluate.people import people

    cov = people(course.solution).cov_p_n[:, :2, :2]
    known = np.flatnonzero(np.isfinite(cov).all(axis=(1, 2)))
    if not len(known):
        return []
    rows = known[evenly(len(known), ELLIPSES)]
    variance, axes = np.linalg.eigh(cov[rows])
    half = 3.0 * np.sqrt(np.maximum(variance, 0.0))
    angle = np.degrees(np.arctan2(axes[:, 0, 0], axes[:, 1, 0]))
    place = course.solution.p_n[rows]
    return [rounded(row, MILLI) for row in np.column_stack([place[:, 1], place[:, 0], half, angle])]


def _closures(solution: Solution, verdicts: ClosureVerdicts | None) -> list[list[float | None]]:
    """East and north of both ends of every accepted closure, m."""
    if verdicts is None or not verdicts.accepted.any() or len(solution) < 2:
        return []
    kept = verdicts.select(verdicts.accepted)
    kept = kept.select(evenly(len(kept), LEVELS))
    ends = [np.interp(t, solution.t_ns, solution.p_n[:, axis]) for t in (kept.from_ns, kept.t_ns) for axis in (1, 0)]
    return [rounded(row, MILLI) for row in np.column_stack(ends)]


def _distribution(horizontal: FloatArray) -> dict[str, Any] | None:
    """Horizontal error below which a share of the stamps lies."""
    known = horizontal[np.isfinite(horizontal)]
    if not len(known):
        return None
    share = np.linspace(0.0, 1.0, LEVELS // 2)
    return {"error": rounded(np.quantile(known, share)), "percent": rounded(100.0 * share, 2)}


def _history(history: History) -> dict[str, Any]:
    of, axes = history.of, history.axes
    refused = np.flatnonzero(~of.accepted)
    rows = np.union1d(evenly(len(of), MEASUREMENTS), refused[evenly(len(refused), REFUSED)])
    levels = evenly(len(of), LEVELS)
    return {
        "t": rounded(history.t_s[rows], MILLI),
        "whitened": [rounded(column) for column in of.whitened[rows, :axes].T],
        "refused": [int(refused) for refused in ~of.accepted[rows]],
        "running": _running(history),
        "noise_t": rounded(history.t_s[levels], MILLI),
        "noise": [rounded(column) for column in of.noise[levels, :axes].T],
        "measurements": len(of),
        "refusals": history.refused,
    }


def _running(history: History) -> dict[str, Any] | None:
    running = history.running
    if running is None:
        return None
    rows = peaks(running.nis, LEVELS)
    return {
        "t": rounded(running.t_s[rows], MILLI),
        "nis": rounded(running.nis[rows]),
        "window": running.window,
        "bounds": list(running.bounds),
    }


def _fading(innovations: Innovations | None, start: int) -> dict[str, Any] | None:
    if innovations is None or not (innovations.fading > 1.0).any():
        return None
    faded = innovations.select(innovations.fading > 1.0)
    faded = faded.select(np.argsort(faded.t_ns, kind="stable"))
    rows = peaks(faded.fading, INSTANTS)
    return {
        "t": rounded(seconds(faded.t_ns[rows], start), MILLI),
        "factor": rounded(faded.fading[rows]),
        "times": len(faded),
        "measurements": len(innovations),
    }


def _reference(courses: Sequence[Course]) -> dict[str, Any] | None:
    """The reference at the stamps of the estimator that it was asked at most."""
    asked = [(course.comparison, course) for course in courses if course.comparison is not None]
    if not asked:
        return None
    comparison, course = max(asked, key=lambda pair: int(pair[0].truth.has_position.sum()))
    rows = evenly(len(course.t_s), INSTANTS)
    p_n = comparison.truth.p_n[rows]
    return {
        "t": rounded(course.t_s[rows], MILLI),
        "east": rounded(p_n[:, 1], MILLI),
        "north": rounded(p_n[:, 0], MILLI),
    }


def _fixes(contest: Contest, start: int) -> dict[str, Any] | None:
    fixes = contest.dive.fixes
    if fixes is None or not len(fixes):
        return None
    fixes = fixes.select(evenly(len(fixes), LEVELS))
    height = np.nan_to_num(fixes.height)
    p_n = ned_from_geodetic(contest.dive.origin, fixes.lat, fixes.lon, height)
    return {
        "t": rounded(seconds(fixes.t_ns, start), MILLI),
        "east": rounded(p_n[:, 1], MILLI),
        "north": rounded(p_n[:, 0], MILLI),
    }


def _sun(contest: Contest, start: int) -> list[float | None]:
    """When the sun was seen."""
    sun = contest.dive.sun
    if sun is None or not (sun.flags == 0).any():
        return []
    good = sun.t_ns[sun.flags == 0] + contest.dive.rig.sun.time_offset_ns
    return rounded(seconds(good[evenly(len(good), LEVELS // 4)], start), MILLI)


def _direction(found: Directions, start: int) -> dict[str, Any]:
    rows = evenly(len(found.t_ns), MEASUREMENTS)
    return {
        "name": found.name,
        "sigma": json_values(found.sigma_deg),
        "t": rounded(seconds(found.t_ns[rows], start), MILLI),
        "residual": [rounded(residual[rows]) for residual in found.residual_deg],
    }
