"""GeoJSON (RFC 7946): longitude, latitude, height above the sea surface; the track as a line with times and 1-sigma."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from uwgraph.export.track import Track
from uwgraph.frames import geodetic_from_ned
from uwgraph.time import isoformat
from uwgraph.types import Fixes, FloatArray

MAX_ELLIPSES: Final = 50
"""1-sigma ellipses along a track: enough to see them grow, few enough to see the track."""
_CORNERS: Final = 32

Feature = dict[str, Any]


def write_geojson(track: Track | None, fixes: Fixes | None, path: Path) -> None:
    """A FeatureCollection: the track's line, start, end and 1-sigma ellipses; the fixes as points."""
    features = [*(_track_features(track) if track is not None else []), *(_fix_features(fixes) if fixes else [])]
    text = json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False, separators=(",", ":"))
    path.write_text(text + "\n", encoding="utf-8")


def _track_features(track: Track) -> list[Feature]:
    places = coordinates(track.lat, track.lon, track.height)
    times = [isoformat(t) for t in track.t_ns.tolist()]
    line = [_feature(_line(places), name=track.name, times=times, **_sigmas(track))] if len(track) > 1 else []
    ends = [("start", 0), ("end", -1)]
    points = [_feature(_point(places[k]), name=f"{track.name}: {word}", time=times[k]) for word, k in ends]
    return [*line, *points, *_ellipses(track, times)]


def _fix_features(fixes: Fixes) -> list[Feature]:
    sigma = np.sqrt(np.diagonal(fixes.cov_n, axis1=1, axis2=2))
    return [
        _feature(
            _point(place),
            name=str(source),
            time=isoformat(t),
            sigma_north=_number(north),
            sigma_east=_number(east),
        )
        for place, t, source, (north, east, _) in zip(
            coordinates(fixes.lat, fixes.lon, fixes.height),
            fixes.t_ns.tolist(),
            fixes.source,
            sigma.tolist(),
            strict=True,
        )
    ]


def coordinates(lat: FloatArray, lon: FloatArray, height: FloatArray) -> list[list[float]]:
    """Longitude from -180 to 180 and latitude in degrees to 0.1 mm, height to 1 mm where it is known."""
    east = (np.degrees(lon) + 180.0) % 360.0 - 180.0
    flat = np.round(np.column_stack([east, np.degrees(lat)]), 9).tolist()
    up = np.round(height, 3).tolist()
    return [[*place, z] if np.isfinite(z) else place for place, z in zip(flat, up, strict=True)]


def _line(places: list[list[float]]) -> Feature:
    """One line, or several that end at the antimeridian (RFC 7946, 3.1.9)."""
    parts: list[list[list[float]]] = [places[:1]]
    for before, after in pairwise(places):
        if abs(after[0] - before[0]) > 180.0:
            edge = np.copysign(180.0, before[0])
            beyond = after[0] + 2.0 * edge
            share = (edge - before[0]) / (beyond - before[0]) if beyond != before[0] else 0.0
            middle = [b + share * (a - b) for b, a in zip(before[1:], after[1:], strict=False)]
            parts[-1].append([edge, *middle])
            parts.append([[-edge, *middle]])
        parts[-1].append(after)
    if len(parts) == 1:
        return {"type": "LineString", "coordinates": parts[0]}
    return {"type": "MultiLineString", "coordinates": parts}


def _point(place: list[float]) -> Feature:
    return {"type": "Point", "coordinates": place}


def _ellipses(track: Track, times: list[str]) -> list[Feature]:
    """Horizontal 1-sigma ellipses (39 % of a plane normal distribution) at places spread evenly over the samples."""
    chosen = np.unique(np.linspace(0, len(track) - 1, MAX_ELLIPSES).round().astype(int))
    cov = track.cov_p_n[chosen, :2, :2]
    known = np.isfinite(cov).all(axis=(1, 2))
    values, axes = np.linalg.eigh(cov[known])
    angle = np.linspace(0.0, -2.0 * np.pi, _CORNERS + 1)  # clockwise from north in (N, E) is counterclockwise on a map
    circle = np.stack([np.cos(angle), np.sin(angle)])
    half_axes = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    half_axes[:, :, 1] *= np.sign(np.linalg.det(axes))[:, None]
    features = []
    for k, ring in zip(chosen[known], half_axes @ circle, strict=True):
        lat, lon, _ = geodetic_from_ned(track.origin, track.p_n[k] + np.column_stack([ring.T, np.zeros(_CORNERS + 1)]))
        corners = coordinates(lat, lon, np.full(len(lat), np.nan))
        corners[-1] = corners[0]
        if np.ptp([corner[0] for corner in corners]) < 180.0:
            polygon = {"type": "Polygon", "coordinates": [corners]}
            features.append(_feature(polygon, name=f"{track.name}: 1-sigma", time=times[k]))
    return features


def _sigmas(track: Track) -> dict[str, list[float | None]]:
    """1-sigma of the position per place, where there are any."""
    if not np.isfinite(track.sigma_p).any():
        return {}
    names = ("sigma_north", "sigma_east", "sigma_down")
    return {name: [_number(x) for x in column] for name, column in zip(names, track.sigma_p.T.tolist(), strict=True)}


def _number(value: float) -> float | None:
    return round(value, 4) if np.isfinite(value) else None


def _feature(geometry: Feature, **properties: Any) -> Feature:
    return {"type": "Feature", "geometry": geometry, "properties": properties}
