"""How each stream lies in its file: which columns, in which units, and what stands in for those left out.

Angles are degrees in files and radians in memory; symmetric matrices are stored as their upper triangle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any, Final

import gsw
import numpy as np
from numpy.typing import NDArray

from uwgraph.dive.model import STREAM_TYPES
from uwgraph.dive.tables import Column, Kind, Table
from uwgraph.errors import DataError
from uwgraph.types import FloatArray, Images, Origin, Stream, stream_fields


def full_from_upper(upper: NDArray[Any]) -> NDArray[Any]:
    """Symmetric matrices, shape (N, n, n), of their upper triangles row by row, shape (N, n (n + 1) / 2)."""
    n = triangle_order(upper.shape[1])
    full = np.empty((len(upper), n, n), dtype=upper.dtype)
    i, j = np.triu_indices(n)
    full[:, i, j] = full[:, j, i] = upper
    return full


def triangle_order(count: int) -> int:
    """n of a triangle of n (n + 1) / 2 elements; 0 where that is none of a matrix."""
    return {6: 3, 21: 6}.get(count, 0)


@dataclass(frozen=True)
class Field:
    """The columns of one field: 1 for a scalar, 3 for a vector, 6 or 21 for the triangle of a symmetric matrix."""

    columns: tuple[str, ...]
    kind: Kind = "float"
    degrees: bool = False
    default: Any = None
    """What stands in for columns that are not there; None: they must be."""

    def read(self, table: Table) -> NDArray[Any]:
        """The field, shape (N,), (N, 3), (N, 3, 3) or (N, 6, 6), of the columns of a file."""
        count = len(table["t_ns"])
        parts = [table[c] if c in table else np.full(count, self.default) for c in self.columns]
        array = parts[0] if len(parts) == 1 else np.stack(parts, axis=-1)
        if triangle_order(len(parts)):
            array = full_from_upper(array)
        return np.radians(array) if self.degrees else array

    def write(self, array: NDArray[Any]) -> Table:
        """The columns of a file of the field."""
        array = np.degrees(array) if self.degrees else array
        if n := triangle_order(len(self.columns)):
            array = array[:, *np.triu_indices(n)]
        return dict(zip(self.columns, array.reshape(len(array), -1).T, strict=True))


def _vector(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{axis}" for axis in "xyz")


def _symmetric(name: str, axes: Sequence[str] = "xyz") -> tuple[str, ...]:
    return tuple(f"{name}_{a}{b}" for a, b in combinations_with_replacement(axes, 2))


_STAMPS: Final = {"t_ns": Field(("t_ns",), "int")}
_PLACE: Final = {
    "lat": Field(("lat_deg",), degrees=True),
    "lon": Field(("lon_deg",), degrees=True),
    "height": Field(("height",), default=np.nan),
}
_RELATIVE: Final = {
    "from_ns": Field(("from_ns",), "int"),
    "p": Field(_vector("p")),
    "rotvec": Field(tuple(f"{name}_deg" for name in _vector("rot")), degrees=True),
    "cov": Field(_symmetric("cov", ("rx", "ry", "rz", "px", "py", "pz"))),
    "accepted": Field(("accepted",), "bool", default=True),
    "reason": Field(("reason",), "text", default=""),
    "inliers": Field(("inliers",), "int", default=0),
}
_UNKNOWN: Final[Mapping[str, Any]] = {"degrees": True, "default": np.nan}

LAYOUT: Final[Mapping[str, Mapping[str, Field]]] = {
    "imu": _STAMPS | {"f_s": Field(_vector("f")), "w_s": Field(_vector("w"))},
    "dvl": _STAMPS
    | {
        "v_s": Field(_vector("v")),
        "cov_s": Field(_symmetric("cov"), default=np.nan),
        "valid": Field(("valid",), "bool", default=True),
    },
    "depth": _STAMPS | {"depth": Field(("depth",)), "sigma": Field(("sigma",), default=np.nan)},
    "fixes": _STAMPS
    | _PLACE
    | {
        "cov_n": Field(_symmetric("cov", "ned"), default=np.nan),
        "source": Field(("source",), "text", default="unknown"),
    },
    "heading": _STAMPS
    | {
        "heading": Field(("heading_deg",), degrees=True),
        "sigma": Field(("sigma_deg",), **_UNKNOWN),
        "reference": Field(("reference",), "text"),
    },
    "sun": _STAMPS
    | {
        "information_b": Field(_symmetric("info")),
        "s_b": Field(_vector("s")),
        "cov_b": Field(_symmetric("cov"), default=np.nan),
        "method": Field(("method",), "text", default="unknown"),
        "quality": Field(("quality",), default=1.0),
        "flags": Field(("flags",), "int", default=0),
    },
    "gravity": _STAMPS | {"value": Field(("gravity",)), "sigma": Field(("sigma",))},
    "altitude": _STAMPS | {"altitude": Field(("altitude",)), "sigma": Field(("sigma",), default=np.nan)},
    "odometry": _STAMPS | _RELATIVE,
    "closures": _STAMPS | _RELATIVE,
    "reference": _STAMPS
    | {
        "lat": Field(("lat_deg",), **_UNKNOWN),
        "lon": Field(("lon_deg",), **_UNKNOWN),
        "height": Field(("height",), default=np.nan),
        "rph": Field(("roll_deg", "pitch_deg", "heading_deg"), **_UNKNOWN),
        "v_n": Field(("v_n", "v_e", "v_d"), default=np.nan),
    },
    "images": _STAMPS | {"file": Field(("file",), "text")},
}
"""Stream, then field, then its columns."""

_TYPES: Final[Mapping[str, type[Stream]]] = {**STREAM_TYPES, "images": Images}

ALTERNATIVES: Final[Mapping[str, tuple[str, str]]] = {"depth": ("depth", "pressure"), "gravity": ("gravity", "anomaly")}
"""Streams whose value comes in one of two columns."""


def stream_columns(name: str) -> dict[str, Column]:
    """The columns that the file of a stream may or must have."""
    columns = {
        column: Column(field.kind, required=field.default is None)
        for field in LAYOUT[name].values()
        for column in field.columns
    }
    either = ALTERNATIVES.get(name, ())
    return columns | {column: Column(required=False) for column in either}


def stream_from_table(name: str, table: Table, origin: Origin, where: str, camera: str = "") -> Stream:
    """The stream of a file's columns.

    Raises
    ------
    DataError
        When columns that belong together are not all there, or both or neither of two alternatives are.
    """
    _check_groups(name, table, where)
    scalars: dict[str, str] = {}
    if name == "depth" and "pressure" in table:
        table = table | {"depth": depth_from_pressure(table["pressure"], origin.lat)}
    if name == "gravity":
        scalars["kind"] = "anomaly" if "anomaly" in table else "gravity"
        table = table | {"gravity": table[scalars["kind"]]}
    if name == "heading":
        scalars["reference"] = _single(table["reference"], f"{where}: reference")
    if name == "images":
        scalars["camera"] = camera
    arrays = {key: field.read(table) for key, field in LAYOUT[name].items() if key not in scalars}
    make: Any = _TYPES[name]
    stream: Stream = make(**arrays, **scalars)
    return stream


def table_from_stream(name: str, stream: Stream) -> Table:
    """The columns of a stream's file."""
    table: Table = {}
    for key, array in stream_fields(stream):
        table |= LAYOUT[name][key].write(array)
    if name == "gravity":
        table[getattr(stream, "kind")] = table.pop("gravity")  # noqa: B009
    if name == "heading":
        table["reference"] = np.full(len(stream), getattr(stream, "reference"))  # noqa: B009
    return table


