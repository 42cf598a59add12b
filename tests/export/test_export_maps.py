"""GeoJSON and KML: read back by other means, with the places, times and sizes that went in."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hand_made import truth
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.dive.model import Dive
from uwgraph.errors import ConfigError
from uwgraph.export import Source, Track, export, source_of_dive, track_of_solution
from uwgraph.export.geojson import write_geojson
from uwgraph.frames import geodetic_from_ned, ned_from_geodetic
from uwgraph.time import isoformat
from uwgraph.types import Origin

NS = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}


def features(path: Path) -> list[dict[str, Any]]:
    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    collection = json.loads(path.read_text(), parse_constant=refuse)
    assert collection["type"] == "FeatureCollection"
    return list(collection["features"])


def at(origin: Origin) -> Track:
    """The hand-made track somewhere else."""
    track = track_of_solution(truth(n=120))
    lat, lon_, height = geodetic_from_ned(origin, track.p_n)
    return replace(track, origin=origin, lat=lat, lon=lon_, height=height)


def test_the_line_is_the_track(tmp_path: Path) -> None:
    track = track_of_solution(truth())
    export(Source("run1", track), tmp_path / "a.geojson")
    line = features(tmp_path / "a.geojson")[0]
    lon, lat, height = np.array(line["geometry"]["coordinates"]).T
    back = ned_from_geodetic(track.origin, np.radians(lat), np.radians(lon), height)
    np.testing.assert_allclose(back, track.p_n, atol=1e-3)
    assert line["geometry"]["type"] == "LineString"
    assert line["properties"]["times"] == [isoformat(t) for t in track.t_ns.tolist()]
    np.testing.assert_allclose(line["properties"]["sigma_down"], track.sigma_p[:, 2], atol=1e-4)
    names = [f["properties"]["name"] for f in features(tmp_path / "a.geojson")]
    assert names[:3] == ["solution", "solution: start", "solution: end"]
    assert 10 < names.count("solution: 1-sigma") <= 50


def rings(found: list[dict[str, Any]]) -> Iterator[np.ndarray]:
    for feature in found:
        if feature["geometry"]["type"] == "Polygon":
            (ring,) = feature["geometry"]["coordinates"]
            yield np.array(ring)


@settings(max_examples=30)
@given(
    sigma=st.tuples(st.floats(0.5, 500.0), st.floats(0.5, 500.0)),
    rho=st.floats(-0.99, 0.99),
)
def test_ellipses_are_closed_counterclockwise_and_of_the_right_size(
    tmp_path_factory: pytest.TempPathFactory, sigma: tuple[float, float], rho: float
) -> None:
    track = track_of_solution(truth(n=5))
    track = replace(
        track,
        sigma_p=np.tile([*sigma, 1.0], (5, 1)),
        cov_p=np.tile([rho * sigma[0] * sigma[1], 0.0, 0.0], (5, 1)),
    )
    path = tmp_path_factory.mktemp("maps") / "a.geojson"
    write_geojson(track, None, path)
    found = list(rings(features(path)))
    assert len(found) == 5
    for k, ring in enumerate(found):
        assert ring[0].tolist() == ring[-1].tolist()
        x, y = (ring - ring[0]).T
        assert np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0.0
        lon, lat = np.radians(ring).T
        off = ned_from_geodetic(track.origin, lat, lon, track.height[k])[:, :2] - track.p_n[k, :2]
        weighted = np.einsum("ki,ij,kj->k", off, np.linalg.inv(track.cov_p_n[k, :2, :2]), off)
        np.testing.assert_allclose(weighted, 1.0, atol=0.02)


def test_a_line_over_the_antimeridian_is_cut_there(tmp_path: Path) -> None:
    track = at(Origin(np.radians(-17.0), np.radians(179.9995)))
    write_geojson(track, None, tmp_path / "a.geojson")
    geometry = features(tmp_path / "a.geojson")[0]["geometry"]
    assert geometry["type"] == "MultiLineString"
    parts = geometry["coordinates"]
    assert len(parts) > 1
    for part, after in pairwise(parts):
        assert abs(part[-1][0]) == 180.0
        assert after[0][0] == -part[-1][0]
        assert after[0][1:] == part[-1][1:]
    for part in parts:
        assert np.ptp([place[0] for place in part]) < 1.0
    for ring in rings(features(tmp_path / "a.geojson")):
        assert np.ptp(ring[:, 0]) < 1.0


def test_what_is_not_known_is_left_out(short_dive: Dive, tmp_path: Path) -> None:
    source = source_of_dive(short_dive, "sim")
    assert source.track is not None
    flat = Source("sim", replace(source.track, height=source.track.height * np.nan))
    export(flat, tmp_path / "a.json")
    line, *_ = found = features(tmp_path / "a.json")
    assert {len(place) for place in line["geometry"]["coordinates"]} == {2}
    assert not [name for name in line["properties"] if name.startswith("sigma")]
    assert not list(rings(found))


def test_fixes_are_points(short_dive: Dive, tmp_path: Path) -> None:
    source = source_of_dive(short_dive, "sim", "fixes")
    fixes = source.fixes
    assert fixes is not None
    wide = np.tile(np.diag([4.0, 9.0, np.inf]), (len(fixes), 1, 1))
    height = np.full(len(fixes), np.nan)
    export(replace(source, fixes=replace(fixes, cov_n=wide, height=height)), tmp_path / "a.geojson")
    found = features(tmp_path / "a.geojson")
    assert {f["geometry"]["type"] for f in found} == {"Point"}
    assert [f["properties"]["sigma_east"] for f in found] == [3.0] * len(fixes)
    assert {len(f["geometry"]["coordinates"]) for f in found} == {2}


def test_a_single_pose_is_a_point(tmp_path: Path) -> None:
    one = Source("one", track_of_solution(truth(n=1)))
    export(one, tmp_path / "a.geojson")
    assert {f["geometry"]["type"] for f in features(tmp_path / "a.geojson")} == {"Point", "Polygon"}
    export(one, tmp_path / "a.kml")
    assert not ElementTree.parse(tmp_path / "a.kml").findall(".//k:LineString", NS)


def test_kml_tells_place_time_and_attitude(short_dive: Dive, tmp_path: Path) -> None:
    source = source_of_dive(short_dive, 'a<b>&"c"\x01\udc80 ü')
    export(source, tmp_path / "a.kml")
    root = ElementTree.parse(tmp_path / "a.kml").getroot()
    assert root.findtext("k:Document/k:name", namespaces=NS) == 'a<b>&"c" ü'
    track = source.track
    assert track is not None
    played = root.find(".//gx:Track", NS)
    assert played is not None
    assert [when.text for when in played.findall("k:when", NS)] == [isoformat(t) for t in track.t_ns.tolist()]
    coordinates = [(c.text or "").split() for c in played.findall("gx:coord", NS)]
    lon, lat, height = np.array(coordinates, dtype=float).T
    np.testing.assert_allclose(
        ned_from_geodetic(track.origin, np.radians(lat), np.radians(lon), height), track.p_n, atol=1e-3
    )
    angles = np.array([(a.text or "").split() for a in played.findall("gx:angles", NS)], dtype=float)
    np.testing.assert_allclose(angles[:, ::-1], np.degrees(track.rph), atol=1e-3)
    assert {mode.text for mode in root.findall(".//k:altitudeMode", NS)} == {"absolute"}
    line = root.findtext(".//k:LineString/k:coordinates", namespaces=NS)
    assert line is not None
    assert len(line.split()) == len(track)
    assert short_dive.fixes is not None
    assert len(root.findall(".//k:Point", NS)) == 2 + len(short_dive.fixes)


@pytest.mark.parametrize("name", ["a.kml", "a.geojson", "a.csv"])
def test_places_have_no_frames(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="no frames"):
        export(Source("run1", track_of_solution(truth())), tmp_path / name, frame="enu")
