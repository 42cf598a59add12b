"""The table of a contest: one row an estimator, the best of every column and the dishonest covariances marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from uwgraph.evaluate.entries import Contest, Entry
from uwgraph.evaluate.report_series import History, histories
from uwgraph.evaluate.statistics import number

ABSENT = "–"


def figure(value: float | None, digits: int = 3) -> str:
    """A number as people read it: three digits, no exponent where there need not be one."""
    if value is None or not np.isfinite(value):
        return ABSENT
    text = f"{value:.0f}" if abs(value) >= 10**digits else f"{value:#.{digits}g}".rstrip(".")
    return text.replace("-", "−", 1) if value < 0.0 else text


@dataclass(frozen=True)
class Cell:
    """One value of the table."""

    value: float | None
    text: str
    best: bool = False
    mark: str = ""
    """A sign that stands for :attr:`note`."""
    note: str = ""
    """In words, for who points at it or does not see it."""


@dataclass(frozen=True)
class Column:
    """One column of the table."""

    title: str
    """With its unit."""
    hint: str
    cells: list[Cell]


def columns(contest: Contest) -> list[Column]:
    """The columns in which at least one estimator has a value."""
    entries = contest.entries
    made = [
        _smallest(entries, "horizontal RMSE [m]", "ATE in the plane", "horizontal_rmse_m"),
        _smallest(entries, "ATE [m]", "in three dimensions, where depths are known", "ate_rmse_m"),
        _smallest(entries, "largest [m]", "largest horizontal error", "horizontal_max_m"),
        _smallest(entries, "final [m]", "horizontal error at the last matched pose", "final_error_m"),
        _smallest(entries, "final [% of way]", "the same over the distance travelled", "final_error_percent"),
        _smallest(entries, "depth RMSE [m]", "along the local vertical", "depth_rmse_m"),
        _smallest(entries, "heading RMSE [deg]", "against local true north", "heading_rmse_deg"),
        _smallest(entries, "attitude RMSE [deg]", "angle of the whole rotation", "attitude_rmse_deg"),
        _nees(entries, "position", "nees_position"),
        _nees(entries, "heading", "nees_heading"),
        *_sigmas(contest),
        *_nis(entries),
        _smallest(entries, "runtime [s]", "wall time", "runtime_s"),
        _smallest(entries, "memory [MB]", "at its largest", "memory_mb"),
    ]
    return [column for column in made if any(cell.value is not None for cell in column.cells)]


def table(contest: Contest, columns: Sequence[Column], swatches: Sequence[str]) -> str:
    """HTML: the first column names the estimator beside its ``swatch``."""
    heads = "".join(
        f'<th scope="col" title="{escape(column.hint)}"><button type="button">{escape(column.title)}'
        f'<span class="unseen"> ({escape(column.hint)}), sort</span></button></th>'
        for column in columns
    )
    rows = "".join(
        f'<tr><th scope="row">{swatch}{escape(entry.name)}<small>{escape(entry.title)}</small></th>'
        f"{''.join(_td(column.cells[row]) for column in columns)}</tr>"
        for row, (entry, swatch) in enumerate(zip(contest.entries, swatches, strict=True))
    )
    first = '<th scope="col"><button type="button">estimator<span class="unseen">, sort</span></button></th>'
    body = f'<table id="results"><thead><tr>{first}{heads}</tr></thead><tbody>{rows}</tbody></table>'
    return scrolling("table of figures", body)


MORE = "more columns: scroll sideways →"


def scrolling(label: str, table: str) -> str:
    """A box in which a wide table scrolls, by keys too; the script shows the hint while there is more to the right."""
    hint = f'<p class="hint small" aria-hidden="true">{MORE}</p>'
    return f'{hint}<div class="scroll" tabindex="0" role="region" aria-label="{label}">{table}</div>'


def _td(cell: Cell) -> str:
    value = "" if cell.value is None else f' data-value="{cell.value!r}"'
    kind = ' class="best"' if cell.best else ' class="doubt"' if cell.mark else ""
    mark = f' <span aria-hidden="true">{cell.mark}</span>' if cell.mark else ""
    note = f'<span class="unseen"> {escape(cell.note)}</span>' if cell.note else ""
    title = f' title="{escape(cell.note)}"' if cell.note else ""
    return f"<td{kind}{value}{title}>{escape(cell.text)}{mark}{note}</td>"


def value_of(metrics: Mapping[str, Any], name: str) -> float | None:
    """A metric as a number; None where it is missing or not finite."""
    value = metrics.get(name)
    return number(value) if isinstance(value, int | float) else None


def _smallest(entries: Sequence[Entry], title: str, hint: str, name: str) -> Column:
    return Column(title, hint, _best([value_of(entry.judged.metrics, name) for entry in entries]))


def _best(values: list[float | None]) -> list[Cell]:
    """Cells with the smallest value marked, and what looks equal to it; nothing where there is no choice."""
    known = [value for value in values if value is not None]
    least = figure(min(known)) if len(known) > 1 else None
    texts = [figure(value) for value in values]
    if len({text for text, value in zip(texts, values, strict=True) if value is not None}) < 2:
        least = None
    return [
        Cell(value, text, best=value is not None and text == least, note="best" if text == least else "")
        for value, text in zip(values, texts, strict=True)
    ]


def _nees(entries: Sequence[Entry], of: str, name: str) -> Column:
    bounds = next(
        (entry.judged.metrics[f"{name}_95"] for entry in entries if f"{name}_95" in entry.judged.metrics), None
    )
    cells = []
    for entry in entries:
        value = value_of(entry.judged.metrics, name)
        side = outside(value, bounds)
        cells.append(Cell(value, figure(value), mark=MARKS[side][0], note=MARKS[side][1]))
    within = f" ({max(bounds[0], 0.0):.1f} to {bounds[1]:.1f})" if bounds else ""
    return Column(
        f"NEES {of}{within}",
        "over its degrees of freedom; 1 is expected, in brackets the 95 % interval of one run",
        cells,
    )


MARKS = {0: ("", ""), 1: ("▲", "above: errors larger than stated"), -1: ("▼", "below: errors smaller than stated")}


def outside(value: float | None, bounds: Sequence[float] | None) -> int:
    """1 above the interval, -1 below, 0 within or not known."""
    if value is None or bounds is None:
        return 0
    return int(value > bounds[1]) - int(value < bounds[0])


def _sigmas(contest: Contest) -> list[Column]:
    """Without a reference the stated 1-sigma at the end are all there is to compare."""
    if any("horizontal_rmse_m" in entry.judged.metrics for entry in contest.entries):
        return []

    names = {"north_m": "[m]", "east_m": "[m]", "down_m": "[m]", "heading_deg": "[deg]"}
    return [
        Column(
            f"1-sigma {name.partition('_')[0]} {unit}",
            "as the estimator states it, at the end",
            [Cell(value, figure(value)) for value in (_final_sigma(entry, name) for entry in contest.entries)],
        )
        for name, unit in names.items()
    ]


def _final_sigma(entry: Entry, name: str) -> float | None:
    return value_of(entry.judged.metrics.get("sigma", {}).get(name, {}), "final")


def _nis(entries: Sequence[Entry]) -> list[Column]:
    per_entry = [{h.kind: h for h in histories(entry.innovations, 0)} for entry in entries]
    kinds = list(dict.fromkeys(kind for found in per_entry for kind in found))
    hint = "mean over the measurements used; 1 is expected"
    return [Column(f"NIS {kind}", hint, [_nis_cell(found.get(kind)) for found in per_entry]) for kind in kinds]


def _nis_cell(history: History | None) -> Cell:
    if history is None:
        return Cell(None, ABSENT)
    note = f"{history.refused} of {len(history.of)} refused" if history.refused else ""
    return Cell(history.mean_nis, figure(history.mean_nis), note=note)
