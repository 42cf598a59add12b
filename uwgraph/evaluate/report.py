"""``report.html``: a contest of estimators on one self-contained page.

The drawings are SVG made by 700 lines of script of our own (``page/``), not by a plotting library: plotly's
script alone is 4.8 MB, keeps fingers from scrolling past a figure, and knows neither the reader's dark mode nor print.
Here colours are the style sheet's, paper gets vectors, and a page is as large as its data. The policy in its head
allows the page's own script and style by their hashes and nothing else, and no network at all.
"""

from __future__ import annotations

import hashlib
import json
from base64 import b64encode
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from uwgraph.atomic import atomic_file
from uwgraph.evaluate.entries import Contest, Entry
from uwgraph.evaluate.report_colours import DARK, LIGHT, Look, looks
from uwgraph.evaluate.report_data import page_data
from uwgraph.evaluate.report_directions import Directions, directions
from uwgraph.evaluate.report_findings import findings
from uwgraph.evaluate.report_series import Course, courses
from uwgraph.evaluate.report_table import columns, figure, scrolling, table, value_of
from uwgraph.evaluate.report_words import about, legend, simulated, summary, track_key
from uwgraph.evaluate.statistics import mean, rms


def write_report(contest: Contest, path: Path) -> None:
    """Write the page.

    Raises
    ------
    DataError
        When it cannot be written; nothing is left behind.
    """
    page = report_page(contest)
    with atomic_file(path) as partial:
        partial.write_text(page, encoding="utf-8")


def report_page(contest: Contest) -> str:
    """The page's HTML."""
    runs = courses(contest)
    found = directions(contest)
    style = _file("report.css") + _palette()
    script = "\n".join(_file(name) for name in ("chart.js", "map.js", "report.js"))
    drawn = looks([entry.name for entry in contest.entries])
    shown = columns(contest)
    return Template(_file("report.html")).substitute(
        policy=_policy(style, script),
        title=escape(contest.title),
        style=style,
        script=script,
        detail=escape(_detail(contest)),
        lead=escape(summary(contest)),
        findings='<ul class="findings">' + "".join(f"<li>{escape(text)}</li>" for text in findings(contest)) + "</ul>",
        simulated="".join(f'<p class="simulated">{escape(text)}</p>' for text in simulated(contest)),
        table=table(contest, shown, [_swatch(look) for look in drawn]) if contest.entries else "",
        legend=escape(legend(contest)),
        failed=_failed(contest),
        drawings=_drawings(contest, runs, found, drawn) if contest.entries else "",
        about="".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in about(contest)),
        data=_embedded(page_data(contest, runs, found)),
    )


def _file(name: str) -> str:
    return (files("uwgraph.evaluate") / "page" / name).read_text(encoding="utf-8")


def _palette() -> str:
    """Colours of the estimators: lighter on a dark screen, and the darker ones again on paper."""

    def variables(colours: Sequence[str]) -> str:
        return ":root { " + " ".join(f"--c{i}: {colour};" for i, colour in enumerate(colours)) + " }\n"

    classes = "".join(f".c{i} {{ --c: var(--c{i}); }}\n" for i in range(len(LIGHT)))
    return f"{variables(LIGHT)}@media screen and (prefers-color-scheme: dark) {{ {variables(DARK)} }}\n{classes}"


def _policy(style: str, script: str) -> str:
    """Nothing but the page's own style and script, and no network."""

    def hashed(text: str) -> str:
        return f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

    return (
        f"default-src 'none'; style-src {hashed(style)}; script-src {hashed(script)}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def _embedded(data: dict[str, Any]) -> str:
    """JSON that cannot end its script element."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    return text.replace("<", "\\u003c")


def _detail(contest: Contest) -> str:
    """Whose ellipses and innovations are shown first: the best."""

    def error(entry: Entry) -> float:
        value = value_of(entry.judged.metrics, "horizontal_rmse_m")
        return float("inf") if value is None else value

    return min(contest.entries, key=error).name if contest.entries else ""


def _swatch(look: Look) -> str:
    return (
        '<svg class="swatch" viewBox="0 0 28 12" aria-hidden="true">'
        f'<path class="line strong c{look.colour}" d="M1 6h26" stroke-dasharray="{look.dash or "none"}"/></svg>'
    )


def _failed(contest: Contest) -> str:
    if not contest.failed:
        return ""
    rows = "".join(f"<li><b>{escape(name)}</b>: {escape(str(why))}</li>" for name, why in contest.failed.items())
    return f"<h3>Gave no result</h3><ul>{rows}</ul>"


def _drawings(contest: Contest, runs: Sequence[Course], found: Sequence[Directions], drawn: Sequence[Look]) -> str:
    """The sections that the script fills; those without content say why."""
    judged = any(run.comparison is not None for run in runs)
    tells = any(entry.innovations is not None and len(entry.innovations) for entry in contest.entries)
    key = "".join(
        f"<span>{_swatch(look)}{escape(entry.name)}</span>" for entry, look in zip(contest.entries, drawn, strict=True)
    )
    return Template(_file("drawings.html")).substitute(
        key=key,
        track=escape(track_key(contest)),
        errors_title="Errors over time" if judged else "Stated uncertainty over time",
        errors_text=ERRORS if judged else SIGMAS,
        innovations=_filled("innovations", INNOVATIONS) if tells else f"<p>{NO_INNOVATIONS}</p>",
        directions=_filled("directions", DIRECTIONS, _direction_table(contest, found, drawn))
        if found
        else f"<p>{NO_DIRECTIONS}</p>",
        sizes=SIZES if judged else "",
    )


ERRORS = "Estimate less reference, inside bands of 3-sigma."
SIGMAS = "The dive has no reference: drawn are the 1-sigma that the estimators state."
INNOVATIONS = (
    "Prediction less measurement, in sigmas that the rig or the log states, of the estimator in detail (or the next "
    "that has any); running NIS, believed noise and fading factor of all that are shown."
)
NO_INNOVATIONS = "None of these estimators tells its innovations."
DIRECTIONS = (
    "The errors of the estimates as the sensor sees them, its own noise included: the measured sun, turned by the "
    "estimate's attitude, less the almanac's; the estimated heading less the measured one. Dashed: 3-sigma stated for "
    "the sensor."
)
NO_DIRECTIONS = "The dive has neither usable sun observations nor headings."
SIZES = '<section><h2>Errors by size and distance</h2><div id="sizes" class="row"></div></section>'


def _filled(name: str, words: str, table: str = "") -> str:
    """A place that the script fills, below its explanation."""
    return f'<p class="small">{words}</p>{table}<div id="{name}"></div>'


def _direction_table(contest: Contest, found: Sequence[Directions], drawn: Sequence[Look]) -> str:
    """Mean and RMS of all residuals of every estimator."""
    heads = "".join(
        f'<th scope="col">{escape(each.name)}: mean, RMS [deg]'
        f"{f' (stated 1-sigma {figure(each.sigma_deg, 2)})' if each.sigma_deg else ''}</th>"
        for each in found
    )
    rows = "".join(
        f'<tr><th scope="row">{_swatch(look)}{escape(entry.name)}</th>'
        + "".join(
            f"<td>{figure(mean(each.residual_deg[i]))}, {figure(rms(each.residual_deg[i]))}</td>" for each in found
        )
        + "</tr>"
        for i, (entry, look) in enumerate(zip(contest.entries, drawn, strict=True))
    )
    head = f'<thead><tr><th scope="col">estimator</th>{heads}</tr></thead>'
    return scrolling("table of residuals", f'<table class="plain">{head}<tbody>{rows}</tbody></table>')
