"""Pictures of a contest: tracks, errors, innovations and believed noise, each estimator in one look throughout."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uwgraph.atomic import atomic_file
from uwgraph.evaluate.entries import Contest
from uwgraph.evaluate.report_colours import LIGHT, Look, looks
from uwgraph.evaluate.report_series import Course, History, courses, evenly, frame, histories, reach, start_ns

GREY = "#8a8a8a"
PANELS = (("north [m]", 0), ("east [m]", 1), ("depth [m]", 2), ("heading [deg]", 3))
DOTS = 4000
"""Drawn of a sensor's innovations, at most."""

Style = dict[str, Any]
Told = list[dict[str, History]]
"""The history of every sensor, for every entry."""


def contest_plots(contest: Contest, folder: Path) -> list[Path]:
    """Write ``track.png`` and ``errors.png``, and ``innovations.png`` and ``noise.png`` where a filter tells of them.

    Returns the files written; none where no estimator gave a result.

    Raises
    ------
    DataError
        When a picture cannot be written.
    """
    if not contest.entries:
        return []
    runs, names = courses(contest), [_plain(entry.name) for entry in contest.entries]
    styles = [_style(look) for look in looks([entry.name for entry in contest.entries])]
    told: Told = [{h.kind: h for h in histories(entry.innovations, start_ns(contest))} for entry in contest.entries]
    pictures = {"track.png": _tracks(runs, names, styles), "errors.png": _errors(runs, names, styles)}
    if any(told):
        pictures["innovations.png"] = _innovations(told, names, styles)
        pictures["noise.png"] = _noise(told, names, styles)
    for name, picture in pictures.items():
        picture.suptitle(_plain(contest.title), x=0.01, ha="left", fontsize=11)
        with atomic_file(folder / name) as partial:
            picture.savefig(partial, dpi=110, format="png")
    return [folder / name for name in pictures]


def _style(look: Look) -> Style:
    lengths = [float(length) / 1.5 for length in look.dash.split()]
    return {"color": LIGHT[look.colour], "ls": (0, lengths) if lengths else "-"}


def _plain(text: str) -> str:
    """Text in which matplotlib must not see mathematics."""
    return text.replace("$", r"\$")


def _tracks(runs: Sequence[Course], names: Sequence[str], styles: Sequence[Style]) -> Figure:
    picture = Figure(figsize=(9, 7.5), layout="constrained")
    axes = picture.add_subplot()
    comparison = next((run.comparison for run in runs if run.comparison is not None), None)
    if comparison is not None:
        known = comparison.truth.p_n[comparison.truth.has_position]
        axes.plot(known[:, 1], known[:, 0], color=GREY, lw=4.0, alpha=0.5, label="reference")
    for run, name, style in zip(runs, names, styles, strict=True):
        north, east = run.solution.p_n[:, 0], run.solution.p_n[:, 1]
        axes.plot(east, north, lw=1.3, label=name, **style)
        axes.plot(east[:1], north[:1], "o", color=style["color"], ms=6)
        axes.plot(east[-1:], north[-1:], "s", color=style["color"], ms=6)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="east [m]", ylabel="north [m]", title="circle: start, square: end")
    axes.grid(alpha=0.3)
    axes.legend(loc="best", framealpha=0.9)
    return picture


def _errors(runs: Sequence[Course], names: Sequence[str], styles: Sequence[Style]) -> Figure:
    """Errors in their 3-sigma bands; without a reference the bands alone."""
    picture = Figure(figsize=(12, 9), layout="constrained")
    panels: Sequence[Axes] = picture.subplots(len(PANELS), 1, sharex=True)
    judged = any(run.comparison is not None for run in runs)
    for axes, (label, column) in zip(panels, PANELS, strict=True):
        for run, name, style in zip(runs, names, styles, strict=True):
            minutes, band = run.t_s / 60.0, 3.0 * run.sigma[:, column]
            axes.fill_between(minutes, -band, band, color=style["color"], alpha=0.08, lw=0)
            for edge in (-band, band):
                axes.plot(minutes, edge, color=style["color"], alpha=0.4, lw=0.6)
            axes.plot(minutes, run.error[:, column], lw=1.2, label=name, **style)
        limit = 1.1 * frame([reach(run, column) for run in runs])
        axes.axhline(0.0, color="black", lw=0.5)
        axes.set(ylabel=label, ylim=(-limit, limit))
        axes.set_title(_beyond(runs, names, column, limit), loc="right", fontsize=8)
        axes.grid(alpha=0.3)
    panels[0].set_title("errors and 3 sigma" if judged else "3 sigma (no reference)", loc="left", fontsize=10)
    _key(picture, names, styles)
    panels[-1].set_xlabel("time [min]")
    picture.align_ylabels(panels)
    return picture


def _beyond(runs: Sequence[Course], names: Sequence[str], column: int, limit: float) -> str:
    largest = [float(np.nanmax(np.abs(run.error[:, column]), initial=0.0)) for run in runs]
    away = [f"{name} (up to {most:.3g})" for name, most in zip(names, largest, strict=True) if most > limit]
    return f"beyond the frame: {', '.join(away)}" if away else ""


