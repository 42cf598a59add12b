"""One picture of a dive: the track from above, and the errors inside their 3-sigma bands over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from uwgraph.evaluate.metrics import Comparison, compare, error_metrics
from uwgraph.evaluate.people import People, people, sigmas
from uwgraph.types import FloatArray, Reference, Solution

BLUE, GREY, BAND = "#1f5fa8", "#8a8a8a", "#c6d8ee"
PANELS = (("north [m]", 0), ("east [m]", 1), ("depth [m]", 2), ("heading [deg]", 3))


def track_plot(solution: Solution, reference: Reference | None, path: Path, title: str = "") -> None:
    """Write a PNG.

    With a reference: the errors (estimate minus reference) of north, east, depth and heading inside their 3-sigma
    bands. Without: the bands alone. The track carries 3-sigma ellipses, drawn to scale.
    """
    comparison = compare(solution, reference) if reference is not None and len(reference) else None
    _draw(solution, people(solution), comparison, path, title, "uwgraph")


def comparison_plot(comparison: Comparison, path: Path, title: str = "") -> None:
    """Write the same PNG of what has been compared already, after its alignment."""
    _draw(comparison.solution, comparison.estimate, comparison, path, title, "trajectory")


def _draw(solution: Solution, read: People, comparison: Comparison | None, path: Path, title: str, label: str) -> None:
    figure = Figure(figsize=(13, 7.5), layout="constrained")
    grid = figure.add_gridspec(len(PANELS), 2, width_ratios=(1.15, 1.0))
    _track(figure.add_subplot(grid[:, 0]), solution, read, comparison, label)
    panels = [figure.add_subplot(grid[row, 1]) for row in range(len(PANELS))]
    _errors(panels, solution, read, comparison)
    figure.align_ylabels(panels)
    figure.suptitle(_headline(title, comparison), x=0.01, ha="left", fontsize=11)
    figure.savefig(path, dpi=110)


def _track(axes: Axes, solution: Solution, read: People, comparison: Comparison | None, label: str) -> None:
    if comparison is not None:
        known = comparison.truth.p_n[comparison.truth.has_position]
        axes.plot(known[:, 1], known[:, 0], color=GREY, lw=3.0, alpha=0.6, label="reference")
    north, east = solution.p_n[:, 0], solution.p_n[:, 1]
    axes.plot(east, north, color=BLUE, lw=1.2, label=label)
    axes.plot(east[0], north[0], "o", color=BLUE, ms=7, label="start")
    axes.plot(east[-1], north[-1], "s", color=BLUE, ms=7, label="end")
    cov = read.cov_p_n[:, :2, :2]
    for k in np.linspace(0, len(solution) - 1, 13).astype(int):
        if np.isfinite(cov[k]).all():
            ellipse = axes.add_patch(_ellipse(solution.p_n[k], cov[k]))
            ellipse.set_label("3 sigma" if k == 0 else "")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="east [m]", ylabel="north [m]")
    axes.grid(alpha=0.3)
    axes.legend(loc="best", framealpha=0.9)


def _ellipse(p_n: FloatArray, cov: FloatArray) -> Ellipse:
    """3-sigma in the plane; the picture's x is east and its y is north."""
    variance, axis = np.linalg.eigh(cov)
    width, height = 6.0 * np.sqrt(np.maximum(variance, 0.0))
    angle = np.degrees(np.arctan2(axis[0, 0], axis[1, 0]))
    return Ellipse((p_n[1], p_n[0]), width, height, angle=angle, fill=False, ec="#d1603d", lw=1.0, zorder=3)


def _errors(panels: list[Axes], solution: Solution, read: People, comparison: Comparison | None) -> None:
    sigma = np.hstack([sigmas(read.cov_p_n), np.degrees(sigmas(read.cov_rph))[:, 2:]])
    error = np.full_like(sigma, np.nan)
    if comparison is not None:
        heading = np.degrees(comparison.e_rph[:, 2])
        error = np.column_stack([comparison.e_n[:, :2], comparison.e_depth, heading])
    minutes = (solution.t_ns - solution.t_ns[0]) * 1e-9 / 60.0
    for axes, (name, column) in zip(panels, PANELS, strict=True):
        band = 3.0 * sigma[:, column]
        axes.fill_between(minutes, -band, band, color=BAND, lw=0, label="3 sigma")
        axes.plot(minutes, error[:, column], color=BLUE, lw=0.9, label="error")
        axes.axhline(0.0, color="black", lw=0.5)
        _limits(axes, error[:, column], band)
        axes.set_ylabel(name)
        axes.set_xlim(0.0, max(minutes[-1], 1e-3))
        axes.grid(alpha=0.3)
        axes.tick_params(labelbottom=axes is panels[-1])
    panels[0].set_title("errors and 3 sigma" if comparison else "3 sigma (no reference)", fontsize=10)
    panels[0].legend(loc="upper right", ncols=2, fontsize=8, framealpha=0.9)
    panels[-1].set_xlabel("time [min]")


def _limits(axes: Axes, error: FloatArray, band: FloatArray) -> None:
    """The errors whole, and the band unless it is more than five times as wide (an unknown start)."""
    largest = np.abs(error[np.isfinite(error)]).max(initial=0.0)
    wide = band[np.isfinite(band)]
    top = float(np.quantile(wide, 0.98)) if len(wide) else 0.0
    limit = max(largest, min(top, 5.0 * largest) if largest > 0.0 else top)
    if limit > 0.0:
        axes.set_ylim(-1.15 * limit, 1.15 * limit)


def _headline(title: str, comparison: Comparison | None) -> str:
    if comparison is None:
        return title
    m = error_metrics(comparison)
    figures = [
        f"{label} {m[key]:.3g} {unit}"
        for label, key, unit in (
            ("horizontal RMSE", "horizontal_rmse_m", "m"),
            ("depth", "depth_rmse_m", "m"),
            ("heading", "heading_rmse_deg", "deg"),
        )
        if m[key] is not None
    ]
    return "   ".join([title, *figures, f"over {m['distance_m']:.0f} m"]).strip()
