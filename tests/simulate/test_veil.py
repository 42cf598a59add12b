"""The polarization of the light that the water scatters into view."""

import numpy as np
import pytest

from uwgraph.simulate.fields import cap_directions
from uwgraph.simulate.stokes import transmitted
from uwgraph.simulate.water import Downwelling, Water, veil

PURE = Water(absorption=0.18, scattering=0.22, scattering_dop=1.0)
COASTAL = Water(absorption=0.18, scattering=0.22)
GOLDEN = np.array([
    (90, 45, 0, 0, -32.117631, 1.000000),
    (90, 45, 45, 0, -24.562046, 0.754336),
    (200, 60, 30, 0, -10.302016, 0.373870),
    (200, 30, 250, 0, 17.400569, 0.890156),
    (120, 70, 10, 10, -42.355831, 0.977448),
    (120, 20, 300, -5, 0.000000, 0.790835),
])  # fmt: skip
"""Sun azimuth, sun zenith, view azimuth, view elevation, angle from the right towards up, degree of polarization."""


def towards(azimuth, elevation):
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)])


def sun_below(azimuth, zenith, n=1.33):
    """The sun's beam alone, below a flat surface."""
    w = towards(azimuth, np.pi / 2 - np.arcsin(np.sin(zenith) / n))[None]
    return Downwelling.of(w, transmitted(np.array([[1.0, 0.0, 0.0]]), np.cos([zenith]), -w[:, 2], n))


def degree_and_angle(light, depth, w, water=COASTAL):
    """Of the veil along w (N, 3); the angle from the right towards up, rad."""
    I, Q, U = veil(water, light, depth, w).T  # noqa: E741
    return np.hypot(Q, U) / I, -0.5 * np.arctan2(U, Q)  # the image's horizontal axis points to the left


@pytest.mark.parametrize("row", GOLDEN)
def test_one_beam_is_the_mueller_stokes_chain(row):
    """Refraction, scattering and detector of Powell et al. (Science Robotics 3, 2018), by their released code."""
    sun_azimuth, sun_zenith, view_azimuth, elevation = np.radians(row[:4])
    w = towards(view_azimuth, elevation)[None]
    degree, angle = degree_and_angle(sun_below(sun_azimuth, sun_zenith), 1e-9, w, PURE)
    assert np.degrees(angle[0]) == pytest.approx(row[4], abs=1e-5)
    assert degree[0] == pytest.approx(row[5], abs=1e-5)


def test_depth_takes_polarization_and_turns_it_to_the_horizontal():
    light, around = sun_below(0.3, 0.8), np.array([towards(azimuth, 0.0) for azimuth in np.linspace(0.0, 6.2, 40)])
    degree, angle = zip(*(degree_and_angle(light, depth, around) for depth in (1.0, 5.0, 20.0, 80.0)), strict=True)
    assert (np.diff([d.max() for d in degree]) < 0.0).all()
    assert (np.diff([np.abs(a).max() for a in angle]) < 0.0).all()
    assert degree[-1].max() < 0.15


def test_no_light_is_more_than_polarized():
    rng, w = np.random.default_rng(0), cap_directions(np.pi, 500)
    for _ in range(20):
        size, turn = rng.uniform(0.0, 1.0, 8), rng.uniform(0.0, 2 * np.pi, 8)
        stokes = np.column_stack([np.ones(8), size * np.cos(turn), size * np.sin(turn)])
        light = Downwelling.of(cap_directions(0.85, 8), stokes)
        assert degree_and_angle(light, 3.0, w, PURE)[0].max() <= 1.0 + 1e-12


def test_light_from_all_around_is_scattered_without_polarization():
    everywhere = cap_directions(np.pi, 4000)
    light = Downwelling.of(everywhere, np.column_stack([np.ones(4000), np.zeros((4000, 2))]))
    np.testing.assert_allclose(light.coherency, np.eye(3) / 3.0, atol=1e-3)
