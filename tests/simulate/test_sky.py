"""The simulated sky against the published formulas, and what clouds and occluders do to it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.simulate.cover import SKY_IN_VIEW, Clouds, Occluder
from uwgraph.simulate.fields import SphereField, cap_directions, level_for_share
from uwgraph.simulate.sky import CIE_SKIES, SUN_RADIUS, Sky, angle_between, horizontal_axis

SKY_DIRECTIONS = cap_directions(np.radians(88.0), 4000)


def toward(zenith_deg: float, azimuth_deg: float):
    z, a = np.radians([zenith_deg, azimuth_deg])
    return np.array([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), -np.cos(z)])


def e_vectors(d, stokes):
    aop = 0.5 * np.arctan2(stokes[:, 2], stokes[:, 1])
    x = horizontal_axis(d)
    return np.cos(aop)[:, None] * x + np.sin(aop)[:, None] * np.cross(d, x)


suns = st.builds(toward, st.floats(0.0, 85.0), st.floats(0.0, 360.0))


def test_cie_types_are_those_of_the_standard():
    """Overcast type 1 fits Moon and Spencer's (1 + 2 cos Z) / 3, horizon included; type 5 is uniform; 12 is clear."""
    zenith = np.radians([*range(0, 70, 5), 89.99])
    moon = (1.0 + 2.0 * np.cos(zenith)) / 3.0
    overcast = CIE_SKIES[1].relative_radiance(np.cos(zenith), zenith, 0.5)
    np.testing.assert_allclose(overcast, moon, atol=0.04)
    zenith = zenith[:-1]
    np.testing.assert_allclose(CIE_SKIES[5].relative_radiance(np.cos(zenith), zenith, 0.5), 1.0, atol=1e-12)
    clear = CIE_SKIES[12]
    assert (clear.a, clear.b, clear.c, clear.d, clear.e) == (-1.0, -0.32, 10.0, -3.0, 0.45)
    assert len(CIE_SKIES) == 15


@pytest.mark.parametrize("kind", CIE_SKIES)
def test_radiance_follows_the_published_formula(kind):
    cie, s = CIE_SKIES[kind], toward(40.0, 70.0)
    d = SKY_DIRECTIONS[::37]
    for direction, got in zip(d, Sky(s, cie).stokes(d)[:, 0], strict=True):
        Z, chi, Zs = np.arccos(-direction[2]), np.arccos(np.clip(direction @ s, -1, 1)), np.radians(40.0)
        f, f_s = (
            1 + cie.c * (np.exp(cie.d * x) - np.exp(cie.d * np.pi / 2)) + cie.e * np.cos(x) ** 2 for x in (chi, Zs)
        )
        phi, phi_0 = (1 + cie.a * np.exp(cie.b / np.cos(x)) for x in (Z, 0.0))
        assert got == pytest.approx(f * phi / (f_s * phi_0), rel=1e-9)


@given(suns, st.floats(0.0, 0.4), st.floats(0.1, 1.0))
@settings(max_examples=30, deadline=None)
def test_polarization_never_exceeds_its_maximum(s, neutral, dop_max):
    seen = Sky(s, dop_max=dop_max, neutral_angle=neutral).stokes(SKY_DIRECTIONS)
    assert np.hypot(seen[:, 1], seen[:, 2]).max() <= dop_max * seen[:, 0].max() * (1 + 1e-12)
    assert (np.hypot(seen[:, 1], seen[:, 2]) <= dop_max * seen[:, 0] * (1 + 1e-12)).all()


@given(suns)
@settings(max_examples=20, deadline=None)
def test_rayleigh_e_vectors_are_across_the_plane_of_scattering(s):
    seen = Sky(s, neutral_angle=0.0).stokes(SKY_DIRECTIONS)
    far = angle_between(SKY_DIRECTIONS, s) > 0.01
    np.testing.assert_allclose(e_vectors(SKY_DIRECTIONS, seen)[far] @ s, 0.0, atol=1e-9)
    cos_gamma = SKY_DIRECTIONS @ s
    dop = np.hypot(seen[:, 1], seen[:, 2]) / seen[:, 0]
    np.testing.assert_allclose(dop, 0.75 * (1 - cos_gamma**2) / (1 + cos_gamma**2), atol=1e-12)


