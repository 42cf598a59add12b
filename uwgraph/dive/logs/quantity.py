"""A number of a log, by name, sign and unit: ``-acc_y [mg]``.

The unit in brackets says what the log has; without it the field is in SI. Whatever it is, ``scale`` brings it to SI
(angles to radians, temperatures are not used).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Annotated, Any, Final

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

STANDARD_GRAVITY: Final = 9.80665

UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "acceleration": {
        "m/s^2": 1.0, "cm/s^2": 0.01, "mm/s^2": 1e-3, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY * 1e-3,
        "mGal": 1e-5,
    },
    "rate": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": pi / 180, "deg/h": pi / 180 / 3600, "cdeg/s": pi / 18000},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": pi / 180, "cdeg": pi / 18000, "degE7": pi / 180e7, "degE5": pi / 180e5},
    "speed": {"m/s": 1.0, "cm/s": 0.01, "mm/s": 1e-3, "km/h": 1 / 3.6, "kn": 1852 / 3600},
    "length": {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "km": 1e3, "ft": 0.3048},
    "pressure": {"Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "kPa": 1e3, "bar": 1e5, "dbar": 1e4, "psi": 6894.757293168},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "speed^2": {"m^2/s^2": 1.0, "cm^2/s^2": 1e-4, "mm^2/s^2": 1e-6},
    "length^2": {"m^2": 1.0, "cm^2": 1e-4, "mm^2": 1e-6},
    "field": {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "G": 1e-4, "mG": 1e-7},
    "number": {"1": 1.0},
}  # fmt: skip
"""For every dimension its units, the SI one first, and what brings them to SI."""

_TEXT: Final = re.compile(r"\s*(?P<sign>-?)\s*(?P<path>[^\s\[\]-].*?)(?:\s+\[(?P<unit>[^\[\]]*)\])?\s*")


@dataclass(frozen=True)
class Quantity:
    """A field of a message, and what brings it to SI."""

    path: str
    """``linear_acceleration.x``, ``data[3]``, the name of a column (which may have its unit in its name: the column
    ``ACC X [g]`` answers to ``ACC X [g]`` alone)."""
    unit: str
    scale: float
    """Sign included."""

    def __str__(self) -> str:
        return f"{'-' if self.scale < 0 else ''}{self.path} [{self.unit}]"


def quantity(text: Any, dimension: str) -> Quantity:
    """The quantity of ``text``; raises ValueError where it is none, or the unit is not of that dimension."""
    if isinstance(text, Quantity):
        return text
    found = _TEXT.fullmatch(text) if isinstance(text, str) else None
    if found is None:
        raise ValueError("is no field of a log: write a name, such as 'acc_x' or '-acc_x [mg]'")
    units = UNITS[dimension]
    unit = found["unit"].strip() if found["unit"] is not None else next(iter(units))
    if unit not in units:
        raise ValueError(f"{unit!r} is no unit of {dimension}; known units: {', '.join(units)}")
    return Quantity(found["path"], unit, -units[unit] if found["sign"] else units[unit])


@dataclass(frozen=True)
class _Of:
    """Reads a quantity of one dimension from text, and writes it back."""

    dimension: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            lambda text: quantity(text, self.dimension),
            serialization=core_schema.plain_serializer_function_ser_schema(str),
        )


Acceleration = Annotated[Quantity, _Of("acceleration")]
Rate = Annotated[Quantity, _Of("rate")]
Angle = Annotated[Quantity, _Of("angle")]
Speed = Annotated[Quantity, _Of("speed")]
Length = Annotated[Quantity, _Of("length")]
Pressure = Annotated[Quantity, _Of("pressure")]
Seconds = Annotated[Quantity, _Of("time")]
SpeedVariance = Annotated[Quantity, _Of("speed^2")]
LengthVariance = Annotated[Quantity, _Of("length^2")]
Field = Annotated[Quantity, _Of("field")]
Number = Annotated[Quantity, _Of("number")]
