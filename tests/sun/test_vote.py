"""The vote on the sun's azimuth, and the eigenvector that it starts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from polar_sky import UP, evectors, sun_at

from uwgraph.frames import matrix_from_rph, wrap_pi
from uwgraph.sun.eigen import Evectors, covariance, from_azimuth, solve
from uwgraph.sun.observation import azimuth_in_level
from uwgraph.sun.vote import candidates, vote

ANGLE = st.floats(-3.1, 3.1)


@given(
    azimuth=ANGLE,
    zenith=st.floats(0.1, 1.5),
    roll=st.floats(-0.6, 0.6),
    pitch=st.floats(-0.6, 0.6),
    seed=st.integers(0, 99),
)
def test_one_of_the_two_candidates_is_the_sun_at_any_tilt(azimuth, zenith, roll, pitch, seed):
    R = matrix_from_rph(np.array([roll, pitch, 0.0]))
    up_b = R.T @ UP
    s_b = from_azimuth(azimuth, zenith, up_b)
    a_b = np.random.default_rng(seed).standard_normal((50, 3))
    e_b = np.cross(a_b, s_b)
    e_b /= np.linalg.norm(e_b, axis=1)[:, None]
    off = np.abs(wrap_pi(candidates(e_b, up_b, zenith) - azimuth))
    # where the branches merge, rounding may lose the root
    sure = np.isfinite(off).all(axis=1)
    assert sure.mean() > 0.8
    assert np.nanmin(off[sure], axis=1).max() < 1e-6


@pytest.mark.parametrize("zenith_deg", [20.0, 50.0, 80.0])
def test_true_branches_pile_up(zenith_deg):
    zenith = np.radians(zenith_deg)
    sky = evectors(np.random.default_rng(0), sun_at(1.0, zenith), np.radians(1.0))
    found = vote(sky.a_b, sky.e_b, sky.sigma, UP, zenith)
    assert abs(wrap_pi(found.azimuth - 1.0)) < np.radians(0.1)
    assert found.ratio < 0.5


def test_a_sun_on_the_horizon_has_two_modes():
    zenith = np.radians(89.0)
    sky = evectors(np.random.default_rng(0), sun_at(1.0, zenith), np.radians(1.0))
    found = vote(sky.a_b, sky.e_b, sky.sigma, UP, zenith)
    assert found.ratio > 0.5
    assert abs(abs(wrap_pi(found.azimuth - found.other)) - np.pi) < np.radians(5.0)


def test_no_voters_no_azimuth():
    found = vote(np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]]), np.ones(1), UP, 0.3)
    assert np.isnan(found.azimuth)
    assert np.isnan(found.other)
    assert found.ratio == 0.0


@pytest.mark.parametrize(
    ("noise", "random", "limit"), [(0.0, 0.0, 1e-6), (2.0, 0.0, 0.1), (2.0, 0.5, 0.2), (4.0, 0.8, 1.5)]
)
@pytest.mark.parametrize("known", [True, False])
def test_the_direction_survives_noise_and_outliers(noise, random, limit, known):
    for seed, zenith_deg in enumerate((25.0, 45.0, 65.0, 85.0)):
        s_b = sun_at(0.3 + seed, np.radians(zenith_deg))
        sky = evectors(np.random.default_rng(seed), s_b, np.radians(noise), random=random)
        found = solve(sky, UP, np.radians(zenith_deg) if known else None)
        error = azimuth_in_level(found.fit.s_b, UP) - azimuth_in_level(s_b, UP)
        assert abs(np.degrees(wrap_pi(error))) < limit
        assert (found.vote is None) == (not known)


@pytest.mark.parametrize("random", [0.0, 0.5])
def test_the_covariance_is_that_of_the_errors(random):
    """NEES over 2 degrees of freedom, one-sided views included (noise must not pull the direction into the view)."""
    nees = []
    for seed in range(50):
        rng = np.random.default_rng(seed)
        s_b = sun_at(rng.uniform(-3, 3), rng.uniform(0.4, 1.4))
        sky = evectors(rng, s_b, np.radians(6.0), count=2500, half_field=1.0, random=random)
        half = sky.a_b[:, 0] > 0.0
        sky = Evectors(sky.a_b[half], sky.e_b[half], sky.sigma[half], np.arange(half.sum()))
        found = solve(sky, UP, float(np.arccos(s_b @ UP)))
        d = found.fit.E.T @ s_b
        nees.append(d @ np.linalg.solve(covariance(sky, found.fit), d) / 2.0)
    assert 0.65 < np.mean(nees) < 1.45


@settings(max_examples=20, deadline=None)
@given(roll=ANGLE, pitch=st.floats(-1.4, 1.4), heading=ANGLE)
def test_the_direction_turns_with_the_body(roll, pitch, heading):
    sky = evectors(np.random.default_rng(3), sun_at(0.5, 0.9), 0.02, count=1000)
    R = matrix_from_rph(np.array([roll, pitch, heading])).T
    turned = Evectors(sky.a_b @ R.T, sky.e_b @ R.T, sky.sigma, sky.block)
    assert np.allclose(solve(turned, R @ UP, 0.9).fit.s_b, R @ solve(sky, UP, 0.9).fit.s_b, atol=1e-6)


def test_a_second_sun_is_a_rival():
    """Two thirds of the sky from one sun and a third from another, both at the almanac's height."""
    one, two = sun_at(0.0, 0.9), sun_at(2.0, 0.9)
    first = evectors(np.random.default_rng(0), one, 0.01, count=2000)
    second = evectors(np.random.default_rng(1), two, 0.01, count=1000)
    both = Evectors(
        *(np.concatenate([getattr(first, k), getattr(second, k)]) for k in ("a_b", "e_b", "sigma", "block"))
    )
    found = solve(both, UP, 0.9)
    assert np.allclose(found.fit.s_b, one, atol=0.01)
    assert found.rival_b is not None
    assert np.allclose(found.rival_b, two, atol=0.02)
    assert found.rivalry == pytest.approx(0.5, abs=0.15)
