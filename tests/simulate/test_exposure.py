"""Counts of a simulated sensor: Malus, the mosaic, the statistics of its noise, its range."""

import numpy as np
import pytest

from uwgraph.camera.sensor import Sensor
from uwgraph.simulate.exposure import SONY, auto_scale, behind_polarizer, expose, mosaic

SENSOR = Sensor(white=4000.0, black=64.0, gain=2.5, read_noise=3.0)


def test_malus():
    """Fully polarized along 30 degrees: all of it behind 30, none behind 120, half behind 75."""
    phi = np.radians(30.0)
    stokes = np.array([[[2.0, 2.0 * np.cos(2 * phi), 2.0 * np.sin(2 * phi)]]])
    for degrees, share in ((30.0, 1.0), (120.0, 0.0), (75.0, 0.5)):
        assert behind_polarizer(stokes, float(np.radians(degrees)))[0, 0] == pytest.approx(2.0 * share)


def test_mosaic_has_each_polarizer_in_its_place():
    stokes = np.tile([1.0, 0.3, -0.2], (4, 6, 1))
    raw = mosaic(stokes)
    for (row, column), angle in zip(((0, 0), (0, 1), (1, 0), (1, 1)), SONY, strict=True):
        np.testing.assert_allclose(raw[row::2, column::2], behind_polarizer(stokes, np.radians(angle))[0, 0])


@pytest.mark.parametrize("counts", [0.0, 30.0, 300.0, 3000.0])
def test_noise_is_what_the_sensor_states(counts):
    """Mean and variance of 200 000 pixels: shot, read and rounding noise."""
    image = expose(np.full((400, 500), counts), SENSOR, 1.0, 12, np.random.default_rng(0)).astype(float)
    variance = SENSOR.variance(np.array(counts + SENSOR.black))
    assert image.mean() == pytest.approx(counts + SENSOR.black, abs=5 * np.sqrt(variance / image.size) + 1e-9)
    assert image.var() == pytest.approx(float(variance), rel=0.02)


def test_range_and_type():
    bright = np.array([[0.0, 1.0, 1e9]])
    for bits, kind, top in ((8, np.uint8, 255), (12, np.uint16, 4095), (16, np.uint16, 65535)):
        counts = expose(bright, Sensor(white=0.98 * top), 10.0, bits, None)
        assert counts.dtype == kind
        assert counts.tolist() == [[0, 10, top]]
    noisy = expose(np.full((50, 50), 1e12), SENSOR, 1.0, 12, np.random.default_rng(1))
    assert (noisy == 4095).all()


def test_auto_scale_leaves_the_sky_in_range_and_lets_the_sun_clip():
    radiance = np.concatenate([np.linspace(0.1, 1.0, 990), np.full(10, 1e5), np.zeros(500)])[None]
    counts = expose(radiance, Sensor(white=4000.0), auto_scale(radiance, 4000.0), 12, None)[0]
    assert (counts == 4095).sum() == 10
    assert 2800 < np.sort(counts[:990])[-1] < 4000
    assert auto_scale(np.zeros((3, 3)), 4000.0) == 1.0
    assert auto_scale(radiance, 4000.0, most=2.0) == 2.0