def test_neutral_points_are_beside_the_sun_in_its_meridian():
    """Low sun: Babinet's point above it at nearly the asked angle, and vertical polarization between the two."""
    sun_zenith = 80.0
    above = np.arange(3.0, 40.0, 0.05)
    d = np.stack([toward(sun_zenith - x, 30.0) for x in above])
    seen = Sky(toward(sun_zenith, 30.0)).stokes(d)
    neutral = above[np.argmin(np.hypot(seen[:, 1], seen[:, 2]) / seen[:, 0])]
    assert 12.0 < neutral < 15.0
    assert seen[above < neutral - 1.0, 1].max() < 0.0 < seen[above > neutral + 1.0, 1].min()
    np.testing.assert_allclose(seen[:, 2], 0.0, atol=1e-9)


def test_sun_disc_carries_its_irradiance():
    s = toward(30.0, 200.0)
    sky = Sky(s, sun_irradiance=20.0, sun_radius=0.02)
    offsets = np.random.default_rng(0).uniform(-0.03, 0.03, (200_000, 2))
    east = np.cross(s, [0.0, 0.0, 1.0])
    east /= np.linalg.norm(east)
    d = s + offsets[:, :1] * east + offsets[:, 1:] * np.cross(s, east)
    d /= np.linalg.norm(d, axis=1)[:, None]
    extra = sky.stokes(d)[:, 0] - Sky(s).stokes(d)[:, 0]
    assert extra.mean() * 0.06**2 == pytest.approx(20.0, rel=0.02)
    assert np.degrees(SUN_RADIUS) == pytest.approx(0.2666)


def test_nothing_comes_from_below_the_horizon():
    assert not Sky(toward(40.0, 0.0)).stokes(-SKY_DIRECTIONS).any()


def test_field_is_standard_and_smooth():
    field = SphereField.draw(np.random.default_rng(5), size=0.2)
    values = field(cap_directions(np.pi, 20_000))
    assert abs(values.mean()) < 0.15
    assert values.std() == pytest.approx(1.0, abs=0.15)
    d = SKY_DIRECTIONS
    moved = d + 1e-3 * np.cross(d, [1.0, 0.0, 0.0])
    assert np.abs(field(moved / np.linalg.norm(moved, axis=1)[:, None]) - field(d)).max() < 0.1


@pytest.mark.parametrize("shape", ["sector", "hull", "wall", "canopy"])
@pytest.mark.parametrize("share", [0.2, 0.4, 0.8])
def test_occluder_hides_exactly_its_share_of_the_sky(shape, share):
    d = cap_directions(SKY_IN_VIEW, 15_000)
    body = Occluder.draw(np.random.default_rng(3), shape, share, 0.2, "random", 0.5)
    clear, seen = Sky(toward(50.0, 10.0)), Sky(toward(50.0, 10.0), layers=(body,))
    hidden = (clear.stokes(d) != seen.stokes(d)).any(axis=1)
    assert hidden.mean() == pytest.approx(share, abs=0.01)


def test_clutter_of_a_false_sun_points_at_it_and_not_at_the_sun():
    s = toward(50.0, 10.0)
    body = Occluder.draw(np.random.default_rng(4), "wall", 0.5, 0.3, "false_sun", 0.6)
    seen, clear = Sky(s, layers=(body,)).stokes(SKY_DIRECTIONS), Sky(s).stokes(SKY_DIRECTIONS)
    hidden = (seen != clear).any(axis=1)
    e = e_vectors(SKY_DIRECTIONS, seen)[hidden]
    np.testing.assert_allclose(e @ body.false_s_l, 0.0, atol=1e-9)
    assert np.abs(e @ s).mean() > 0.2


def test_clouds_depolarize_and_cover_their_share():
    s = toward(50.0, 10.0)
    clouds = Clouds.draw(np.random.default_rng(1), 0.4, 2.0, 0.3)
    d = cap_directions(SKY_IN_VIEW, 15_000)
    clear, cloudy = (Sky(s, layers=layers).stokes(d) for layers in ((), (clouds,)))
    dop_clear, dop_cloudy = (np.hypot(x[:, 1], x[:, 2]) / x[:, 0] for x in (clear, cloudy))
    assert (dop_cloudy <= dop_clear + 1e-12).all()
    high = dop_clear > 0.2
    assert (dop_cloudy[high] < 0.5 * dop_clear[high]).mean() == pytest.approx(0.4, abs=0.12)


def test_level_for_no_and_for_all_of_the_sky():
    field = SphereField.draw(np.random.default_rng(5), size=0.2)
    assert level_for_share(field, 0.0, 1.0) == np.inf
    assert level_for_share(field, 1.0, 1.0) == -np.inf
