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
