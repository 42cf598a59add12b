"""The simulated floor as a place: without seams, the same every time, its heights told exactly, its photos cleaned."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.errors import DataError
from uwgraph.simulate import Ground, Terrain
from uwgraph.simulate.floor_noise import Grid, field, fractal
from uwgraph.simulate.floor_photos import read_photos
from uwgraph.simulate.floor_terrain import HEIGHT_STEP_M, TEXEL_M
from uwgraph.simulate.floor_texture import Texture

PHOTOS = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data")) / "seafloor_photos"
INDEX = st.integers(-(10**6), 10**6)


@given(i=INDEX, j=INDEX, skip=st.tuples(st.integers(0, 20), st.integers(0, 20)), size=st.sampled_from([0.03, 0.2, 7.0]))
@settings(max_examples=30, deadline=None)
def test_noise_depends_on_the_place_alone(i, j, skip, size):
    whole = field(3, 1, Grid((i, j), (40, 40), 0.01), size)
    part = field(3, 1, Grid((i + skip[0], j + skip[1]), (12, 15), 0.01), size)
    np.testing.assert_allclose(part, whole[skip[0] : skip[0] + 12, skip[1] : skip[1] + 15], atol=2e-5)


def test_noise_has_the_stated_mean_variance_and_size():
    grid = Grid((0, 0), (1000, 1000), 0.03)
    for noise in (field(5, 0, grid, 0.5), fractal(5, 9, grid, 1.0, 0.1)):
        assert abs(noise.mean()) < 0.1
        assert noise.std() == pytest.approx(1.0, abs=0.06)
    noise = field(5, 0, grid, 0.5)
    apart = [np.mean(noise[: -k or None] * noise[k:]) for k in (1, 60)]
    assert apart[0] > 0.95
    assert abs(apart[1]) < 0.1
    assert abs(np.mean(noise * field(5, 1, grid, 0.5))) < 0.06
    assert abs(np.mean(noise * field(6, 0, grid, 0.5))) < 0.06


@pytest.mark.parametrize("texture", ["natural", "tiles", "plain"])
def test_tiles_meet_without_a_seam(texture):
    """What a crop over a corner of four tiles shows is what is made there in one piece."""
    terrain = Terrain(Ground(texture=texture), 2, 20.0)
    n = 60
    colours = terrain.colours.crop((-n, 512 - n), (2 * n, 2 * n))
    in_one = Texture(Ground(texture=texture), 2)(Grid((-n, 512 - n), (2 * n, 2 * n), TEXEL_M))
    assert np.abs(colours.astype(int) - in_one.astype(int)).max() <= 1
    heights = terrain.heights.crop((-n, 256 - n), (2 * n, 2 * n))
    middle = terrain.heights.crop((-n // 2, 256 - n // 2), (n, n))
    np.testing.assert_array_equal(middle, heights[n // 2 : -n // 2, n // 2 : -n // 2])
    assert np.abs(np.diff(heights, axis=0)).max() < 1.1 * HEIGHT_STEP_M


def test_same_seed_same_floor_and_others_differ():
    one, same, other = (Terrain(Ground(), seed, 20.0) for seed in (1, 1, 2))
    ne = np.random.default_rng(0).uniform(0.1, 1.9, (50, 2))
    np.testing.assert_array_equal(one.height(ne), same.height(ne))
    np.testing.assert_array_equal(one.albedo(ne), same.albedo(ne))
    assert np.abs(one.height(ne) - other.height(ne)).max() > 0.02


def test_heights_are_those_of_the_grid_and_bilinear_between():
    terrain = Terrain(Ground(), 4, 30.0)
    nodes = terrain.heights.crop((-300, 250), (20, 20))
    ne = np.stack(np.meshgrid(np.arange(-300, -280), np.arange(250, 270), indexing="ij"), axis=-1) * HEIGHT_STEP_M
    np.testing.assert_allclose(terrain.height(ne.reshape(-1, 2)).reshape(20, 20), nodes, atol=1e-6)
    between = terrain.height(ne[:-1, :-1].reshape(-1, 2) + 0.5 * HEIGHT_STEP_M).reshape(19, 19)
    mean = (nodes[:-1, :-1] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[1:, 1:]) / 4.0
    np.testing.assert_allclose(between, mean, atol=1e-6)
    np.testing.assert_allclose(terrain.down([[0.0, 0.0]]), 30.0 - terrain.height([[0.0, 0.0]]))
    assert terrain.mean_down(np.array([10_000.0, 0.0])) == pytest.approx(30.0 - 7.85, abs=0.05)


def test_relief_and_stones_are_of_the_stated_size():
    bare = Terrain(Ground(stones=0.0, relief=0.2), 1, 20.0)
    stony = Terrain(Ground(stones=1.0, relief=0.2), 1, 20.0)
    ne = np.random.default_rng(1).uniform(-60.0, 60.0, (100, 2))
    assert bare.height(ne).std() == pytest.approx(0.2, rel=0.35)
    near = np.random.default_rng(2).uniform(-4.0, 4.0, (4000, 2))
    rise = stony.height(near) - bare.height(near)
    assert rise.min() >= 0.0
    assert 0.03 < rise.max() < 0.3
    assert 0.01 < np.mean(rise > 0.005) < 0.4


def test_tiles_repeat_and_plain_is_plain():
    terrain = Terrain(Ground(texture="tiles", tile_m=0.4), 1, 20.0)
    a, b = (terrain.colours.crop((0, first), (150, 150)) for first in (0, 700))
    np.testing.assert_array_equal(a, b)
    assert a.std() > 5
    assert not terrain.heights.crop((0, 0), (50, 50)).any()
    assert Terrain(Ground(texture="plain"), 1, 20.0).colours.crop((0, 0), (300, 300)).std() < 8


def make_photo(path: Path, seed: int, cable: bool = True) -> None:
    """Gravel under a lamp's uneven light, and a white cable across it."""
    grid = Grid((0, 0), (300, 400), 0.01)
    photo = 0.2 * np.exp(0.4 * fractal(seed, 0, grid, 1.0, 0.02, 0.8))
    v, u = np.mgrid[:300, :400]
    photo *= np.exp(-(((u - 150) / 250) ** 2 + ((v - 150) / 200) ** 2))
    if cable:
        photo[:, 300:306] = 1.0
    cv2.imwrite(str(path), (255 * np.clip(photo, 0, 1) ** (1 / 2.2)).astype(np.uint8))


