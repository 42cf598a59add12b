"""The folder of a map: cloud, pictures, graph of places, and the patches that it is re-deformed from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import yaml

from uwgraph.dive.yamlfile import read_settings
from uwgraph.errors import DataError
from uwgraph.plain import json_values
from uwgraph.seafloor.georeference import Georeference, georeference, georeference_json
from uwgraph.seafloor.links import Pairs, closure_links, graph_json
from uwgraph.seafloor.picture import map_picture
from uwgraph.seafloor.ply import write_ply
from uwgraph.seafloor.render import SeafloorMap
from uwgraph.seafloor.settings import MapSettings
from uwgraph.time import isoformat

REPORT: Final = "map.json"
"""What makes a folder a map."""
SETTINGS: Final = "config.yaml"
KEYFRAMES: Final = "keyframes"
CLOUD, PICTURE, ORTHO, WORLD, GRAPH = "cloud.ply", "map.png", "ortho.png", "ortho.pgw", "graph.json"


def patch_files(folder: Path) -> list[Path]:
    """The patches of a map, in order of time.

    Raises
    ------
    DataError
        When the folder is no map, or holds none.
    """
    if not (folder / REPORT).is_file():
        raise DataError(
            f"is no map: there is no {REPORT}", where=str(folder), remedy="name a folder that 'uwgraph map' wrote"
        )
    files = [file for file in (folder / KEYFRAMES).glob("*.npz") if file.stem.isdecimal() and len(file.stem) < 20]
    if not files:
        raise DataError(
            "holds no keyframes", where=str(folder / KEYFRAMES), remedy="make the map again from the dive's images"
        )
    return sorted(files, key=lambda file: int(file.stem))


def read_map_settings(folder: Path) -> MapSettings:
    """What a map was made with, the size of its cells included; raises :class:`ConfigError` naming the key."""
    return read_settings(MapSettings, folder / SETTINGS)


def write_map_settings(folder: Path, settings: MapSettings) -> None:
    """Write what a map is made with."""
    (folder / SETTINGS).write_text(yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False), encoding="utf-8")


def write_products(
    folder: Path, found: SeafloorMap, closures_ns: Pairs, about: dict[str, Any], title: str
) -> dict[str, Any]:
    """Write everything but the patches into a folder, and return the figures of the report, ``about`` among them."""
    links = closure_links(closures_ns, found.t_ns)
    down = float(np.median(found.cloud.points_n[:, 2])) if len(found.cloud) else 0.0
    place = georeference(found.raster, found.origin, down)
    figures = about | map_figures(found, links)
    write_ply(folder / CLOUD, found.cloud, found.normals_n, _comments(found))
    _write_ortho(folder, found, place)
    map_picture(found, links, folder / PICTURE, _headline(title, figures))
    _write_json(folder / GRAPH, graph_json(found, links))
    report = figures | {"georeference": georeference_json(place, found.raster, found.origin)}
    _write_json(folder / REPORT, report)
    return figures


def map_figures(found: SeafloorMap, links: Pairs) -> dict[str, Any]:
    """What can be told about a map in numbers."""
    cloud = found.cloud
    several = np.isfinite(cloud.spread)
    return {
        "keyframes": len(found.t_ns),
        "points": len(cloud),
        "outliers_removed": found.removed,
        "area_m2": float(np.count_nonzero(found.canvas[..., 3])) * found.raster.pixel**2,
        "voxel_m": found.voxel,
        "pixel_m": found.raster.pixel,
        "sigma_m": float(np.median(cloud.sigma)) if len(cloud) else None,
        "spread_m": float(np.sqrt(np.mean(cloud.spread[several] ** 2))) if several.any() else None,
        "closures": len(links),
    }


def _comments(found: SeafloorMap) -> list[str]:
    origin = found.origin
    return [
        "uwgraph map: x east, y north, z up, metres, in the plane tangent to WGS-84 at the origin",
        f"origin lat_deg {np.degrees(origin.lat):.10f} lon_deg {np.degrees(origin.lon):.10f} height 0",
        f"keyframes from {isoformat(int(found.t_ns[0]))} to {isoformat(int(found.t_ns[-1]))}",
        "sigma: 1-sigma by the sensor alone, m; spread: vertical deviation among keyframes, m (nan: seen once)",
    ]


def _write_ortho(folder: Path, found: SeafloorMap, place: Georeference) -> None:
    done, png = cv2.imencode(".png", found.canvas, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    assert done
    (folder / ORTHO).write_bytes(png.tobytes())
    (folder / WORLD).write_text(place.world_file(), encoding="ascii")


def _write_json(path: Path, values: dict[str, Any]) -> None:
    path.write_text(json.dumps(json_values(values), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _headline(title: str, figures: dict[str, Any]) -> str:
    spread = f"keyframes agree to {figures['spread_m']:.2g} m" if figures["spread_m"] is not None else ""
    parts = (title, f"{figures['keyframes']} keyframes", f"{figures['area_m2']:.0f} m2", spread)
    return "   ".join(part for part in parts if part)