def depth_from_pressure(pressure: FloatArray, lat: float) -> FloatArray:
    """Depth [m] of sea pressure [Pa, zero at the surface] at a latitude [rad], TEOS-10; NaN where there is none."""
    with np.errstate(invalid="ignore", over="ignore"):
        return -np.asarray(gsw.z_from_p(pressure * 1e-4, np.degrees(lat)), dtype=np.float64)


def _check_groups(name: str, table: Table, where: str) -> None:
    either = ALTERNATIVES.get(name, ())
    if either and sum(column in table for column in either) != 1:
        raise DataError(
            f"needs exactly one of the columns {' and '.join(either)}",
            where=where,
            remedy=f"write {either[0]} or {either[1]}",
        )
    for field in LAYOUT[name].values():
        there = [column for column in field.columns if column in table]
        if triangle_order(len(field.columns)) and 0 < len(there) < len(field.columns):
            missing = next(column for column in field.columns if column not in table)
            raise DataError(
                f"column {missing!r} is missing beside {there[0]!r}",
                where=where,
                remedy=f"give all {len(field.columns)} of the covariance",
            )


def _single(values: NDArray[Any], where: str) -> str:
    found = sorted({str(value) for value in values})
    if len(found) > 1 or found[0] not in ("true", "magnetic"):
        raise DataError(
            f"holds {', '.join(map(repr, found[:3]))}", where=where, remedy="write 'true' or 'magnetic' in every row"
        )
    return found[0]
