"""What a contest says, in sentences: which estimator is best, by how much, and whose covariance is honest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from uwgraph.evaluate.entries import Contest, Entry
from uwgraph.evaluate.report_table import figure, outside, value_of

EQUAL = 0.01
"""Figures that differ by less than this share are called equal."""


def findings(contest: Contest) -> list[str]:
    """Sentences as plain text, the most wanted first."""
    if not contest.entries:
        return ["No estimator gave a result."]
    if all(value_of(entry.judged.metrics, name) is None for entry in contest.entries for name, *_ in RULERS):
        return [
            "The dive has no reference that reaches the estimates: nothing here says which estimator is right. Only "
            "what they state of themselves can be compared, and how their innovations behave."
        ]
    return [
        *(sentence for ruler in RULERS for sentence in _ranking(contest.entries, *ruler)),
        *_honesty(contest.entries),
    ]


RULERS = (
    ("horizontal_rmse_m", "horizontal RMSE", "m", "distance_m"),
    ("heading_rmse_deg", "heading RMSE", "deg", None),
)


def _ranking(entries: Sequence[Entry], name: str, words: str, unit: str, over: str | None) -> Iterator[str]:
    """Who is best, by how much, and who is last."""
    ranked = sorted(
        ((value, entry) for entry in entries if (value := value_of(entry.judged.metrics, name)) is not None),
        key=lambda pair: pair[0],
    )
    if not ranked:
        return
    (best, first), others = ranked[0], ranked[1:]
    way = value_of(first.judged.metrics, over) if over else None
    share = f" ({figure(100.0 * best / way, 2)} % of {figure(way)} m)" if way else ""
    if not others:
        yield f"{first.name}: {words} {figure(best)} {unit}{share}."
        return
    equal = [entry.name for value, entry in others if value <= best * (1.0 + EQUAL)]
    worse = [(value, entry) for value, entry in others if value > best * (1.0 + EQUAL)]
    winners = _listed([first.name, *equal])
    have = "have" if equal else "has"
    sentence = f"{winners} {have} the smallest {words}: {figure(best)} {unit}{share}"
    if worse:
        value, entry = worse[0]
        sentence += f", {100.0 * (1.0 - best / value):.0f} % below the next, {entry.name} ({figure(value)} {unit})"
    if len(worse) > 1:
        value, entry = worse[-1]
        sentence += f"; last is {entry.name} with {figure(value)} {unit}"
    yield sentence + "."


def _honesty(entries: Sequence[Entry]) -> Iterator[str]:
    """Whose NEES lie within their 95 % intervals, and who errs to which side."""
    honest, doubts, silent = [], [], []
    for entry in entries:
        known, off = _nees(entry.judged.metrics)
        if not known:
            silent.append(entry.name)
        elif off:
            doubts.append(f"{entry.name} ({', '.join(off)})")
        else:
            honest.append(entry.name)
    if honest:
        yield f"Position and heading errors agree with the stated covariance (NEES within 95 %): {_listed(honest)}."
    if doubts:
        yield f"NEES outside their 95 % interval: {'; '.join(doubts)}. One dive is one draw of such a figure."
    if silent:
        yield f"No NEES, for want of a covariance or because of an alignment: {_listed(silent)}."


def _nees(metrics: dict[str, Any]) -> tuple[bool, list[str]]:
    """Whether any is known, and those outside in words."""
    values = {of: value_of(metrics, f"nees_{of}") for of in ("position", "heading")}
    sides = {of: outside(value, metrics.get(f"nees_{of}_95")) for of, value in values.items()}
    words = {1: "errors larger than stated", -1: "smaller than stated"}
    off = [f"{of} {figure(values[of])}, {words[side]}" for of, side in sides.items() if side]
    return any(value is not None for value in values.values()), off


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
