"""Rectification against the cameras' own rays, for every lens and port."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.camera.model import DOWN_FORWARD, Camera, Model, Port
from uwgraph.errors import ConfigError
from uwgraph.seafloor.stereo import Stereo, block_points, stereo_of

N = 1.34


def camera(
    model: Model = "pinhole", port: Port = "dome", turn: tuple[float, ...] = (0, 0, 0), y: float = 0.0
) -> Camera:
    """Looks down, turned a little, ``y`` to starboard."""
    distortion = (-0.08, 0.02, 0.001, -0.002) if model == "pinhole" else (0.02, -0.005, 0.001, 0.0)
    R = DOWN_FORWARD @ Rotation.from_rotvec(turn).as_matrix()
    return Camera(model, (300.0, 305.0), (158.0, 121.0), (320, 240), distortion, R, port, l_b=np.array([0.1, y, 0.2]))


def seen(stereo: Stereo, side: int, column: float, row: float) -> np.ndarray:
    """The pixel of the left or right image behind a virtual pixel, interpolated."""
    u, v = int(column), int(row)
    a, b = column - u, row - v
    weights = np.array([[(1 - a) * (1 - b), a * (1 - b)], [(1 - a) * b, a * b]])
    return np.array([(weights * x[v : v + 2, u : u + 2]).sum() for x in stereo.maps[side]])


@settings(max_examples=15, deadline=None)
@given(
    st.sampled_from([("pinhole", "dome"), ("pinhole", "flat"), ("fisheye", "dome"), ("fisheye", "flat")]),
    st.tuples(*[st.floats(-0.08, 0.08)] * 6),
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.2, 0.2), st.floats(2.0, 5.0)),
)
def test_a_point_is_on_the_same_row_and_its_disparity_is_its_depth(
    kind: tuple[Model, Port], turns: tuple[float, ...], point: tuple[float, float, float]
) -> None:
    left, right = camera(*kind, turn=turns[:3]), camera(*kind, turn=turns[3:], y=0.2)
    stereo = stereo_of(left, right, N, 10**6)
    p_b = np.array([point[0], point[1] + 0.1, point[2]]) + left.l_b
    p_v = (p_b - stereo.l_b) @ stereo.R_bv
    column = stereo.c[0] + stereo.f * p_v[0] / p_v[2]
    row = stereo.c[1] + stereo.f * p_v[1] / p_v[2]
    disparity = stereo.f * stereo.baseline / p_v[2]
    for side, eye, at in ((0, left, column), (1, right, column - disparity)):
        if not (1 < at < stereo.size[0] - 2 and 1 < row < stereo.size[1] - 2):
            continue
        ray = eye.outside(seen(stereo, side, at, row), N)[0][0]
        towards = (p_b - eye.l_b) / np.linalg.norm(p_b - eye.l_b)
        assert np.linalg.norm(np.cross(ray, towards)) < 2e-5  # 0.006 of a pixel: the maps are interpolated here


def test_blocks_become_the_points_they_came_from() -> None:
    stereo = stereo_of(camera(), camera(y=0.2), N, 10**6)
    rows, columns = (extent // 8 for extent in stereo.size[::-1])
    z = np.linspace(2.0, 4.0, rows * columns).reshape(rows, columns)
    points, sigma = block_points(stereo, stereo.f * stereo.baseline / z, np.full_like(z, 0.1), 8)
    p_v = (points - stereo.l_b) @ stereo.R_bv
    np.testing.assert_allclose(p_v[..., 2], z)
    np.testing.assert_allclose(p_v[0, 0, :2] / z[0, 0] * stereo.f + stereo.c, [3.5, 3.5], atol=1e-9)
    along = np.linalg.norm(p_v, axis=-1) / z
    np.testing.assert_allclose(sigma, z**2 / (stereo.f * stereo.baseline) * 0.1 * along)


def test_large_images_are_reduced() -> None:
    small = stereo_of(camera(), camera(y=0.2), N, 10_000)
    assert 8_000 < small.size[0] * small.size[1] <= 10_000
    assert 100.0 < small.f < 115.0


def test_range_of_disparities() -> None:
    stereo = stereo_of(camera(), camera(y=0.2), 1.0, 10**6)
    low, count = stereo.disparity_range(1.0, 6.0)
    assert low <= stereo.f * 0.2 / 6.0
    assert low + count >= stereo.f * 0.2 / 1.0
    assert count % 16 == 0
    assert stereo.disparity_range(0.01, 1e9)[1] <= stereo.size[0]


@pytest.mark.parametrize(
    ("other", "word"),
    [
        (camera(), "no baseline"),
        (replace(camera(), l_b=np.array([0.1, 0.0, 0.7])), "along their baseline"),
        (replace(camera(y=0.3), R_bs=DOWN_FORWARD @ Rotation.from_rotvec([np.pi, 0, 0]).as_matrix()), "away from"),
        (replace(camera(y=0.3), R_bs=DOWN_FORWARD @ Rotation.from_rotvec([1.2, 0, 0]).as_matrix()), "same scene"),
    ],
)
def test_pairs_that_are_none(other: Camera, word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        stereo_of(camera(), other, N, 10**6)