def _innovations(told: Told, names: Sequence[str], styles: Sequence[Style]) -> Figure:
    """A row a sensor: for every filter its innovations in stated sigmas, and last the running NIS of all."""
    kinds, filters = _kinds(told), [i for i, mine in enumerate(told) if mine]
    columns = len(filters) + 1
    picture = Figure(figsize=(3.2 * columns + 1.0, 2.3 * len(kinds) + 1.1), layout="constrained")
    grid = picture.subplots(len(kinds), columns, squeeze=False, sharex=True)
    for row, kind in zip(grid, kinds, strict=True):
        for axes, i in zip(row, filters, strict=False):
            history = told[i].get(kind)
            if history is None:
                _nothing(axes)
            else:
                _dots(axes, history, styles[i])
            axes.set_title(f"{names[i]}: {_plain(kind)}", loc="left", fontsize=9)
        for i in filters:
            history = told[i].get(kind)
            if history is not None and history.running is not None:
                row[-1].semilogy(history.running.t_s / 60.0, history.running.nis, lw=1.0, **styles[i])
                for bound in history.running.bounds:
                    row[-1].axhline(bound, color=GREY, lw=0.7, ls=":")
        row[-1].set_title(f"running NIS: {_plain(kind)}", fontsize=9)
        row[-1].yaxis.set_major_formatter("{x:g}")
        row[-1].yaxis.set_minor_formatter("{x:g}")
        row[0].set_ylabel("stated sigmas")
    for axes in grid[-1]:
        axes.set_xlabel("time [min]")
    _key(picture, [names[i] for i in filters], [styles[i] for i in filters])
    return picture


def _nothing(axes: Axes) -> None:
    """A filter that compares nothing with this sensor (one is driven by it); its time axis stays for those above."""
    axes.set_yticks([])
    axes.text(0.5, 0.5, "no innovations", transform=axes.transAxes, ha="center", va="center", color=GREY, size=9)


def _dots(axes: Axes, history: History, style: Style) -> None:
    """Innovations inside a frame that a few wild ones do not set; refused ones are crosses, at its edge if need be."""
    rows = evenly(len(history.of), DOTS)
    whitened, used = history.of.whitened[rows, : history.axes], history.of.accepted[rows]
    size = np.abs(whitened[used])
    limit = max(4.0, float(np.quantile(size[np.isfinite(size)], 0.995))) if np.isfinite(size).any() else 4.0
    minutes = history.t_s[rows] / 60.0
    for value in np.clip(whitened, -limit, limit).T:
        axes.plot(minutes[used], value[used], ".", ms=2, alpha=0.6, color=style["color"])
        axes.plot(minutes[~used], value[~used], "x", ms=4, mew=0.7, alpha=0.5, color="black")
    for bound in (-3.0, 3.0):
        axes.axhline(bound, color=GREY, lw=0.8, ls="--")
    axes.set_ylim(-1.1 * limit, 1.1 * limit)
    axes.text(
        0.99, 0.03, f"{history.refused} of {len(history.of)} refused", transform=axes.transAxes, ha="right", size=7
    )


def _noise(told: Told, names: Sequence[str], styles: Sequence[Style]) -> Figure:
    """A row a sensor: the 1-sigma that the filters believed over the stated one; and last the fading factor."""
    kinds = _kinds(told)
    picture = Figure(figsize=(11, 1.9 * (len(kinds) + 1) + 1.1), layout="constrained")
    panels: Sequence[Axes] = picture.subplots(len(kinds) + 1, 1, sharex=True)
    for axes, kind in zip(panels, kinds, strict=False):
        for mine, style in zip(told, styles, strict=True):
            if kind in mine:
                minutes, noise = mine[kind].t_s / 60.0, mine[kind].of.noise[:, : mine[kind].axes]
                axes.plot(minutes, noise, lw=1.1, **style)
        axes.set_title(f"{_plain(kind)}: believed over stated sigma, each axis", loc="left", fontsize=9)
    for mine, style in zip(told, styles, strict=True):
        for history in mine.values():
            panels[-1].plot(history.t_s / 60.0, history.of.fading, lw=0.8, **style)
    panels[-1].set_title("fading factor of the predicted covariance", loc="left", fontsize=9)
    panels[-1].set_xlabel("time [min]")
    for axes in panels:
        axes.grid(alpha=0.3)
    filters = [i for i, mine in enumerate(told) if mine]
    _key(picture, [names[i] for i in filters], [styles[i] for i in filters])
    return picture


def _kinds(told: Told) -> list[str]:
    return list(dict.fromkeys(kind for mine in told for kind in mine))


def _key(picture: Figure, names: Sequence[str], styles: Sequence[Style]) -> None:
    """All that are drawn in a picture, above its panels: in none of these need all of them be."""
    lines = [Line2D([], [], lw=1.5, **style) for style in styles]
    picture.legend(lines, names, loc="outside upper right", ncols=6, fontsize=8, frameon=False)
