"""The sun's place against published positions and plain astronomy."""

from datetime import UTC, datetime

import numpy as np
import pytest

from uwgraph.frames import R_n_local
from uwgraph.sun import sun_azimuth_elevation, sun_direction_n
from uwgraph.time import from_datetime
from uwgraph.types import Origin


def at(*when: int) -> np.ndarray:
    return np.array([from_datetime(datetime(*when, tzinfo=UTC))])


def test_reda_andreas_example():
    """The worked example of the SPA report: Golden, Colorado, 17 October 2003, 12:30:30 MST (in air)."""
    azimuth, elevation = sun_azimuth_elevation(at(2003, 10, 17, 19, 30, 30), *np.radians([39.742476, -105.1786]))
    assert np.degrees(azimuth[0]) == pytest.approx(194.34024, abs=1e-3)
    assert 90.0 - np.degrees(elevation[0]) == pytest.approx(50.11162, abs=5e-3)  # there at 1830 m and 820 hPa


def test_noon_at_the_equinox():
    day = at(2024, 3, 20, 0, 0, 0) + np.arange(0, 86_400, 10) * 10**9
    _, elevation = sun_azimuth_elevation(day, np.radians(43.0), 0.0)
    assert np.degrees(elevation.max()) == pytest.approx(47.0, abs=0.3)
    east, _ = sun_azimuth_elevation(at(2024, 3, 20, 7, 0, 0), np.radians(43.0), 0.0)
    assert 80.0 < np.degrees(east[0]) < 110.0


def test_direction_is_unit_up_and_turned_into_n():
    origin = Origin(lat=0.75, lon=0.1)
    t_ns = at(2024, 9, 10, 11, 0, 0) + np.arange(3) * 10**9
    far = np.full(3, 0.75), np.full(3, 0.104)
    s_n = sun_direction_n(origin, t_ns, *far)
    np.testing.assert_allclose(np.linalg.norm(s_n, axis=1), 1.0)
    azimuth, elevation = sun_azimuth_elevation(t_ns, *far)
    s_l = np.einsum("nji,nj->ni", R_n_local(origin, *far), s_n)
    np.testing.assert_allclose(np.arcsin(-s_l[:, 2]), elevation)
    np.testing.assert_allclose(np.arctan2(s_l[:, 1], s_l[:, 0]) % (2 * np.pi), azimuth)
    assert (s_n[:, 2] < -0.5).all()
    one_place = sun_direction_n(origin, t_ns, 0.75, 0.104)
    np.testing.assert_allclose(one_place, s_n, atol=1e-12)


def test_against_astropy_over_a_year_and_the_globe():
    coordinates = pytest.importorskip("astropy.coordinates")
    time, units = pytest.importorskip("astropy.time"), pytest.importorskip("astropy.units")
    from astropy.utils import iers

    rng = np.random.default_rng(0)
    t_ns = at(2024, 1, 1, 0, 0, 0) + (rng.uniform(0, 366 * 86_400, 300) * 1e9).astype(np.int64)
    lat, lon = np.arcsin(rng.uniform(-0.99, 0.99, 300)), rng.uniform(-np.pi, np.pi, 300)
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("iers_degraded_accuracy", "ignore"):
        when = time.Time(t_ns / 1e9, format="unix", scale="utc")
        place = coordinates.EarthLocation.from_geodetic(np.degrees(lon) * units.deg, np.degrees(lat) * units.deg)
        there = coordinates.get_sun(when).transform_to(coordinates.AltAz(obstime=when, location=place))
    azimuth, elevation = sun_azimuth_elevation(t_ns, lat, lon, refraction=False)
    assert np.degrees(np.abs(elevation - there.alt.rad)).max() < 1e-3
    across = (azimuth - there.az.rad + np.pi) % (2 * np.pi) - np.pi
    assert np.degrees(np.abs(across * np.cos(elevation))).max() < 1e-3


def test_air_lifts_the_sun():
    day = at(2024, 6, 21, 0, 0, 0) + np.arange(0, 86_400, 600) * 10**9
    azimuth, apparent = sun_azimuth_elevation(day, 0.7, 0.0)
    same_azimuth, geometric = sun_azimuth_elevation(day, 0.7, 0.0, refraction=False)
    np.testing.assert_array_equal(azimuth, same_azimuth)
    up = geometric > np.radians(1.0)
    lift = np.degrees(apparent - geometric)
    assert (lift[up] > 0.0).all()
    assert lift[up].max() < 0.45
    assert lift[geometric > np.radians(45.0)].max() < 0.02
    origin = Origin(lat=0.7, lon=0.0)
    s_n = sun_direction_n(origin, day, 0.7, 0.0, refraction=False)
    np.testing.assert_allclose(np.arcsin(-s_n[:, 2]), geometric, atol=1e-12)
