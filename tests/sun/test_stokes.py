"""Stokes images: least squares, gains, noise, masks, redundancy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwgraph.camera.sensor import Sensor
from uwgraph.errors import DataError
from uwgraph.sun.stokes import estimate_gains, from_channels

FOUR = np.radians([0.0, 45.0, 90.0, 135.0])
SENSOR = Sensor(white=60_000.0, gain=1.0, read_noise=2.0)


def channels(light, dop, phi, angles, gains=None):
    gains = np.ones(len(angles)) if gains is None else gains
    return [k * light / 2.0 * (1.0 + dop * np.cos(2.0 * phi - 2.0 * b)) for k, b in zip(gains, angles, strict=True)]


@given(phi=st.floats(-1.5, 1.5), dop=st.floats(0.05, 1.0), start=st.floats(0.0, 3.0), count=st.integers(3, 6))
def test_angle_and_degree_come_back_for_any_set_of_polarizers(phi, dop, start, count):
    angles = start + np.arange(count) * np.pi / count
    image = from_channels(channels(np.full((2, 3), 1000.0), dop, phi, angles), angles, SENSOR)
    assert np.allclose(image.dop, dop, atol=1e-9)
    assert np.allclose(np.sin(image.aop - phi), 0.0, atol=1e-9)
    assert np.allclose(image.I, 1000.0)


def test_angles_count_from_columns_towards_rows():
    """Light along image x passes the 0 deg polarizer; at 45 deg towards +y (down) the 45 deg one."""
    dark, bright, half = (np.full((1, 1), x) for x in (0.0, 1000.0, 500.0))
    assert np.allclose(from_channels([bright, half, dark, half], FOUR, SENSOR).aop, 0.0)
    assert np.allclose(from_channels([half, bright, half, dark], FOUR, SENSOR).aop, np.pi / 4.0)


def test_the_stated_noise_is_the_noise():
    rng = np.random.default_rng(0)
    exact = np.stack(channels(np.full((200, 200), 4000.0), 0.5, 0.4, FOUR))
    image = from_channels(rng.poisson(exact) + 2.0 * rng.standard_normal(exact.shape), FOUR, SENSOR)
    assert np.std(image.Q) == pytest.approx(image.sigma.mean(), rel=0.02)
    assert np.std(image.U) == pytest.approx(image.sigma.mean(), rel=0.02)
    assert np.std(image.aop) == pytest.approx(image.sigma_aop.mean(), rel=0.02)
    binned = from_channels(rng.poisson(exact), FOUR, SENSOR, factor=4)
    assert binned.I.shape == (50, 50)
    assert np.std(binned.Q) == pytest.approx(binned.sigma.mean(), rel=0.05)


def test_gains_are_found_from_the_light_itself():
    rng = np.random.default_rng(1)
    gains = np.array([1.05, 0.93, 1.01, 1.01])
    light = channels(
        rng.uniform(4e3, 9e3, 20_000), rng.uniform(0.1, 0.6, 20_000), rng.uniform(0, 3.14, 20_000), FOUR, gains
    )
    counts = rng.poisson(np.stack(light))
    found = estimate_gains(counts, FOUR, SENSOR)
    assert np.allclose(found, gains, atol=2e-3)
    with_, without = (from_channels([c[None] for c in counts], FOUR, SENSOR, gains=g) for g in (found, None))
    assert with_.redundancy < 0.6 * without.redundancy


def test_gains_of_uniform_light_are_refused():
    with pytest.raises(DataError, match="do not tell their gains"):
        estimate_gains(np.stack(channels(np.full(500, 5e3), 0.3, 0.5, FOUR)), FOUR, SENSOR)


def test_saturated_and_dark_pixels_are_marked():
    light = np.stack(channels(np.full((4, 4), 2000.0), 0.3, 0.2, FOUR))
    light[1, 0, 0] = 65_535.0
    light[:, 3, 3] = 0.0
    image = from_channels(light, FOUR, SENSOR)
    assert image.saturated.sum() == 1
    assert image.saturated[0, 0]
    assert image.dark.sum() == 1
    assert image.dark[3, 3]


@pytest.mark.parametrize("angles", [[0.0, 90.0], [0.0, 90.0, 180.0], [10.0, 10.0, 10.0, 10.0]])
def test_polarizers_that_tell_nothing_are_refused(angles):
    with pytest.raises(DataError, match="do not tell"):
        from_channels([np.ones((2, 2))] * len(angles), np.radians(angles), SENSOR)


def test_channels_of_different_sizes_are_refused():
    with pytest.raises(DataError, match="shapes"):
        from_channels([np.ones((2, 2))] * 3 + [np.ones((2, 3))], FOUR, SENSOR)
