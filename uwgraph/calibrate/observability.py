"""What a motion does not show, in words, and which motion would."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uwgraph.calibrate.combine import TOLD, Combined, Unknowns
from uwgraph.calibrate.information import Information
from uwgraph.calibrate.parameters import AXES, RATE, Parameter
from uwgraph.types import BoolArray, FloatArray

LEAST: Final = TOLD**-2 - 1.0
"""Data information, in units of the prior's, at which the posterior sigma is ``TOLD`` of the prior's."""
SHARE: Final = 0.3
"""A number with less than this part in a direction is not named with it."""

_SENSORS: Final[Mapping[str, str]] = {
    "dvl": "DVL",
    "depth": "depth sensor",
    "fixes": "position fixes",
    "reference": "reference",
    "heading": "compass",
    "sun": "sun sensor",
}
_HINTS: Final[Mapping[str, str]] = {
    "dvl.scale": "position fixes some hundred metres apart, or changes of speed",
    "dvl.rotation_deg.roll": "motion sideways or up and down",
    "dvl.rotation_deg.pitch": "a depth sensor on straight legs, or climbs and descents",
    "dvl.rotation_deg.yaw": "position fixes on straight legs with a known heading, or turns and changes of speed",
    "dvl.translation_m.x": "turns to both sides",
    "dvl.translation_m.y": "turns to both sides",
    "dvl.translation_m.z": "changes of roll and pitch",
    "dvl": "turns to both sides and changes of speed",
    "depth.translation_m.x": "changes of pitch",
    "depth.translation_m.y": "changes of roll",
    "depth.translation_m.z": "position fixes with heights",
    "depth": "climbs and descents",
    "fixes.translation_m.z": "fixes with heights, and changes of roll and pitch",
    "fixes.translation_m": "turns while there are fixes",
    "fixes": "changes of speed and course while there are fixes",
    "heading.rotation_deg": "position fixes on straight legs with a DVL of known mounting, or the sun",
    "heading": "turns",
    "sun.rotation_deg": "several headings, position fixes on straight legs with a DVL of known mounting",
    "sun": "turns",
}


@dataclass(frozen=True)
class Unseen:
    """Numbers that the dives do not tell."""

    names: tuple[str, ...]
    """All of them alone, or only a combination of them is told."""
    text: str
    """Why they are left as they were, and what motion would show them."""


def in_words(p: Parameter) -> str:
    """As in ``the DVL's roll mounting``."""
    whose = f"the {_SENSORS[p.sensor]}'s"
    axis = "" if p.index is None else AXES[p.field][p.index]
    return {
        "scale": f"{whose} scale",
        "rotation_deg": f"{whose} {axis} mounting",
        "translation_m": f"{whose} lever arm {axis}",
        "time_offset_s": f"{whose} clock offset",
        RATE: f"{whose} clock rate",
    }[p.field]


def unseen(unknowns: Unknowns, names: Sequence[str], data: Information, found: Combined) -> tuple[Unseen, ...]:
    """What was refused, and why: not shown at all, only together with others, or too loosely to be of use.

    ``names`` are those of the unknowns. A direction of the unknowns is not told when its data information is below
    ``LEAST``, everything else that was freed being estimated.
    """
    free = np.isfinite(unknowns.limits)
    refused: list[int] = np.flatnonzero(free & ~found.told).tolist()
    if not refused:
        return ()
    S = np.zeros((len(unknowns), len(unknowns)))
    S[np.ix_(free, free)] = _of_the_freed(data, free)
    alone = [u for u in refused if S[u, u] < LEAST]
    statements = [_alone(unknowns, names, alone)] if alone else []
    rest: list[int] = np.setdiff1d(np.flatnonzero(free), alone).tolist()
    confounded: set[int] = set()
    values, vectors = np.linalg.eigh(S[np.ix_(np.array(rest), np.array(rest))])
    for value, vector in zip(values, vectors.T, strict=True):
        together = [u for u, part in zip(rest, np.abs(vector), strict=True) if part > SHARE]
        if value < LEAST and len(together) > 1 and not found.told[together].all():
            statements.append(_together(unknowns, names, together))
            confounded |= set(together)
    loose = [u for u in refused if u not in alone and u not in confounded]
    sigmas = found.sigma * unknowns.priors
    return (*statements, *(_loose(unknowns.parameters[u], names[u], float(sigmas[u])) for u in loose))


def _of_the_freed(data: Information, free: BoolArray) -> FloatArray:
    """Data information of what was freed, what is only estimated along integrated out with its prior."""
    along = np.flatnonzero(~free)
    f = np.flatnonzero(free)
    M = data.matrix[np.ix_(along, along)] + np.eye(len(along))
    cross = data.matrix[np.ix_(f, along)]
    S: FloatArray = data.matrix[np.ix_(f, f)] - cross @ np.linalg.solve(M, cross.T)
    return S


def _alone(unknowns: Unknowns, names: Sequence[str], which: Sequence[int]) -> Unseen:
    told = _list([in_words(unknowns.parameters[u]) + _of(unknowns, u, names) for u in which])
    return Unseen(tuple(names[u] for u in which), f"this motion does not show {told}: add {_hints(unknowns, which)}")


def _together(unknowns: Unknowns, names: Sequence[str], which: Sequence[int]) -> Unseen:
    told = _list([in_words(unknowns.parameters[u]) + _of(unknowns, u, names) for u in which])
    text = f"{told} move together, only a combination is told: add {_hints(unknowns, which)}"
    return Unseen(tuple(names[u] for u in which), text)


def _loose(p: Parameter, name: str, sigma: float) -> Unseen:
    text = f"{in_words(p)} is told to {sigma:.2g} {p.unit} only, {p.limit:g} would be of use: add {_hint(p.name)}"
    return Unseen((name,), text)


def _of(unknowns: Unknowns, which: int, names: Sequence[str]) -> str:
    return "" if unknowns.dive[which] is None else f" in {names[which].partition(': ')[0]}"


def _hints(unknowns: Unknowns, which: Sequence[int]) -> str:
    return "; ".join(dict.fromkeys(_hint(unknowns.parameters[u].name) for u in which))


def _hint(name: str) -> str:
    """The hint of the longest beginning of the name that has one; a reference's are those of fixes."""
    name = name.replace("reference.", "fixes.")
    while name not in _HINTS:
        name = name.rpartition(".")[0]
    return _HINTS[name]


def _list(items: Sequence[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
