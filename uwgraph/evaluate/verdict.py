"""What ``uwgraph eval`` says of a trajectory and a reference, whoever made them, and what it exports."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.evaluate.align import HIDES, Alignment
from uwgraph.evaluate.judge import judge
from uwgraph.evaluate.matching import Matching, compare_trajectories, denser
from uwgraph.evaluate.metrics import Comparison, ate_metrics, compare, error_metrics
from uwgraph.evaluate.reference import known_rows
from uwgraph.evaluate.table import tum_lines
from uwgraph.evaluate.trajectory import Trajectory
from uwgraph.evaluate.trajectory_file import as_if
from uwgraph.plain import json_values
from uwgraph.time import NS, isoformat
from uwgraph.types import Solution, TimeArray

TRAJECTORY: Final = "trajectory.tum"
"""What makes a folder an export of ``uwgraph eval``."""
FITS_BETTER: Final = 0.5
"""Another frame is hinted at when it leaves less than this share of the error."""
_A_DATE_NS: Final = 300_000_000 * NS
"""Stamps below it count from somewhere else than 1970."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """A trajectory judged."""

    comparison: Comparison
    figures: dict[str, Any]
    """Those of ``metrics.json`` that need a reference, ``rpe`` among them."""
    notes: tuple[str, ...]
    """What was assumed and what the figures hide, in words."""


def judge_trajectory(
    estimate: Trajectory,
    reference: Trajectory,
    alignment: Alignment = "none",
    matching: Matching | None = None,
    distances: Sequence[float] | None = None,
) -> Verdict:
    """Compare a trajectory with a reference, without a dive: positions, attitudes, drift, and NEES where it has sigmas.

    Raises
    ------
    DataError
        When no pose of one finds a pose of the other, with both spans.
    ConfigError
        When the alignment is not determined.
    """
    comparison = compare_trajectories(estimate, reference, alignment, matching)
    if not comparison.matched.any():
        raise _nothing_matched(estimate.t_ns, reference.t_ns, matching or Matching())
    notes = [*estimate.caveats, *reference.caveats]
    for name, trajectory in (("trajectory", estimate), ("reference", reference)):
        if trajectory.assumed:
            notes.append(
                f"the {name} does not state its frame: taken as {trajectory.frame}; --{name}-frame says otherwise"
            )
    notes += _better_frame(estimate, reference, comparison, matching)
    if (estimate.origin is None) != (reference.origin is None) and alignment == "none":
        lacks = "trajectory" if estimate.origin is None else "reference"
        notes.append(f"the {lacks} does not state where its origin lies: taken to be the other's")
    which = "trajectory" if denser(estimate, reference) is estimate else "reference"
    how = "interpolated" if (matching or Matching()).how == "interpolate" else "taken at its nearest poses"
    return verdict_of(comparison, distances, [f"the {which} was {how} at the stamps of the other", *notes])


def judge_solution(
    dive: Dive, solution: Solution, alignment: Alignment = "none", distances: Sequence[float] | None = None
) -> Verdict:
    """A solution read back and judged as ``smooth`` does: the dive's IMU brings it to its reference's own stamps.

    Raises
    ------
    DataError
        When the dive has no reference, or none at the solution's times.
    """
    judged = judge(dive, solution, alignment)
    if judged.reference is None:
        raise DataError("the dive has no reference", where="reference", remedy="name a file with its trajectory")
    comparison = compare(judged.solution, judged.reference, alignment)
    if not comparison.matched.any():
        raise _nothing_matched(solution.t_ns, judged.reference.t_ns, Matching())
    verdict = verdict_of(comparison, distances, ["the dive's IMU brought the solution to the stamps of the reference"])
    # the file has no correlations of the angles
    return replace(verdict, figures={k: v for k, v in verdict.figures.items() if not k.startswith("nees_attitude")})


def verdict_of(comparison: Comparison, distances: Sequence[float] | None, notes: Sequence[str]) -> Verdict:
    """The figures of a comparison, and beside ``notes`` what its alignment hides and how many poses matched."""
    figures = error_metrics(comparison, distances)
    told = [f"{figures['matched']} of {figures['total']} poses matched", *notes]
    if comparison.alignment != "none":
        told.append(f"aligned by {comparison.alignment}: the figures hide {HIDES[comparison.alignment]}")
    if figures["ate_dimensions"] == 2:
        told.append("heights are not known on both sides: ATE is horizontal")
    if not figures["rpe"]:
        told.append("no pair of poses is as far apart as the distances of RPE")
    elif figures["rpe"][0]["axes"] == "navigation":
        told.append(
            "attitudes or heights are not known on both sides: RPE compares displacements in the frame they share"
        )
    return Verdict(comparison, figures, tuple(told))


def export_verdict(verdict: Verdict, folder: Path) -> None:
    """Write what was judged as ``trajectory.tum`` and ``reference.tum`` of the same stamps, and ``eval.json``.

    ``evo_ape tum reference.tum trajectory.tum`` gives the same ATE: the alignment has been applied. Heights that are
    not known are zero in both, attitudes that are not known the identity.
    """
    c = verdict.comparison
    p, p_true = c.solution.p_n.copy(), c.truth.p_n.copy()
    if verdict.figures["ate_dimensions"] == 2:
        p[:, 2] = p_true[:, 2] = 0.0
    k = known_rows(p - p_true)
    posed = known_rows((c.solution.R_nb + c.R_nb_true).reshape(-1, 9))[:, None, None]
    head = "# NED world, FRD body, at the stamps that were judged\n# t x y z qx qy qz qw\n"
    for name, place, R in (("trajectory", p, c.solution.R_nb), ("reference", p_true, c.R_nb_true)):
        lines = tum_lines(c.solution.t_ns[k], place[k], np.where(posed, R, np.eye(3))[k])
        (folder / f"{name}.tum").write_text(head + lines, encoding="utf-8", newline="\n")
    told = json_values(verdict.figures | {"notes": verdict.notes})
    (folder / "eval.json").write_text(json.dumps(told, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _better_frame(
    estimate: Trajectory, reference: Trajectory, comparison: Comparison, matching: Matching | None
) -> list[str]:
    """A hint when a trajectory whose frame nobody stated fits far better as ENU."""
    as_enu = {
        "--trajectory-frame enu": (as_if(estimate, "enu"), reference) if estimate.assumed else None,
        "--reference-frame enu": (estimate, as_if(reference, "enu")) if reference.assumed else None,
    }
    now = ate_metrics(comparison.e_n, 0.0)["ate_rmse_m"]
    hints = []
    for option, pair in as_enu.items():
        if pair is not None and now is not None:
            other = compare_trajectories(*pair, comparison.alignment, matching)
            then = ate_metrics(other.e_n, 0.0)["ate_rmse_m"]
            if then is not None and then < FITS_BETTER * now:
                hints.append(f"{option} (ATE {then:.3g} m instead of {now:.3g} m)")
    return [f"the frames differ? it fits better with {' or '.join(hints)}"] if hints else []


def _nothing_matched(estimate: TimeArray, reference: TimeArray, matching: Matching) -> DataError:
    spans = f"the trajectory spans {_span(estimate)}, the reference {_span(reference)}"
    if estimate[0] > reference[-1] or reference[0] > estimate[-1]:
        offset = (int(estimate[0]) - int(reference[0])) / NS
        remedy = f"clock offset? the trajectory starts {offset:+.3f} s after the reference: shift the stamps of one"
    elif matching.max_dt_s is not None:
        remedy = "allow a longer --max-dt"
    else:
        remedy = "is there a gap in one of them? --match nearest --max-dt S takes poses S seconds apart"
    return DataError(f"no pose of one matches one of the other: {spans}", where="trajectory", remedy=remedy)


def _span(t_ns: TimeArray) -> str:
    first, last = int(t_ns[0]), int(t_ns[-1])
    if first < _A_DATE_NS:
        return f"{first / NS:.3f} s to {last / NS:.3f} s"
    return f"{isoformat(first)} to {isoformat(last)}"