def test_photos_are_evenly_lit_and_their_cable_is_left_out(tmp_path):
    make_photo(tmp_path / "a.png", 1)
    (photo,) = read_photos(tmp_path, 2.0, 0.005)
    assert photo.texture.shape == (300, 400, 4)
    assert photo.texture[:, 298:308, 3].max() == 0.0
    assert photo.texture[:, 20:280, 3].mean() > 0.7
    assert np.abs(photo.centres[:, 0] - 303).min() > 0.2 / 0.005
    left, right = (photo.texture[80:220, part, :3].mean() for part in (slice(110, 190), slice(20, 80)))
    assert 0.7 < left / right < 1.4
    floor = Terrain(Ground(stones=0.0), 1, 20.0, (photo,), 0.005).colours.crop((0, 0), (800, 800))
    assert floor.max() < 250


def test_photos_that_cannot_be_used_are_refused(tmp_path):
    with pytest.raises(DataError, match="no such folder"):
        read_photos(tmp_path / "none", 2.0, 0.005)
    with pytest.raises(DataError, match="holds no photographs"):
        read_photos(tmp_path, 2.0, 0.005)
    cv2.imwrite(str(tmp_path / "b.png"), np.full((64, 90, 3), 90, np.uint8))
    with pytest.raises(DataError, match="no photograph shows"):
        read_photos(tmp_path, 0.3, 0.005)
    cv2.imwrite(str(tmp_path / "a.png"), np.full((4000, 40), 90, np.uint8))
    with pytest.raises(DataError, match="40 x 4000"):
        read_photos(tmp_path, 2.0, 0.005)
    (tmp_path / "a.png").unlink()
    (tmp_path / "c.jpg").write_bytes(b"not a picture")
    with pytest.raises(DataError, match=r"c\.jpg"):
        read_photos(tmp_path, 2.0, 0.005)


@pytest.mark.data
@pytest.mark.slow
def test_real_photos_give_places_that_are_told_apart():
    """Geometry holds few matches between places, and hundreds between views of one place."""
    if not PHOTOS.is_dir():
        pytest.skip(f"no {PHOTOS}: set UWGRAPH_DATA to the folder of the recordings")
    terrain = Terrain(Ground(), 3, 20.0, read_photos(PHOTOS, 2.4, 0.0035))
    sift, even = cv2.SIFT_create(1000), cv2.createCLAHE(3.0, (8, 8))

    def view(north: int, east: int, turns: int = 0):
        code = cv2.cvtColor(terrain.colours.crop((north, east), (600, 600)), cv2.COLOR_BGR2GRAY)
        small = cv2.resize(code, (400, 400), interpolation=cv2.INTER_AREA)
        return sift.detectAndCompute(even.apply(np.ascontiguousarray(np.rot90(small, turns))), None)

    def agree(a, b) -> int:
        pairs = [m for m, n in cv2.BFMatcher().knnMatch(a[1], b[1], k=2) if m.distance < 0.8 * n.distance]
        if len(pairs) < 5:
            return 0
        at = [np.float32([a[0][m.queryIdx].pt for m in pairs]), np.float32([b[0][m.trainIdx].pt for m in pairs])]
        return int(cv2.findHomography(*at, cv2.RANSAC, 3.0)[1].sum())

    views = [view(2500 * k, 0) for k in range(6)]
    apart = [agree(views[i], views[j]) for i in range(6) for j in range(i)]
    again = [agree(views[k], view(2500 * k + 60, 90, turns=k % 4)) for k in range(6)]
    assert max(apart) < 25
    assert min(again) > 100
