"""The motion between two views: truth, honest covariance, scale, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from floor_views import CAMERA, DOWN, N_WATER, Pair, features_view, pair_of, pixels_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.camera.model import Camera
from uwgraph.places.aids import Aids, Sounding
from uwgraph.places.matching import Matches
from uwgraph.places.plane import Geometry, epipolar, inverse_depths, transfer
from uwgraph.places.twoview import PairSettings, two_view_motion
from uwgraph.types import NOT_MEASURED

FORWARD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
FISHEYE = Camera("fisheye", (300.0, 300.0), (319.5, 239.5), (640, 480), (0.02, -0.01, 0.0, 0.0), CAMERA.R_bs)


def sounded(pair, rng, **more):
    first, second = pair.soundings(rng)
    return Aids(sounding_a=first, sounding_b=second, **more)


@pytest.mark.parametrize("residuals", [transfer, epipolar])
def test_derivatives_are_those_of_finite_differences(residuals):
    pair = pair_of(np.random.default_rng(1), wrong=0.0, noise=0.3)
    g = Geometry(pair.R, pair.p, DOWN / 2.0)
    _, J = residuals(g, pair.a, pair.b)
    steps = 1e-6 * np.eye(9)[: J.shape[-1]]
    numeric = [
        (residuals(g.moved(s), pair.a, pair.b)[0] - residuals(g.moved(-s), pair.a, pair.b)[0]) / 2e-6 for s in steps
    ]
    # the weights, which change slowly, are held
    assert np.abs(np.stack(numeric, axis=-1) - J).max() < 0.02 * np.abs(J).max()


@settings(max_examples=8, deadline=None)
@given(
    st.integers(0, 10_000),
    st.floats(0.2, 0.6),
    st.sampled_from([CAMERA, replace(CAMERA, port="dome"), FISHEYE]),
)
def test_without_noise_the_motion_is_exact(seed, way, camera):
    rng = np.random.default_rng(seed)
    pair = pair_of(rng, camera, way, noise=1e-4, wrong=0.0)
    motion = two_view_motion(pair.a, pair.b, pair.matches, sounded(pair, rng, R_ab=pair.R))
    assert motion.accepted, motion.reason
    e = pair.error(motion)
    assert np.abs(e[:3]).max() < 1e-3
    across = e[3:] - (e[3:] @ pair.p) * pair.p / (pair.p @ pair.p)
    assert np.abs(across).max() < 5e-3
    assert np.abs(e[3:]).max() < 0.06 * np.linalg.norm(pair.p)  # the scale is that of noisy soundings


@pytest.mark.parametrize(("way", "relief"), [(0.5, 0.0), (0.5, 0.04), (0.0, 0.0)])
def test_covariance_is_honest(way, relief):
    nees = []
    for seed in range(14):
        rng = np.random.default_rng(seed)
        pair = pair_of(rng, way=way, relief=relief, count=160)
        motion = two_view_motion(pair.a, pair.b, pair.matches, sounded(pair, rng))
        if motion.accepted:
            nees.append(pair.nees(motion))
    assert len(nees) > 11
    assert 0.45 < np.mean(nees) < 1.6  # expectation 1
    assert max(nees) < 10.0


def test_points_that_err_together_are_less_sure():
    """A lens that is wrong by half a pixel in one corner moves all its points alike."""
    rng = np.random.default_rng(0)
    pair = pair_of(rng, noise=0.3, wrong=0.0)
    aids = sounded(pair, rng)
    alone = two_view_motion(pair.a, pair.b, pair.matches, aids)
    uv = pair.b.features.uv.copy()
    uv += 0.8 * np.sin(uv / 60.0)
    bent = two_view_motion(pair.a, features_view(1, uv, CAMERA), pair.matches, aids)
    points = np.sqrt(np.trace(bent.cov[:3, :3]) / np.trace(alone.cov[:3, :3]))
    residual = 0.8 / np.sqrt(2.0) / 0.3
    assert points > 1.3 * residual


def test_scale_of_nothing_is_not_measured():
    pair = pair_of(np.random.default_rng(2))
    motion = two_view_motion(pair.a, pair.b, pair.matches, Aids())
    assert motion.accepted
    assert not motion.metric
    assert "no scale" in motion.reason
    R = Rotation.from_rotvec(motion.rotvec).as_matrix()
    c = R.T @ motion.geometry.c / np.linalg.norm(motion.geometry.c)
    cov = motion.cov[3:, 3:]
    assert c @ cov @ c == pytest.approx(NOT_MEASURED, rel=0.01)
    values = np.linalg.eigvalsh(cov)
    assert values[1] < 0.05
    true = pair.p + pair.R @ CAMERA.l_b - CAMERA.l_b
    assert c @ R.T @ true / np.linalg.norm(true) > 0.99


def test_scale_of_a_known_distance():
    rng = np.random.default_rng(3)
    pair = pair_of(rng)
    length = float(np.linalg.norm(pair.p))
    motion = two_view_motion(pair.a, pair.b, pair.matches, Aids(length=(length, 0.02)))
    assert motion.metric
    assert np.linalg.norm(motion.p) == pytest.approx(length, abs=0.02)
    along = motion.p @ Rotation.from_rotvec(motion.rotvec).as_matrix() / np.linalg.norm(motion.p)
    assert np.sqrt(along @ motion.cov[3:, 3:] @ along) == pytest.approx(0.02, rel=0.3)


def test_doubt_about_the_range_is_doubt_about_the_way():
    rng = np.random.default_rng(4)
    pair = pair_of(rng, way=0.8)
    sharp, vague = (
        two_view_motion(pair.a, pair.b, pair.matches, Aids(sounding_a=Sounding(pair.range_a, s, np.zeros(3), DOWN)))
        for s in (0.001, 0.2)
    )
    assert vague.position_sigma > 0.06 > 2.0 * sharp.position_sigma


def test_a_gyro_takes_the_doubt_from_the_rotation():
    rng = np.random.default_rng(5)
    pair = pair_of(rng)
    sigma = np.radians(0.01)
    alone = two_view_motion(pair.a, pair.b, pair.matches, sounded(pair, rng))
    aided = two_view_motion(pair.a, pair.b, pair.matches, sounded(pair, rng, R_ab=pair.R, rotation_sigma=sigma))
    assert aided.rotation_sigma <= 1.01 * sigma < alone.rotation_sigma
    assert np.abs(pair.error(aided)[:3]).max() < 4.0 * sigma


def test_a_forward_camera_sees_floor_and_wall():
    rng = np.random.default_rng(6)
    R_bs = Rotation.from_euler("y", np.radians(-20.0)).as_matrix() @ FORWARD
    camera = replace(CAMERA, R_bs=R_bs, l_b=np.zeros(3), distortion=())
    rays, _ = camera.outside(rng.uniform([0, 0], [639, 479], (400, 2)), N_WATER)
    floor = np.where(rays[:, 2] > 0.0, 1.0 / np.maximum(rays[:, 2], 1e-9), np.inf)
    X = rays * np.minimum(floor, 4.0 / rays[:, 0])[:, None]
    R, p = Rotation.from_euler("z", 4.0, degrees=True).as_matrix(), np.array([0.3, 0.02, 0.0])
    uv_a, uv_b = pixels_of(camera, X), pixels_of(camera, (X - p) @ R)
    both = np.isfinite(uv_a[:, 0]) & np.isfinite(uv_b[:, 0])
    a, b = (features_view(0, uv[both] + rng.normal(0, 0.3, (both.sum(), 2)), camera) for uv in (uv_a, uv_b))
    everything = np.arange(both.sum())
    pair = Pair(a, b, Matches(everything, everything, everything >= 0), R, p, 1.0, 1.0)
    motion = two_view_motion(a, b, pair.matches, sounded(pair, rng, down_a=DOWN))
    assert motion.accepted, motion.reason
    assert np.abs(pair.error(motion)[:3]).max() < np.radians(0.3)
    assert np.abs(pair.error(motion)[3:]).max() < 0.02


def test_too_few_and_nonsense_are_refused():
    rng = np.random.default_rng(7)
    pair = pair_of(rng, wrong=1.0)
    assert not two_view_motion(pair.a, pair.b, pair.matches, Aids()).accepted
    few = np.arange(12)
    pair = pair_of(rng, wrong=0.0)
    matches = replace(pair.matches, a=few, b=few, distinct=few >= 0)
    motion = two_view_motion(pair.a, pair.b, matches, Aids(), PairSettings(min_inliers=20))
    assert not motion.accepted
    assert "too few" in motion.reason
    assert (np.diag(motion.cov) == NOT_MEASURED).all()


def test_inverse_depths_are_those_of_the_points():
    pair = pair_of(np.random.default_rng(8), noise=1e-5, wrong=0.0, relief=0.1)
    c = pair.p + pair.R @ CAMERA.l_b - CAMERA.l_b
    rho, pixels = inverse_depths(Geometry(pair.R, c), pair.a, pair.b)
    distance = 1.0 / rho
    assert (distance > 1.0).all()
    again = (pair.a.rays * distance[:, None] - c) @ pair.R
    again /= np.linalg.norm(again, axis=1, keepdims=True)
    np.testing.assert_allclose(again, pair.b.rays, atol=1e-6)
    assert (pixels > 0.0).all()


def ahead(rng, floor, wall, way=0.5):
    """Two views ahead and 20 degrees down: a floor 1 m below and a leaning wall 5 m ahead, with truth."""
    camera = replace(CAMERA, R_bs=Rotation.from_euler("y", -20.0, degrees=True).as_matrix() @ FORWARD, l_b=np.zeros(3))
    on_floor = np.c_[rng.uniform(0.8, 3.0, floor), rng.uniform(-1.5, 1.5, floor), np.ones(floor)]
    height = rng.uniform(-1.0, 0.9, wall)
    on_wall = np.c_[5.0 - 0.8 * height, rng.uniform(-2.5, 2.5, wall), height]
    X, p = np.vstack([on_floor, on_wall]), np.array([way, 0.02, -0.01])
    R = Rotation.from_rotvec([0.01, 0.02, 0.03]).as_matrix()
    uv_a, uv_b = pixels_of(camera, X), pixels_of(camera, (X - p) @ R)
    both = np.isfinite(uv_a[:, 0]) & np.isfinite(uv_b[:, 0])
    noise = rng.normal(0.0, 0.3, (2, both.sum(), 2))
    a, b = (features_view(t, uv[both] + noise[t], camera) for t, uv in enumerate((uv_a, uv_b)))
    index = np.arange(len(a))
    aids = Aids(sounding_a=Sounding(1.0, 0.02, np.zeros(3), DOWN), down_a=DOWN)
    return Pair(a, b, Matches(index, index, np.ones(len(a), np.bool_)), R, p, 1.0, 1.01), aids


@pytest.mark.parametrize("seed", range(4))
def test_a_camera_that_looks_ahead_takes_its_scale_from_the_floor_not_from_a_larger_wall(seed):
    pair, aids = ahead(np.random.default_rng(seed), floor=120, wall=260)
    motion = two_view_motion(pair.a, pair.b, pair.matches, aids)
    assert motion.accepted
    assert motion.metric
    assert pair.nees(motion) < 6.0
    assert np.linalg.norm(motion.p - pair.p) < 0.1 * np.linalg.norm(pair.p)


@pytest.mark.parametrize("seed", range(4))
def test_a_wall_alone_tells_no_scale(seed):
    pair, aids = ahead(np.random.default_rng(seed), floor=0, wall=260)
    motion = two_view_motion(pair.a, pair.b, pair.matches, aids)
    assert not motion.metric
