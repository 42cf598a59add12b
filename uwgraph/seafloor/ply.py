"""Clouds as binary PLY, with what the numbers mean in the header's comments."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from uwgraph.seafloor.fuse import Cloud
from uwgraph.types import FloatArray

_PROPERTIES: Final = (
    *((name, "double", "<f8") for name in ("x", "y", "z")),
    *((name, "float", "<f4") for name in ("nx", "ny", "nz")),
    *((name, "uchar", "u1") for name in ("red", "green", "blue")),
    *((name, "float", "<f4") for name in ("sigma", "spread")),
    ("keyframes", "int", "<i4"),
)
ENU_NED: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""North, east, down into x east, y north, z up, which viewers expect."""


def write_ply(path: Path, cloud: Cloud, normals_n: FloatArray, comments: Sequence[str]) -> None:
    """Write points in x east, y north, z up [m] of the navigation frame, with normals, colours, 1-sigma and spread."""
    rows = np.zeros(len(cloud), dtype=[(name, kind) for name, _, kind in _PROPERTIES])
    places, normals = cloud.points_n @ ENU_NED.T, normals_n @ ENU_NED.T
    for axis, (place, normal) in enumerate((("x", "nx"), ("y", "ny"), ("z", "nz"))):
        rows[place], rows[normal] = places[:, axis], normals[:, axis]
    for axis, colour in enumerate(("blue", "green", "red")):
        rows[colour] = cloud.colours[:, axis]
    rows["sigma"], rows["spread"], rows["keyframes"] = cloud.sigma, cloud.spread, cloud.keyframes
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {line}" for line in comments),
        f"element vertex {len(cloud)}",
        *(f"property {kind} {name}" for name, kind, _ in _PROPERTIES),
        "end_header",
    ]
    with path.open("wb") as file:
        file.write("\n".join([*header, ""]).encode("ascii", "replace"))
        rows.tofile(file)
