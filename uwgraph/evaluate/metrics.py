"""Errors of a solution against a reference, and whether its covariance tells the truth about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.chi_square import chi2_quantile
from uwgraph.evaluate.align import Alignment, align
from uwgraph.evaluate.people import People, people, sigmas
from uwgraph.evaluate.reference import ReferenceAt, known_rows, reference_at
from uwgraph.evaluate.relative import relative_errors
from uwgraph.evaluate.statistics import mean, number, percent, rms
from uwgraph.frames import R_n_local, matrix_from_rph, wrap_pi
from uwgraph.types import BoolArray, FloatArray, Reference, Solution

Metrics = Mapping[str, Any]
"""What ``metrics.json`` holds: plain numbers, None where something is not known."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Estimate minus reference at every keyframe; NaN where the reference does not reach."""

    solution: Solution
    """After the alignment."""
    estimate: People
    truth: ReferenceAt
    R_nb_true: FloatArray
    """Rotation body to navigation of the reference, shape (K, 3, 3); NaN where it does not know all three angles."""
    alignment: Alignment
    matched: BoolArray
    """Keyframes at which the reference knows the horizontal position or the heading, shape (K,)."""
    e_n: FloatArray
    """Position error in n, shape (K, 3), m."""
    e_depth: FloatArray
    """Depth error along the local vertical, shape (K,), m."""
    e_rph: FloatArray
    """Roll, pitch and heading error, shape (K, 3), rad."""


def compare(solution: Solution, reference: Reference, alignment: Alignment = "none") -> Comparison:
    """Match the reference to the keyframes by interpolation, align, and subtract."""
    truth = reference_at(reference, solution.origin, solution.t_ns)
    solution = align(solution, truth, alignment)
    estimate = people(solution)
    R_nb_true = R_n_local(solution.origin, estimate.lat, estimate.lon) @ matrix_from_rph(truth.rph)
    return Comparison(
        solution=solution,
        estimate=estimate,
        truth=truth,
        R_nb_true=R_nb_true,
        alignment=alignment,
        matched=truth.has_position | np.isfinite(truth.rph[:, 2]),
        e_n=solution.p_n - truth.p_n,
        e_depth=estimate.depth - truth.depth,
        e_rph=wrap_pi(estimate.rph - truth.rph),
    )


def metrics(solution: Solution, reference: Reference | None = None, alignment: Alignment = "none") -> dict[str, Any]:
    """Everything that ``metrics.json`` holds.

    Errors are estimate minus reference at the matched stamps, horizontal ones in n, depth along the local vertical,
    heading against local true north. NEES are divided by their degrees of freedom and averaged over the stamps, so
    that 1 is expected; ``nees_*_95`` is the 95 % interval of one run taken as one independent draw, since the errors
    along a dive are strongly correlated. An alignment uses up the reference, so NEES are then not given.
    """
    report: dict[str, Any] = {
        "keyframes": solution.info.get("keyframes", len(solution)),
        "duration_s": _duration(solution),
        "runtime_s": solution.info.get("runtime_s"),
        "sigma": sigma_summary(people(solution)),
    }
    if solution.closures is not None:
        accepted = int(solution.closures.accepted.sum())
        report |= {"closures_accepted": accepted, "closures_rejected": len(solution.closures) - accepted}
    if reference is not None and len(reference):
        report |= error_metrics(compare(solution, reference, alignment))
    return report


def error_metrics(comparison: Comparison, distances: Sequence[float] | None = None) -> dict[str, Any]:
    """The part of :func:`metrics` that needs a reference; ``rpe`` has a row for each of ``distances`` [m]."""
    c = comparison
    horizontal = np.hypot(c.e_n[:, 0], c.e_n[:, 1])
    seen = horizontal[np.isfinite(horizontal)]
    distance = path_length(c.truth.p_n[c.truth.has_position])
    final = float(seen[-1]) if len(seen) else None
    roll, pitch, heading = np.degrees(c.e_rph).T
    return {
        "alignment": c.alignment,
        "matched": int(c.matched.sum()),
        "total": len(c.matched),
        "distance_m": distance,
        "horizontal_rmse_m": rms(horizontal),
        "horizontal_max_m": float(seen.max()) if len(seen) else None,
        "final_error_m": final,
        "final_error_percent": percent(final, distance),
        **ate_metrics(c.e_n, distance),
        "depth_rmse_m": rms(c.e_depth),
        "roll_rmse_deg": rms(roll),
        "pitch_rmse_deg": rms(pitch),
        "heading_rmse_deg": rms(heading),
        "attitude_rmse_deg": rms(np.degrees(np.linalg.norm(attitude_error_b(c), axis=1))),
        **(nees_metrics(c) if c.alignment == "none" else {}),
        "rpe": relative_errors(c.solution.p_n, c.solution.R_nb, c.truth.p_n, c.R_nb_true, c.e_rph[:, 2], distances),
    }


