"""Where a picture from above lies on the Earth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uwgraph.frames import geodetic_from_ned
from uwgraph.seafloor.ortho import Raster
from uwgraph.types import FloatArray, Origin


@dataclass(frozen=True, eq=False)
class Georeference:
    """Longitude and latitude (degrees, WGS-84) of a raster's pixels: affine, fitted at its corners."""

    affine: FloatArray
    """Shape (2, 3): longitude and latitude of (column, row, 1), pixel centres at whole numbers."""
    error_m: float
    """What the affine map errs by at the corners, m."""
    corners_deg: FloatArray
    """Longitude and latitude of the upper left, upper right, lower right, lower left corner, shape (4, 2)."""

    def world_file(self) -> str:
        """The six lines of a world file for WGS-84 longitude and latitude (EPSG:4326)."""
        (a, b, c), (d, e, f) = self.affine
        return "".join(f"{value:.15g}\n" for value in (a, d, b, e, c, f))


def georeference(raster: Raster, origin: Origin, down: float) -> Georeference:
    """The georeference of a raster of the floor at ``down`` in n, m."""
    edge = np.array([[0.0, 0.0], [raster.width, 0.0], [raster.width, raster.height], [0.0, raster.height]])
    ned = np.column_stack(
        [raster.north - raster.pixel * edge[:, 1], raster.east + raster.pixel * edge[:, 0], np.full(4, down)]
    )
    lat, lon, _ = geodetic_from_ned(origin, ned)
    corners = np.degrees(np.column_stack([lon[0] + (lon - lon[0] + np.pi) % (2.0 * np.pi) - np.pi, lat]))
    A = np.column_stack([edge - 0.5, np.ones(4)])
    solved, *_ = np.linalg.lstsq(A, corners, rcond=None)
    off = np.radians(A @ solved - corners) * [np.cos(origin.lat), 1.0] * 6.371e6
    return Georeference(solved.T, float(np.linalg.norm(off, axis=1).max()), corners)


def georeference_json(place: Georeference, raster: Raster, origin: Origin) -> dict[str, Any]:
    """What the JSON beside the picture tells."""
    return {
        "frame": "north, east, down [m], tangent to WGS-84 at the origin",
        "origin": {"lat_deg": float(np.degrees(origin.lat)), "lon_deg": float(np.degrees(origin.lon))},
        "pixel_m": raster.pixel,
        "width": raster.width,
        "height": raster.height,
        "upper_left_corner": {"north_m": raster.north, "east_m": raster.east},
        "corners_lon_lat_deg": place.corners_deg,
        "world_file": {"crs": "EPSG:4326", "error_m": place.error_m},
    }
