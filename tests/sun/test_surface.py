"""The flat surface of the water: Snell, Fresnel, the window, the index."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwgraph.camera.refraction import refract, refract_jacobian, refractive_index
from uwgraph.sun.surface import (
    fresnel_amplitudes,
    in_window,
    path_transmittance,
    radiance_factor,
    to_air,
    to_water,
    transmission_mueller,
    transmittance,
    window_half_angle,
)

INDEX = st.floats(1.32, 1.36)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def tilted_sky(seed, count=200):
    """An up vector, and rays in air above its horizon."""
    rng = np.random.default_rng(seed)
    up = unit(rng.standard_normal(3))
    a = unit(rng.standard_normal((count, 3)))
    return up, np.where((a @ up < 0.0)[:, None], -a, a)


@given(seed=st.integers(0, 1000), n=INDEX)
def test_into_the_water_and_back(seed, n):
    up, a = tilted_sky(seed)
    a = a[a @ up > 0.02]
    w = to_water(a, up, n)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, atol=1e-13)
    np.testing.assert_allclose(to_air(w, up, n), a, atol=1e-12)
    np.testing.assert_allclose(n * np.cross(up, w), np.cross(up, a), atol=1e-13)  # Snell, and the same azimuth
    assert (w @ up > np.cos(window_half_angle(n))).all()


@pytest.mark.parametrize("n", [1.34, 1 / 1.34])
def test_jacobian_of_refraction(n):
    up, r = tilted_sky(3)
    r = r[r @ up > (0.75 if n < 1 else 0.02)]
    J = refract_jacobian(r, up, n)
    h = 1e-6
    for tangent in (unit(np.cross(r, [1.0, 0.3, 0.2])), unit(np.cross(np.cross(r, [1.0, 0.3, 0.2]), r))):
        ahead, behind = (refract(unit(r + sign * h * tangent), up, n) for sign in (1, -1))
        np.testing.assert_allclose(np.einsum("nij,nj->ni", J, tangent), (ahead - behind) / (2 * h), atol=3e-8)


@pytest.mark.parametrize(("n", "half_deg"), [(1.33, 48.75), (1.34, 48.27)])
def test_half_angle_of_the_window(n, half_deg):
    assert np.degrees(window_half_angle(n)) == pytest.approx(half_deg, abs=5e-3)


def test_outside_the_window_is_nan():
    up = np.array([0.0, 0.0, -1.0])
    for zenith, seen in ((47.0, True), (50.0, False), (120.0, False)):
        w = np.array([[np.sin(np.radians(zenith)), 0.0, -np.cos(np.radians(zenith))]])
        assert bool(np.isfinite(to_air(w, up, 1.34)).all()) is seen
        assert bool(in_window(w, up, 1.34, np.radians(80.0))[0]) is seen


def test_margin_of_the_window():
    up, n, most = np.array([0.0, 0.0, -1.0]), 1.34, np.radians(75.0)
    theta = np.arcsin(np.sin(most + np.radians([-1.0, 1.0])) / n)
    w = np.stack([np.zeros(2), np.sin(theta), -np.cos(theta)], axis=1)
    assert in_window(w, up, n, most).tolist() == [True, False]


@pytest.mark.parametrize(("zenith", "T"), [(0, 0.9789), (30, 0.9778), (60, 0.9390), (80, 0.6498), (85, 0.4147)])
def test_transmittance_values(zenith, T):
    cos = np.cos(np.radians(zenith))
    assert transmittance(cos, 1.34) == pytest.approx(T, abs=5e-5)
    assert radiance_factor(cos, 1.34) == pytest.approx(T * 1.34**2, abs=1e-4)


@given(cos=st.floats(0.01, 1.0), n=INDEX)
def test_amplitudes_keep_the_energy(cos, n):
    t_s, t_p = fresnel_amplitudes(cos, n)
    cos_w = np.sqrt(1 - (1 - cos**2) / n**2)
    assert n * cos_w / cos * (t_s**2 + t_p**2) / 2 == pytest.approx(float(transmittance(cos, n)), abs=1e-12)


@given(cos=st.floats(0.01, 1.0), n=INDEX, angle=st.floats(0, np.pi), ellipticity=st.floats(-np.pi / 4, np.pi / 4))
def test_mueller_is_admissible(cos, n, angle, ellipticity):
    """Fully polarized light stays fully polarized (one amplitude matrix), and no power is made."""
    M = transmission_mueller(cos, n)
    flat = np.cos(2 * ellipticity)
    S = M @ np.array([1.0, flat * np.cos(2 * angle), flat * np.sin(2 * angle), np.sin(2 * ellipticity)])
    assert np.linalg.norm(S[1:]) == pytest.approx(S[0], rel=1e-12)
    cos_w = np.sqrt(1 - (1 - cos**2) / n**2)
    assert n * cos_w / cos * S[0] <= 1.0 + 1e-12


def test_unpolarized_light_comes_out_upright():
    assert (transmission_mueller(np.cos(np.radians([20.0, 50.0, 80.0])), 1.34)[:, 1, 0] < 0.0).all()


def test_path_transmittance():
    assert path_transmittance(0.5, 3.0, 0.1) == pytest.approx(np.exp(-0.6))


@pytest.mark.parametrize(
    ("S", "T", "wavelength", "n"),
    [
        (0.0, 20.0, 404.66, 1.342724),  # pure water against air: Tilton & Taylor 1938
        (0.0, 20.0, 486.13, 1.337123),
        (0.0, 20.0, 546.07, 1.334466),
        (0.0, 20.0, 589.26, 1.332988),
        (0.0, 20.0, 656.28, 1.331151),
        (35.0, 20.0, 589.26, 1.33940),  # sea water: Austin & Halikas 1976
    ],
)
def test_refractive_index(S, T, wavelength, n):
    assert refractive_index(S, T, wavelength) == pytest.approx(n, abs=1e-4)


def test_refractive_index_grows_with_salt_and_cold():
    assert refractive_index(35.0) > refractive_index(10.0)
    assert refractive_index(35.0, 5.0) > refractive_index(35.0, 25.0)
    assert refractive_index(35.0, 15.0, 450.0) > refractive_index(35.0, 15.0, 650.0)