def ate_metrics(e_n: FloatArray, distance: float) -> dict[str, Any]:
    """Absolute trajectory error: length of the position errors, shape (K, 3), in 3-D where heights are known.

    ``ate_dimensions`` tells whether it is 3, or 2 where the reference has no heights at all; ``ate_rmse_percent`` is
    of the ``distance`` travelled.
    """
    deep = known_rows(e_n).any()
    error = np.linalg.norm(e_n if deep else e_n[:, :2], axis=1)
    error = error[np.isfinite(error)]
    if len(error) == 0:
        return dict.fromkeys(
            ("ate_rmse_m", "ate_mean_m", "ate_median_m", "ate_max_m", "ate_rmse_percent", "ate_dimensions")
        )
    return {
        "ate_rmse_m": rms(error),
        "ate_mean_m": mean(error),
        "ate_median_m": float(np.median(error)),
        "ate_max_m": float(error.max()),
        "ate_rmse_percent": percent(rms(error), distance),
        "ate_dimensions": 3 if deep else 2,
    }


def nees_metrics(comparison: Comparison) -> dict[str, Any]:
    """Average NEES of position (3), heading (1) and attitude (3), each over its degrees of freedom."""
    c = comparison
    heading = nees(c.e_rph[:, 2:], c.estimate.cov_rph[:, 2:, 2:])
    return {
        "nees_position": mean(nees(c.e_n, c.estimate.cov_p_n)),
        "nees_heading": mean(heading),
        "nees_attitude": mean(nees(attitude_error_b(c), c.solution.cov_pose[:, :3, :3])),
        "nees_position_95": list(nees_bounds(3)),
        "nees_heading_95": list(nees_bounds(1)),
        "nees_attitude_95": list(nees_bounds(3)),
    }


def attitude_error_b(comparison: Comparison) -> FloatArray:
    """Rotation vector from the estimate to the reference in the body frame, shape (K, 3), rad: GTSAM's tangent."""
    R_nb, R_nb_true = comparison.solution.R_nb, comparison.R_nb_true
    out = np.full((len(R_nb), 3), np.nan)
    k = known_rows((R_nb + R_nb_true).reshape(-1, 9))
    if k.any():
        out[k] = Rotation.from_matrix(np.swapaxes(R_nb[k], -1, -2) @ R_nb_true[k]).as_rotvec()
    return out


def nees(error: FloatArray, cov: FloatArray) -> FloatArray:
    """Normalised estimation error squared over its degrees of freedom, shape (K,).

    NaN where either is not known or the covariance is not positive definite.
    """
    out = np.full(len(error), np.nan)
    k = known_rows(error) & known_rows(cov.reshape(len(cov), -1))
    k[k] = np.linalg.eigvalsh(cov[k])[:, 0] > 0.0
    if k.any():
        weighted = np.linalg.solve(cov[k], error[k][..., None])[..., 0]
        out[k] = np.sum(error[k] * weighted, axis=1) / error.shape[1]
    return out


def nees_bounds(dof: int, runs: int = 1, confidence: float = 0.95) -> tuple[float, float]:
    """Two-sided chi-square interval of the NEES (over ``dof``) averaged over independent runs.

    Bar-Shalom, Li & Kirubarajan 2001, section 5.4: the sum over the runs is chi-square with ``dof * runs`` degrees.
    """
    n = dof * runs
    tails = np.array([1.0 - confidence, 1.0 + confidence]) / 2.0
    low, high = chi2_quantile(tails, n) / n
    return float(low), float(high)


def sigma_summary(estimate: People) -> dict[str, Any]:
    """Median and final 1-sigma along north, east and down [m] and of roll, pitch and heading [deg]."""
    columns = np.hstack([sigmas(estimate.cov_p_n), np.degrees(sigmas(estimate.cov_rph))])
    names = ("north_m", "east_m", "down_m", "roll_deg", "pitch_deg", "heading_deg")
    if not np.isfinite(columns).any():
        return {}
    return {
        name: {"median": float(np.nanmedian(column)), "final": number(column[-1])}
        for name, column in zip(names, columns.T, strict=True)
    }


def path_length(p_n: FloatArray) -> float:
    """Length of the way through the points, in the plane if a height is missing, m."""
    steps = np.diff(p_n[:, np.isfinite(p_n).all(axis=0)], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def _duration(solution: Solution) -> float:
    return float(solution.t_ns[-1] - solution.t_ns[0]) * 1e-9 if len(solution) else 0.0
