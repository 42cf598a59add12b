"""One colour and one dash per estimator, the same in every picture of a contest.

Told apart with any colour vision (after Okabe & Ito 2008 and Tol 2021, darkened until thin lines stand out on white
and lightened on black); beyond the eighth they come again with other dashes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

LIGHT = ("#0072b2", "#c44e00", "#007a5a", "#a8327e", "#8f6b00", "#332288", "#99223a", "#2a8a9d")
DARK = ("#5cb8f2", "#ff9150", "#3ccf9f", "#f08fcb", "#e8c04a", "#b0a6ff", "#ff8a9a", "#7fdbe6")
DASHES = ("", "7 3", "2 3", "9 3 2 3")
USUAL = ("smooth", "aukf", "ukf", "eskf", "rts", "dr", "aeskf")
"""The estimators of ours keep their colours from one contest to the next."""


@dataclass(frozen=True)
class Look:
    """How an estimator is drawn."""

    colour: int
    """Index into :data:`LIGHT` and :data:`DARK`."""
    dash: str
    """Lengths on and off as in SVG, pixels; empty for a whole line."""


def looks(names: Sequence[str]) -> list[Look]:
    """A look for every name, no two alike among 32."""
    taken = {USUAL.index(name) for name in names if name in USUAL}
    free = (slot for slot in range(len(names) + len(USUAL)) if slot not in taken)
    slots = [USUAL.index(name) if name in USUAL else next(free) for name in names]
    colours = len(LIGHT)
    return [Look(slot % colours, DASHES[(slot + slot // colours) % len(DASHES)]) for slot in slots]
