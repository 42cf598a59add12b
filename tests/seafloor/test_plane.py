"""Planes through soundings, and rays that meet them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.seafloor.plane import Soundings, meet, plane_at

SECOND = 10**9
HERE = np.array([100.0, -50.0, 7.0])


def soundings(slope: float = 0.05, noise: float = 0.02, count: int = 161, sigma: float = 0.02) -> Soundings:
    """Along a track to the north through ``HERE``, 3 m above a slope."""
    rng = np.random.default_rng(1)
    along = np.linspace(-8.0, 8.0, count)
    points = HERE + np.column_stack([along, 0.05 * rng.normal(size=count), 3.0 + slope * along])
    points[:, 2] += rng.normal(0.0, noise, count)
    return Soundings(
        np.round(along / 0.8 * SECOND).astype(np.int64), points, np.full(count, sigma), np.full(count, 3.0)
    )


def test_slope_along_is_measured_and_across_is_the_prior() -> None:
    plane = plane_at(soundings(), 0, HERE, 0.1)
    assert plane is not None
    assert abs(plane.theta[0] - 3.0) < 0.01
    assert abs(plane.theta[1] - 0.05) < 0.01
    assert abs(plane.theta[2]) < 0.05
    assert np.sqrt(plane.cov[1, 1]) < 0.01
    assert 0.03 < np.sqrt(plane.cov[2, 2]) <= 0.1


def test_echoes_of_fish_do_not_lift_the_floor() -> None:
    clean = soundings()
    points = clean.points_n.copy()
    points[::6, 2] -= 1.5
    plane = plane_at(Soundings(clean.t_ns, points, clean.sigma, clean.altitude), 0, HERE, 0.1)
    assert plane is not None
    assert abs(plane.theta[0] - 3.0) < 0.03


def test_roughness_is_what_the_soundings_scatter_beyond_their_noise() -> None:
    smooth, rough = (plane_at(soundings(noise=s), 0, HERE, 0.1) for s in (0.02, 0.15))
    assert smooth is not None
    assert rough is not None
    assert smooth.roughness < 0.015
    assert 0.1 < rough.roughness < 0.2
    assert rough.cov[0, 0] > 4.0 * smooth.cov[0, 0]


def test_soundings_far_away_or_of_another_lap_are_not_used() -> None:
    assert plane_at(soundings(), 0, HERE + np.array([0.0, 40.0, 0.0]), 0.1) is None
    assert plane_at(soundings(), 500 * SECOND, HERE, 0.1) is None
    few = soundings().t_ns[:0]
    assert plane_at(Soundings(few, np.zeros((0, 3)), np.zeros(0), np.zeros(0)), 0, HERE, 0.1) is None
    one = soundings(count=1)
    assert plane_at(Soundings(one.t_ns, HERE[None] + [0, 0, 3.0], one.sigma, one.altitude), int(one.t_ns[0]), HERE, 0.1)


@settings(max_examples=40, deadline=None)
@given(st.tuples(*[st.floats(-0.4, 0.4)] * 3), st.tuples(*[st.floats(-0.5, 0.5)] * 3), st.floats(-0.2, 0.2))
def test_rays_end_on_the_plane(turn: tuple[float, ...], arm: tuple[float, ...], slope: float) -> None:
    plane = plane_at(soundings(slope=slope), 0, HERE, 0.1)
    assert plane is not None
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(5, 4, 3)) * [0.4, 0.4, 0.1] + [0, 0, 1.0]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    R_nb = Rotation.from_rotvec(turn).as_matrix()
    points, sigma = meet(plane, rays, np.array(arm), R_nb, 8.0)
    seen = np.isfinite(sigma)
    at = points[seen] @ R_nb.T
    np.testing.assert_allclose(at[:, 2], plane.theta[0] + at[:, :2] @ plane.theta[1:], atol=1e-9)
    np.testing.assert_allclose(np.cross(points[seen] - arm, rays[seen]), 0.0, atol=1e-9)
    assert (sigma[seen] > 0.0).all()
    assert (np.linalg.norm(points[seen] - arm, axis=1) < 8.0).all()


def test_rays_to_the_sky_and_along_the_floor_meet_nothing() -> None:
    plane = plane_at(soundings(slope=0.0), 0, HERE, 0.1)
    assert plane is not None
    rays = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.995, 0.0, 0.0999], [0.0, 0.0, 1.0]])
    _, sigma = meet(plane, rays, np.zeros(3), np.eye(3), 50.0)
    assert np.isfinite(sigma).tolist() == [False, False, False, True]
