"""Files of a map read back by others: PLY by Open3D, world file, graph; cleaning; colours."""

from __future__ import annotations

import builtins
import json
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.errors import DataError
from uwgraph.frames import ned_from_geodetic
from uwgraph.seafloor import clean
from uwgraph.seafloor.clean import cleaned
from uwgraph.seafloor.colour import bands, light_of
from uwgraph.seafloor.fuse import Cloud
from uwgraph.seafloor.georeference import georeference, georeference_json
from uwgraph.seafloor.ortho import Raster
from uwgraph.seafloor.ply import write_ply
from uwgraph.types import FloatArray, Origin

ORIGIN = Origin(np.radians(43.2), np.radians(7.1))


def cloud_of(points: FloatArray) -> Cloud:
    count = len(points)
    colours = np.tile(np.array([[10, 20, 30]], np.uint8), (count, 1))
    return Cloud(points, colours, np.full(count, 0.01), np.full(count, np.nan), np.ones(count, np.int64))


def test_open3d_reads_the_ply(tmp_path: Path) -> None:
    points = np.array([[5000.001, -3.0, 40.0], [1.0, 2.0, 3.0]])
    write_ply(tmp_path / "a.ply", cloud_of(points), np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8]]), ["x east"])
    read = o3d.io.read_point_cloud(str(tmp_path / "a.ply"))
    np.testing.assert_array_equal(np.asarray(read.points), [[-3.0, 5000.001, -40.0], [2.0, 1.0, -3.0]])
    np.testing.assert_allclose(np.asarray(read.normals), [[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]], atol=1e-7)
    np.testing.assert_allclose(np.asarray(read.colors)[0] * 255, [30, 20, 10])
    assert b"comment x east\n" in (tmp_path / "a.ply").read_bytes()


@settings(max_examples=30, deadline=None)
@given(st.floats(-70, 70), st.floats(-180, 180), st.floats(-3000, 3000), st.floats(-3000, 3000))
def test_the_world_file_finds_the_pixels(lat: float, lon: float, north: float, east: float) -> None:
    origin = Origin(np.radians(lat), np.radians(lon))
    raster = Raster(north, east, 0.5, 400, 600)
    place = georeference(raster, origin, 30.0)
    a, d, b, e, c, f = map(float, place.world_file().split())
    column, row = 120.0, 333.0
    at_lon, at_lat = a * column + b * row + c, d * column + e * row + f
    ned = ned_from_geodetic(origin, np.radians(at_lat), np.radians(at_lon), -30.0)
    assert abs(ned[0] - (north - 0.5 * (row + 0.5))) < 0.05
    assert abs(ned[1] - (east + 0.5 * (column + 0.5))) < 0.05
    assert place.error_m < 0.05
    assert json.dumps({k: str(v) for k, v in georeference_json(place, raster, origin).items()})


def test_outliers_go_and_normals_point_up() -> None:
    rng = np.random.default_rng(0)
    n, e = (x.ravel() for x in np.meshgrid(np.arange(60) * 0.03, np.arange(60) * 0.03))
    floor = np.column_stack([n, e, 10.0 + 0.2 * n + rng.normal(0.0, 0.001, len(n))])
    fish = np.column_stack([rng.uniform(0, 1.8, (8, 2)), rng.uniform(8.0, 9.0, 8)])
    kept, normals = cleaned(cloud_of(np.concatenate([floor, fish])), 0.03)
    assert len(kept) > 0.97 * len(floor)
    assert (kept.points_n[:, 2] > 9.5).all()
    slope = np.array([0.2, 0.0, -1.0]) / np.hypot(0.2, 1.0)
    assert np.median(normals @ slope) > 0.999
    few, up = cleaned(cloud_of(floor[:3]), 0.03)
    assert len(few) == 3
    assert (up == [0.0, 0.0, -1.0]).all()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError("libusb-1.0.so.0: cannot open shared object file"), ["libusb-1.0", "apt install libusb-1.0-0"]),
        (ImportError("libGL.so.1: cannot open shared object file"), ["libGL", "libgl1"]),
        (ModuleNotFoundError("No module named 'open3d'"), ["pip install open3d"]),
    ],
)
def test_what_open3d_lacks_is_named(monkeypatch: pytest.MonkeyPatch, error: Exception, words: list[str]) -> None:
    there = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "open3d":
            raise error
        return there(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(DataError, match="open3d") as told:
        clean.open3d()
    for word in words:
        assert word in str(told.value)


def test_light_is_flattened() -> None:
    rng = np.random.default_rng(0)
    u = np.linspace(-1.0, 1.0, 96)
    lamp = np.exp(-(u[None, :] ** 2 + u[:72, None] ** 2))[..., None]

    def seen() -> np.ndarray:
        floor = rng.uniform(0.0, 1.0, (72, 96, 3))
        return np.clip((30 + 180 * floor * lamp) * [0.9, 1.0, 0.4], 0, 255).astype(np.uint8)

    light = light_of(seen() for _ in range(30))
    assert light is not None
    image = light.corrected(seen()).astype(float)
    middle, corner = image[30:42, 40:56], image[:14, :14]
    assert abs(middle.mean() - corner.mean()) < 8.0
    assert 0.75 < middle.std() / corner.std() < 1.35
    assert np.ptp(np.median(image, axis=(0, 1))) < 3.0
    assert light_of([]) is None


def test_images_from_alike_distances_share_a_light() -> None:
    distance = np.concatenate([np.full(20, 3.0), np.full(10, 3.1), np.full(8, 6.0), [30.0], [np.nan]])
    band = bands(distance)
    assert len(set(band[:30])) == 1
    assert len(set(band[30:38])) == 1
    assert band[0] != band[30]
    assert band[38] == band[30]  # too few for a light of their own
    assert band[39] not in band[:39]
    assert len(set(bands(np.array([3.0, 9.0])))) == 1
    assert len(set(bands(np.full(3, np.nan)))) == 1
