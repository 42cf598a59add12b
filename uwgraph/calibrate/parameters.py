"""The numbers of a rig that a dive can tell: their names, units, and how wide they start.

Everything here is in the units of the rig file (degrees, metres, seconds), and a parameter adds to the rig's value.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from uwgraph.dive import Dive
from uwgraph.dive.rig import Positive, Rig, Settings
from uwgraph.errors import ConfigError

What = Literal["dvl", "clock", "mounting"]
RATE: Final = "clock_rate_ppm"
"""Not a value of the rig: it is reported, and a dive with a rate wants its stamps written anew."""


class Priors(Settings):
    """How far a freed value may be from where it starts, 1-sigma."""

    scale: Positive = 0.02
    rotation_deg: Positive = 5.0
    translation_m: Positive = 2.0
    time_offset_s: Positive = 0.5
    clock_rate_ppm: Positive = 1000.0


class Limits(Settings):
    """A value less certain than this (1-sigma) is of no use, however little was known before."""

    scale: Positive = 0.005
    rotation_deg: Positive = 0.5
    translation_m: Positive = 0.3
    time_offset_s: Positive = 0.1
    clock_rate_ppm: Positive = 200.0


UNITS: Final[Mapping[str, str]] = {
    "scale": "",
    "rotation_deg": "deg",
    "translation_m": "m",
    "time_offset_s": "s",
    RATE: "ppm",
}
AXES: Final[Mapping[str, Sequence[str]]] = {
    "rotation_deg": ("roll", "pitch", "yaw"),
    "translation_m": ("x", "y", "z"),
}
CAN: Final[Mapping[str, Sequence[str]]] = {
    "dvl": ("scale", "rotation_deg", "translation_m", "time_offset_s", RATE),
    "depth": ("translation_m", "time_offset_s", RATE),
    "fixes": ("translation_m", "time_offset_s", RATE),
    "reference": ("translation_m", "time_offset_s", RATE),
    "heading": ("rotation_deg", "time_offset_s", RATE),
    "sun": ("rotation_deg", "time_offset_s", RATE),
}
"""What the graph can tell of each sensor; the IMU is the body and has the clock."""
_CHOICES: Final[Mapping[What, Mapping[str, Sequence[str]]]] = {
    "dvl": {"dvl": ("scale", "rotation_deg", "translation_m", "time_offset_s")},
    "clock": dict.fromkeys(CAN, ("time_offset_s", RATE)),
    "mounting": {
        "depth": ("translation_m",),
        "fixes": ("translation_m",),
        "reference": ("translation_m",),
        "heading": ("rotation_deg",),
        "sun": ("rotation_deg",),
    },
}


@dataclass(frozen=True)
class Parameter:
    """One number of the rig."""

    sensor: str
    field: str
    """As in the rig."""
    index: int | None
    """Of the component of a vector."""
    prior: float
    """1-sigma about the start value."""
    limit: float = float("inf")
    """1-sigma above which it is of no use."""

    @property
    def name(self) -> str:
        """As in ``dvl.rotation_deg.yaw``."""
        axis = "" if self.index is None else f".{AXES[self.field][self.index]}"
        return f"{self.sensor}.{self.field}{axis}"

    @property
    def unit(self) -> str:
        return UNITS[self.field]

    @property
    def of_a_clock(self) -> bool:
        return self.field in ("time_offset_s", RATE)

    def value(self, rig: Rig) -> float:
        """What the rig says."""
        if self.field == RATE:
            return 0.0
        value = getattr(getattr(rig, self.sensor), self.field)
        return float(value if self.index is None else value[self.index])


def chosen(
    what: What | Iterable[str], dives: Sequence[Dive], replaced: Collection[str], priors: Priors, limits: Limits
) -> tuple[Parameter, ...]:
    """The parameters to free: of a choice, or named one by one as ``dvl.scale`` or ``depth.translation_m``.

    Parameters
    ----------
    dives
        Only sensors that one of them has are kept.
    replaced
        Streams whose place the reference takes, of which nothing is freed; where there are none, nothing of the
        reference is.

    Raises
    ------
    ConfigError
        For an unknown name, or when no sensor is left.
    """
    here = {name for dive in dives for name, _ in dive.streams()}
    wanted = _CHOICES[what].items() if isinstance(what, str) and what in _CHOICES else _named(what).items()  # type: ignore[index]
    silent = set(replaced) or {"reference"}
    free = [
        Parameter(sensor, field, index, getattr(priors, field), getattr(limits, field))
        for sensor, fields in wanted
        if sensor in here - silent
        for field in fields
        for index in _components(sensor, field)
    ]
    if not free:
        raise ConfigError(
            f"nothing of {what if isinstance(what, str) else ', '.join(what)} is in these dives",
            where="calibrate",
            remedy=f"the dives have {', '.join(sorted(here))}",
        )
    return tuple(free)


def leftovers(dives: Sequence[Dive], rig: Rig, freed: Sequence[Parameter], priors: Priors) -> tuple[Parameter, ...]:
    """What the rig itself does not know and nobody freed: it is estimated along, and not told.

    That is the DVL's scale and mounting, with the rig's own sigmas, and the lever arms of DVL and depth sensor where
    the rig has none: held at zero, a forgotten lever arm would go into a clock, with a small sigma.
    """
    taken = {(p.sensor, p.field) for p in freed}
    unknown = {("dvl", "scale"): rig.dvl.scale_sigma, ("dvl", "rotation_deg"): rig.dvl.misalignment_sigma_deg}
    for sensor in ("dvl", "depth"):
        if not getattr(rig, sensor).l_b.any():
            unknown[sensor, "translation_m"] = priors.translation_m
    return tuple(
        Parameter(sensor, field, index, sigma)
        for (sensor, field), sigma in unknown.items()
        if sigma > 0.0 and (sensor, field) not in taken and any(getattr(dive, sensor) is not None for dive in dives)
        for index in _components(sensor, field)
    )


def _named(names: str | Iterable[str]) -> Mapping[str, Sequence[str]]:
    found: dict[str, list[str]] = {}
    for name in [names] if isinstance(names, str) else names:
        sensor, _, field = name.partition(".")
        if field not in CAN.get(sensor, ()):
            known = ", ".join(f"{s}.{f}" for s, fields in CAN.items() for f in fields)
            raise ConfigError(f"{name!r} cannot be calibrated", where="calibrate", remedy=f"choose among {known}")
        found.setdefault(sensor, []).append(field)
    return found


def _components(sensor: str, field: str) -> Sequence[int | None]:
    if sensor == "heading" and field == "rotation_deg":
        return (2,)
    return range(3) if field in AXES else (None,)


def with_values(rig: Rig, parameters: Sequence[Parameter], values: Iterable[float]) -> Rig:
    """The rig with these values in place of its own; rates, which it does not hold, are left out."""
    parts: dict[str, Settings] = {}
    for p, value in zip(parameters, values, strict=True):
        if p.field == RATE:
            continue
        part = parts.get(p.sensor, getattr(rig, p.sensor))
        if p.index is None:
            new: float | tuple[float, ...] = float(value)
        else:
            old = getattr(part, p.field)
            new = (*old[: p.index], float(value), *old[p.index + 1 :])
        parts[p.sensor] = type(part).model_validate({**part.model_dump(), p.field: new})
    return rig.model_copy(update=parts)
