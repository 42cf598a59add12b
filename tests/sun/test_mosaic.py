"""Mosaics: layouts, bit depths, registration, wrong orders."""

import itertools

import numpy as np
import pytest
from polar_sky import CLEAR, SENSOR, fisheye, sun_at

from uwgraph.camera.sensor import Sensor
from uwgraph.errors import ConfigError, DataError
from uwgraph.frames import matrix_from_rph, wrap_pi
from uwgraph.simulate.exposure import auto_scale, expose, mosaic
from uwgraph.simulate.render import Shot, render
from uwgraph.sun.mosaic import LAYOUTS, from_mosaic, layout
from uwgraph.sun.polarization import estimate
from uwgraph.sun.view import View


def cell_image(light, dop, phi, cell):
    """A mosaic of smooth Stokes fields given at every raw pixel."""
    raw = np.empty_like(light)
    for k, beta in enumerate(np.radians(cell)):
        at = np.s_[k // 2 :: 2, k % 2 :: 2]
        raw[at] = light[at] / 2.0 * (1.0 + dop * np.cos(2.0 * phi - 2.0 * beta))
    return raw


@pytest.mark.parametrize("name", [*LAYOUTS, "10,55,100,145"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_every_layout_and_depth_gives_the_angle_back(name, kind):
    full = 200.0 if kind == np.uint8 else 50_000.0
    raw = cell_image(np.full((64, 96), full), 0.4, 0.7, layout(name)).astype(kind)
    image = from_mosaic(raw, layout(name), cells=4)
    assert image.I.shape == (8, 12)
    assert image.factor == 8
    assert np.allclose(image.aop, 0.7, atol=np.radians(0.5))
    assert np.allclose(image.dop, 0.4, atol=0.01)


def test_a_steep_image_without_polarization_stays_without():
    """Half a pixel between the channels would make a slope look polarized."""
    v, u = np.mgrid[:128, :128]
    raw = cell_image(1000.0 * np.exp(0.01 * u - 0.02 * v), 0.0, 0.0, LAYOUTS["sony"])
    image = from_mosaic(raw, sensor=Sensor(white=1e6), cells=8)
    assert image.dop[1:-1, 1:-1].max() < 3e-4


def test_a_saturated_pixel_marks_its_bin_only():
    raw = np.full((64, 64), 1000, dtype=np.uint16)
    raw[17, 40] = 65_535
    image = from_mosaic(raw, cells=8)
    assert np.argwhere(image.saturated).tolist() == [[1, 2]]


def test_twelve_bits_in_sixteen_are_recognised():
    raw = np.full((64, 64), 1000, dtype=np.uint16)
    raw[0, 0] = 4095
    assert from_mosaic(raw, cells=8).saturated[0, 0]


@pytest.mark.parametrize("order", sorted(set(itertools.permutations((90.0, 45.0, 135.0, 0.0)))))
def test_only_the_right_order_is_believed(order):
    """All 24 orders of the cell: the right one gives the heading, every other one a flag."""
    camera, s_n, rph = fisheye(192), sun_at(0.4, np.radians(50.0)), (0.05, -0.04, 1.0)
    radiance = mosaic(_clear_sky(camera, s_n, rph))
    raw = expose(radiance, SENSOR, auto_scale(radiance, 4096.0), 12, np.random.default_rng(0))
    view = View(camera, matrix_from_rph(np.array(rph)).T @ np.array([0.0, 0.0, -1.0]), sun_zenith=np.radians(50.0))
    sun = estimate(from_mosaic(raw, order, SENSOR, cells=1), view).observation
    if order == LAYOUTS["sony"]:
        assert sun.ok
        assert abs(np.degrees(wrap_pi(sun.heading(0.4) - 1.0))) < 0.1
    else:
        assert not sun.ok


_CACHE: dict[str, np.ndarray] = {}


def _clear_sky(camera, s_n, rph):
    if "clear" not in _CACHE:
        _CACHE["clear"] = render(CLEAR, Shot(camera, matrix_from_rph(np.array(rph)), s_n))
    return _CACHE["clear"]


@pytest.mark.parametrize("name", ["bayer", "1,2,3", "0,0,0,0", "0,45,90,x"])
def test_unknown_layouts_are_refused(name):
    with pytest.raises(ConfigError, match="no mosaic layout"):
        layout(name)


def test_a_colour_image_is_no_mosaic():
    with pytest.raises(DataError, match="no mosaic"):
        from_mosaic(np.zeros((64, 64, 3), dtype=np.uint8))
