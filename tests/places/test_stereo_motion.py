"""Two cameras: places, and the motion between them with an honest covariance."""

from dataclasses import replace

import numpy as np
import pytest
from floor_views import CAMERA, RIGHT, features_view, floor_points, motion_of, pixels_of
from scipy.spatial.transform import Rotation

from uwgraph.errors import ConfigError
from uwgraph.places.aids import Aids
from uwgraph.places.matching import match
from uwgraph.places.pair import pair_motion
from uwgraph.places.stereo import stereo_motion, triangulated, with_points


def stereo_view(rng, t_ns, X, noise, ids):
    """Left view with places of points (N, 3) seen from the left camera; every point has its own descriptor."""
    left, right = pixels_of(CAMERA, X), pixels_of(RIGHT, X - (RIGHT.l_b - CAMERA.l_b))
    both = np.isfinite(left[:, 0]) & np.isfinite(right[:, 0])
    rows = np.random.default_rng(9).exponential(size=(len(X), 128))
    d = np.sqrt(rows / rows.sum(axis=1, keepdims=True)).astype(np.float32)[both]
    views = [
        features_view(t_ns, uv[both] + rng.normal(0.0, noise, (both.sum(), 2)), camera, d)
        for uv, camera in ((left, CAMERA), (right, RIGHT))
    ]
    ids.append(np.flatnonzero(both))
    return with_points(*views)


def moved_pair(seed, noise=0.5):
    rng = np.random.default_rng(seed)
    R, p = motion_of(rng, 0.4)
    X, _ = floor_points(rng, CAMERA, relief=0.1)
    c = p + R @ CAMERA.l_b - CAMERA.l_b
    ids = []
    a = stereo_view(rng, 0, X, noise, ids)
    b = stereo_view(rng, 1, (X - c) @ R, noise, ids)
    return a, b, R, p, X, ids


def test_points_are_placed():
    a, _, _, _, X, ids = moved_pair(0, noise=1e-6)
    assert np.isfinite(a.points[:, 0]).mean() > 0.9
    placed = np.isfinite(a.points[:, 0])
    np.testing.assert_allclose(a.points[placed], X[ids[0]][placed], atol=1e-5)


def test_places_err_as_their_covariance_says():
    rng = np.random.default_rng(1)
    X, _ = floor_points(rng, CAMERA, count=600, relief=0.1)
    base = RIGHT.l_b - CAMERA.l_b
    left, right = pixels_of(CAMERA, X), pixels_of(RIGHT, X - base)
    both = np.isfinite(left[:, 0]) & np.isfinite(right[:, 0])
    a, b = (
        features_view(0, uv[both] + rng.normal(0.0, 0.4, (both.sum(), 2)), camera)
        for uv, camera in ((left, CAMERA), (right, RIGHT))
    )
    placed, cov = triangulated(a, b, base)
    e = placed - X[both]
    nees = np.einsum("ni,nij,nj->n", e, np.linalg.inv(0.4**2 * cov), e) / 3.0
    assert 0.85 < nees.mean() < 1.2


def test_the_motion_is_metric_and_its_covariance_honest():
    nees = []
    for seed in range(12):
        a, b, R, p, _, _ = moved_pair(seed)
        motion = pair_motion(a, b)
        assert motion.reason == "stereo"
        assert motion.accepted, motion.reason
        assert motion.metric
        R_m = Rotation.from_rotvec(motion.rotvec).as_matrix()
        e = np.r_[Rotation.from_matrix(R_m.T @ R).as_rotvec(), R_m.T @ (p - motion.p)]
        nees.append(e @ np.linalg.solve(motion.cov, e) / 6.0)
        assert np.abs(e[3:]).max() < 0.03
    assert 0.4 < np.mean(nees) < 1.7


def test_places_of_another_floor_are_refused():
    rng = np.random.default_rng(2)
    views = [stereo_view(rng, t, floor_points(rng, CAMERA, relief=0.2)[0], 0.5, []) for t in (0, 1)]
    matches = match(*views)
    placed = np.isfinite(views[0].points[matches.a, 0]) & np.isfinite(views[1].points[matches.b, 0])
    motion = stereo_motion(*views, matches.select(placed), Aids(), 30)
    assert not motion.accepted
    assert "places" in motion.reason
    assert not pair_motion(*views).accepted


def test_cameras_at_one_place_are_an_error():
    a, _, *_ = moved_pair(3)
    with pytest.raises(ConfigError, match="translation_m"):
        with_points(a, replace(a))
