"""Waves with the published statistics, and water that takes light and polarization away but makes none."""

import numpy as np
import pytest

from uwgraph.simulate.fields import cap_directions
from uwgraph.simulate.sea import GRAVITY, Sea, cox_munk
from uwgraph.simulate.water import Downwelling, Water, blurred, veil

RNG = np.random.default_rng
COASTAL = Water(absorption=0.18, scattering=0.22)


@pytest.mark.parametrize("wind", [0.7, 3.0, 10.0])
def test_slopes_have_the_variance_of_cox_and_munk(wind):
    """Over many seas and places, along and across a wind from 30 degrees; the mean slope is none."""
    from_ = np.radians(30.0)
    along, across = np.array([np.cos(from_), np.sin(from_)]), np.array([-np.sin(from_), np.cos(from_)])
    places = RNG(0).uniform(-500.0, 500.0, (500, 2))
    slopes = np.concatenate([Sea.draw(RNG(seed), wind, from_).slope(places, 10.0 * seed) for seed in range(20)])
    expected_along, expected_across = cox_munk(wind)
    assert (slopes @ along).var() == pytest.approx(expected_along, rel=0.05)
    assert (slopes @ across).var() == pytest.approx(expected_across, rel=0.05)
    assert np.abs(slopes.mean(axis=0)).max() < 0.02


def test_slope_is_the_gradient_of_the_height():
    sea = Sea.draw(RNG(1), 5.0, swell_height=1.5)
    long = sea.at(np.zeros(2), 3.0).long(1.0)
    places, h = RNG(2).uniform(-5.0, 5.0, (300, 2)), 0.02
    for axis in (0, 1):
        step = h * np.eye(2)[axis]
        numeric = (long.height(places + step) - long.height(places - step)) / (2 * h)
        np.testing.assert_allclose(numeric, long.slope(places)[:, axis], atol=2e-3)


def test_waves_travel_with_the_wind_by_the_dispersion_relation():
    """Pure swell from the north: a crest moves south at g T / 2 pi."""
    sea = Sea.draw(RNG(3), 0.0, swell_height=1.0, swell_period=8.0, swell_from=0.0)
    np.testing.assert_allclose(sea.omega**2, GRAVITY * np.linalg.norm(sea.k, axis=1), rtol=1e-3)
    speed = GRAVITY * 8.0 / (2 * np.pi)
    north = np.arange(-60.0, 60.0, 0.1)
    line = np.column_stack([north, np.zeros_like(north)])
    now, later = sea.height(line, 0.0), sea.height(line, 1.0)
    lags = np.arange(-300, 301)
    match = [np.corrcoef(now[300:-300], later[300 + lag : len(later) - 300 + lag])[0, 1] for lag in lags]
    assert 0.1 * lags[np.argmax(match)] == pytest.approx(-speed, rel=0.1)


def test_swell_has_its_significant_height():
    heights = [
        Sea.draw(RNG(s), 0.0, swell_height=2.0).height(RNG(s).uniform(-9e3, 9e3, (4000, 2)), 0.0) for s in range(8)
    ]
    assert 4.0 * np.concatenate(heights).std() == pytest.approx(2.0, rel=0.05)


def test_a_patch_far_away_is_the_same_sea():
    """Single precision is taken relative to the patch, not to the origin."""
    sea, far = Sea.draw(RNG(4), 5.0), np.array([9000.0, -7000.0])
    places = RNG(5).uniform(-5.0, 5.0, (200, 2))
    exact = np.sin((places + far) @ sea.k.T - sea.omega * 100.0 + sea.phase) @ (-sea.amplitude[:, None] * sea.k)
    np.testing.assert_allclose(sea.at(far, 100.0).slope(places), exact, atol=2e-4)


def test_calm_is_flat():
    assert len(Sea.draw(RNG(0), 0.0).k) == 0
    assert not Sea.draw(RNG(0), 0.0).slope(np.zeros((3, 2)), 5.0).any()


def test_blur_keeps_the_light_and_narrows_nothing():
    image = np.full((200, 220, 3), 0.5)  # the grey margin catches what leaves the middle
    image[80:120, 80:140] = RNG(0).uniform(0.0, 1.0, (40, 60, 3))
    once, twice = (blurred(image, COASTAL, path, 60.0) for path in (5.0, 20.0))
    for result in (once, twice):
        np.testing.assert_allclose(result.mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=1e-3)
    assert image.std() > once.std() > twice.std()
    np.testing.assert_allclose(blurred(np.ones((37, 53, 1)), COASTAL, 10.0, 60.0), 1.0, atol=1e-12)


def test_blur_of_a_point_is_wells_phase_function():
    """Little scattering: what leaves the point is b_f s times theta_0 / (2 pi (theta_0^2 + theta^2)^(3/2))."""
    focal, path, water = 150.0, 0.1, Water(absorption=0.0, scattering=0.5, blur=0.04)
    point = np.zeros((401, 401, 1))
    point[200, 200] = 1.0
    seen = blurred(point, water, path, focal)[200, :, 0]
    once = water.forward * path
    assert seen[200] == pytest.approx(np.exp(-once), rel=2e-3)
    theta = np.array([5, 10, 20, 40]) / focal
    expected = once * water.blur / (2 * np.pi * (water.blur**2 + theta**2) ** 1.5) / focal**2
    np.testing.assert_allclose(seen[200 + np.array([5, 10, 20, 40])], expected, rtol=0.05)


def beam(axis):
    return Downwelling.of(np.array([axis]), np.array([[1.0 / -axis[2], 0.0, 0.0]]))


def onto_horizontal(radiance, w):
    return 2 * np.pi * np.mean(radiance * -w[:, 2])


def test_irradiance_falls_with_depth_and_no_light_is_made():
    axis = np.array([np.sin(0.6), 0.0, -np.cos(0.6)])
    light, w = beam(axis), cap_directions(np.pi / 2, 5000)
    total = []
    for depth in (0.0, 1.0, 5.0, 20.0, 60.0):
        image = np.exp(-COASTAL.lost * depth / np.cos(0.6))
        total.append(image + onto_horizontal(veil(COASTAL, light, depth, w)[:, 0], w))
    assert total[0] == pytest.approx(1.0, abs=1e-9)
    assert (np.diff(total) < 0.0).all()
    K_d = COASTAL.diffuse_attenuation(float(np.cos(0.6)))
    np.testing.assert_allclose(total, np.exp(-K_d * np.array([0.0, 1.0, 5.0, 20.0, 60.0])), rtol=1e-3)
    assert COASTAL.absorption < K_d < (COASTAL.absorption + COASTAL.scattering) / np.cos(0.6)


def test_veil_turns_to_the_zenith_with_depth():
    azimuth = np.linspace(0.0, 1.2, 200)
    w = np.column_stack([np.sin(azimuth), np.zeros(200), -np.cos(azimuth)])
    light = beam(np.array([np.sin(0.6), 0.0, -np.cos(0.6)]))
    brightest = [azimuth[np.argmax(veil(COASTAL, light, depth, w)[:, 0])] for depth in (0.5, 5.0, 20.0, 80.0)]
    assert (np.diff(brightest) < 0.0).all()
    assert brightest[0] == pytest.approx(0.6, abs=0.05)
    assert brightest[-1] < 0.05


def test_clear_water_without_scattering_has_no_veil():
    light = beam(np.array([0.0, 0.0, -1.0]))
    assert not veil(Water(0.1, 0.0), light, 10.0, np.array([[0.0, 0.0, -1.0]]))[0, 0] > 1e-12
