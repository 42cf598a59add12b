"""The Mueller-Stokes chain of sunlight in the water."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwgraph.sun.scattering import aop, dolp, scattered_aop, scattered_stokes, sun_from_sine, wrap_half
from uwgraph.sun.surface import transmission_mueller

# sun azimuth, sun zenith, view azimuth, view elevation [deg], AoP [deg], degree of polarization; n = 1.33
# (Powell et al. 2018, their released program)
GOLDEN = [
    (90, 45, 0, 0, -32.117631, 1.000000),
    (90, 45, 45, 0, -24.562046, 0.754336),
    (200, 60, 30, 0, -10.302016, 0.373870),
    (200, 30, 250, 0, 17.400569, 0.890156),
    (120, 70, 10, 10, -42.355831, 0.977448),
    (120, 20, 300, -5, 0.000000, 0.790835),
]
ANGLE, ZENITH, ELEVATION = st.floats(-3.1, 3.1), st.floats(0.02, 1.55), st.floats(-1.4, 1.4)


def chain(sun_azimuth, sun_zenith, view_azimuth, view_elevation, n, max_dolp):
    """The chain in three-dimensional vectors and 4x4 matrices, (east, north, up), one ray at a time."""

    def rotation(old, new, k):
        angle = np.arctan2(np.cross(old, new) @ k, old @ new)
        c, s = np.cos(2 * angle), np.sin(2 * angle)
        return np.array([[1, 0, 0, 0], [0, c, s, 0], [0, -s, c, 0], [0, 0, 0, 1]])

    def unit(v):
        return v / np.linalg.norm(v)

    up = np.array([0.0, 0.0, 1.0])
    k_i = -np.array([np.sin(sun_azimuth) * np.sin(sun_zenith), np.cos(sun_azimuth) * np.sin(sun_zenith),
                     np.cos(sun_zenith)])  # fmt: skip
    c = -k_i @ up
    k_t = k_i / n + up * (c / n - np.sqrt(1 - (1 - c * c) / n**2))
    k_s = -np.array([np.sin(view_azimuth) * np.cos(view_elevation), np.cos(view_azimuth) * np.cos(view_elevation),
                     np.sin(view_elevation)])  # fmt: skip
    normal = unit(np.cross(k_t, k_s))
    mu = k_t @ k_s
    a, q = max_dolp * (mu**2 - 1) / (mu**2 + 1), 2 * mu / (mu**2 + 1)
    scattering = np.array([[1, a, 0, 0], [a, 1, 0, 0], [0, 0, q, 0], [0, 0, 0, q]])
    S = transmission_mueller(c, n) @ np.array([1.0, 0.0, 0.0, 0.0])
    S = rotation(unit(np.cross(up, k_i)), np.cross(normal, k_t), k_t) @ S
    return rotation(np.cross(normal, k_s), unit(np.cross(up, k_s)), k_s) @ scattering @ S


@pytest.mark.parametrize("row", GOLDEN)
def test_golden_vectors(row):
    S = scattered_stokes(*np.radians(row[:4]), n=1.33)
    assert np.degrees(aop(S)) == pytest.approx(row[4], abs=1e-6)
    assert dolp(S) == pytest.approx(row[5], abs=1e-6)


@given(ANGLE, ZENITH, ANGLE, ELEVATION, st.floats(1.3, 1.4), st.floats(0.3, 1.0))
def test_against_the_chain_in_vectors(sun_azimuth, sun_zenith, view_azimuth, view_elevation, n, max_dolp):
    S = scattered_stokes(sun_azimuth, sun_zenith, view_azimuth, view_elevation, n, max_dolp)
    long = chain(sun_azimuth, sun_zenith, view_azimuth, view_elevation, n, max_dolp)
    np.testing.assert_allclose(S, long[:3], atol=1e-9)
    assert long[3] == pytest.approx(0.0, abs=1e-12)
    assert 0.0 <= dolp(S) <= 1.0 + 1e-12


@given(ANGLE, ZENITH, ANGLE, ELEVATION)
def test_mirrored_about_the_suns_vertical(sun_azimuth, sun_zenith, turn, view_elevation):
    left = scattered_stokes(sun_azimuth, sun_zenith, sun_azimuth - turn, view_elevation)
    right = scattered_stokes(sun_azimuth, sun_zenith, sun_azimuth + turn, view_elevation)
    np.testing.assert_allclose(left, right * [1, 1, -1], atol=1e-12)


def test_shapes_broadcast():
    S = scattered_stokes(np.zeros((4, 1)), np.full((4, 1), 0.5), np.zeros(7), 0.1)
    assert S.shape == (4, 7, 3)
    assert scattered_aop(0.0, 0.5, np.zeros(7)).shape == (7,)


def test_straight_into_the_beam_is_what_came_through_the_surface():
    S = scattered_stokes(0.3, 0.5, 0.3, np.pi / 2 - np.arcsin(np.sin(0.5) / 1.33), n=1.33)
    np.testing.assert_allclose(S, transmission_mueller(np.cos(0.5), 1.33)[:3, 0], atol=1e-9)
    assert np.isfinite(scattered_stokes(0.3, 0.0, 0.3, np.pi / 2)).all()


def test_weaker_scattering_polarizes_less():
    view = np.radians(np.arange(0, 360, 15.0))
    assert (dolp(scattered_stokes(1.0, 0.7, view, 0.0, 1.33, 0.7)) < dolp(scattered_stokes(1.0, 0.7, view))).all()


@pytest.mark.parametrize(("zenith_deg", "off_deg"), [(10, 0.006), (30, 0.18), (45, 0.81), (60, 2.8), (80, 14.0)])
def test_how_near_the_sine_is_to_the_chain(zenith_deg, off_deg):
    view = np.radians(np.arange(0, 360, 1.0))
    zenith = np.radians(zenith_deg)
    sine = np.arctan(np.tan(np.arcsin(np.sin(zenith) / 1.33)) * np.sin(view - 2.0))
    exact = scattered_aop(2.0, zenith, view)
    assert np.degrees(np.abs(wrap_half(exact - sine)).max()) == pytest.approx(off_deg, rel=0.02, abs=6e-4)
    across = np.array([2.0 - np.pi / 2, 2.0 + np.pi / 2])
    np.testing.assert_allclose(np.abs(scattered_aop(2.0, zenith, across)), np.arcsin(np.sin(zenith) / 1.33), atol=1e-12)


@given(azimuth=ANGLE, zenith=st.floats(0.2, 1.2), seed=st.integers(0, 100))
def test_closed_form_start(azimuth, zenith, seed):
    view = np.radians(np.arange(0, 360, 10.0))
    aops = scattered_aop(azimuth, zenith, view) + np.radians(1.0) * np.random.default_rng(seed).standard_normal(36)
    found_azimuth, found_zenith = sun_from_sine(view, aops + np.pi * (seed % 3), np.ones(36), 1.33)
    assert abs(np.degrees((found_azimuth - azimuth + np.pi) % (2 * np.pi) - np.pi)) < 6.0
    assert abs(np.degrees(found_zenith - zenith)) < 12.0


def test_wrap_half():
    np.testing.assert_allclose(wrap_half([0.1, np.pi + 0.1, -np.pi / 2, 2.0]), [0.1, 0.1, -np.pi / 2, 2.0 - np.pi])
