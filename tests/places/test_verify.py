"""Places seen again: what is accepted is right, and bad images give no closure that is taken for sure."""

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from floor_views import CAMERA, DOWN, FLAT, features_view, pair_of, seen_from, texture, tiles
from scipy.spatial.transform import Rotation

from uwgraph.camera.images import read_image
from uwgraph.camera.model import Camera
from uwgraph.places.aids import Aids, Known, Sounding
from uwgraph.places.local import LocalSettings
from uwgraph.places.motion import relative_poses
from uwgraph.places.verify import VerifySettings, verify, verify_pairs
from uwgraph.places.view import view_of

SUBVO = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data")) / "subvo"
ALTITUDE = 1.5
SOUNDING = Sounding(ALTITUDE, 0.02, np.zeros(3), DOWN)
AIDS = Aids(sounding_a=SOUNDING, sounding_b=SOUNDING, down_a=DOWN)
LOCAL = LocalSettings(limit=600)


def view(image, t_ns=0, how="clahe"):
    return view_of(t_ns, image, FLAT, local=LOCAL, how=how)


def wrong(motion, x, y, heading):
    """Whether an accepted motion is not the true one from (0, 0, 0) to (x, y, heading)."""
    e = np.r_[motion.p - [x, y, 0.0], motion.rotvec - [0.0, 0.0, heading]]
    return motion.accepted and (np.abs(e[:3]).max() > 0.05 or np.abs(e[3:]).max() > 0.03)


@pytest.fixture(scope="module")
def floor():
    return texture(np.random.default_rng(0))


@pytest.mark.parametrize(("x", "y", "heading"), [(0.2, 0.1, 0.3), (0.1, -0.2, np.pi / 2), (0.0, 0.0, np.pi)])
def test_a_place_seen_again_from_elsewhere(floor, x, y, heading):
    rng = np.random.default_rng(1)
    a, b = view(seen_from(floor, 0, 0, noise=rng)), view(seen_from(floor, x, y, heading, noise=rng), 1)
    motion = verify(a, b, AIDS)
    assert motion.accepted, motion.reason
    e = np.r_[motion.p - [x, y, 0.0]]
    assert np.abs(e).max() < 0.03
    turn = Rotation.from_rotvec(motion.rotvec).inv() * Rotation.from_euler("z", heading)
    assert turn.magnitude() < 0.02


def bad_images(seed=2):
    rng = np.random.default_rng(seed)
    blank = np.full((240, 320), 100, np.uint8)
    noise = rng.integers(0, 255, (240, 320)).astype(np.uint8)
    dark = rng.poisson(2.0, (240, 320)).astype(np.uint8)
    shade = np.tile(np.linspace(60, 200, 320), (240, 1)).astype(np.uint8)
    return {"blank": blank, "noise": noise, "dark": dark, "shade": shade}


@pytest.mark.parametrize("name", ["blank", "noise", "dark", "shade"])
def test_images_without_a_scene_are_refused(floor, name):
    bad = view(bad_images()[name])
    for b in (view(bad_images(3)[name], 1), view(seen_from(floor, 0, 0), 1)):
        motion = verify(bad, b, AIDS)
        assert not motion.accepted
        assert motion.reason


def test_blurred_images_are_right_or_refused(floor):
    rng = np.random.default_rng(3)
    for sigma in (2.0, 6.0, 15.0):
        a, b = (
            view(cv2.GaussianBlur(seen_from(floor, x, 0.0, noise=rng), (0, 0), sigma), how="none") for x in (0.0, 0.2)
        )
        assert not wrong(verify(a, b, AIDS), 0.2, 0.0, 0.0)


@pytest.mark.parametrize("heading", [0.0, 0.02, np.pi / 2])
@pytest.mark.parametrize("noisy", [True, False])
def test_tiles_are_never_a_closure(heading, noisy):
    """Equal tiles, whole and half periods apart: everything fits, so nothing is known."""
    rng = np.random.default_rng(4)
    floor, period = tiles(), 24 * 3.0 / 1200
    noise = rng if noisy else None
    a = view(seen_from(floor, 0, 0, noise=noise))
    for x in (0.0, period, 2.5 * period, 5.0 * period):
        b = view(seen_from(floor, x, 0.0, heading, noise=noise), 1)
        assert not verify(a, b, AIDS).accepted


def test_tiles_with_one_thing_on_them_are_right_or_refused():
    """The tiles agree with every shift; what lies on them decides, or there is no closure."""
    rng = np.random.default_rng(5)
    floor = tiles()
    things = texture(rng, 1200)
    for u, v in ((560, 620), (650, 560), (600, 690)):
        floor[v : v + 60, u : u + 60] = things[v : v + 60, u : u + 60]
    a = view(seen_from(floor, 0, 0, noise=rng))
    for x in (0.06, 0.12, 0.15):
        assert not wrong(verify(a, view(seen_from(floor, x, 0.0, noise=rng), 1), AIDS), x, 0.0, 0.0)


def test_other_floors_of_the_same_kind_are_refused(floor):
    rng = np.random.default_rng(6)
    a = view(seen_from(floor, 0, 0, noise=rng))
    for seed in range(3):
        other = texture(np.random.default_rng(10 + seed))
        assert not verify(a, view(seen_from(other, 0, 0, noise=rng), 1), AIDS).accepted


def test_two_periods_in_the_matches_are_ambiguous():
    """Half of the matches say one motion, half another: neither is believed."""
    one = pair_of(np.random.default_rng(7), wrong=0.0, count=150)
    two = pair_of(np.random.default_rng(8), wrong=0.0, count=150)
    rows = np.random.default_rng(9).exponential(size=(300, 128))
    d = np.sqrt(rows / rows.sum(axis=1, keepdims=True)).astype(np.float32)
    uv = [np.concatenate([getattr(p, side).features.uv for p in (one, two)]) for side in ("a", "b")]
    views = [features_view(t, side, CAMERA, d[: len(side)]) for t, side in enumerate(uv)]
    motion = verify(*views, Aids())
    assert not motion.accepted
    assert "another motion" in motion.reason


def test_what_else_is_known_contradicts(floor):
    a, b = view(seen_from(floor, 0, 0)), view(seen_from(floor, 0.2, 0.0), 1)
    assert verify(a, b, AIDS).accepted
    near = replace(SOUNDING, range=0.9)
    for aids, reason in (
        (replace(AIDS, R_ab=Rotation.from_euler("z", 20, degrees=True).as_matrix()), "gyro"),
        (replace(AIDS, sounding_b=near), "scale"),
        (replace(AIDS, down_a=np.array([0.6, 0.0, 0.8])), "steep"),
    ):
        motion = verify(a, b, aids)
        assert not motion.accepted
        assert reason in motion.reason


def test_points_in_a_corner_and_a_vague_motion_are_refused(floor):
    black = np.zeros((240, 320), np.uint8)
    images = [seen_from(floor, x, 0.0) for x in (0.0, 0.02)]
    corner = [np.where(np.arange(320) < 100, np.where(np.arange(240)[:, None] < 90, i, black), black) for i in images]
    a, b = (view(i.astype(np.uint8), how="none") for i in corner)
    motion = verify(a, b, AIDS, VerifySettings(min_inliers=10, cells=12))
    assert not motion.accepted
    a, b = (view(i) for i in images)
    assert "known to" in verify(a, b, AIDS, VerifySettings(max_rotation_deg=1e-4)).reason
    assert "known to" in verify(a, b, AIDS, VerifySettings(max_position=1e-6)).reason


def test_candidates_become_a_stream(floor):
    far = view(seen_from(texture(np.random.default_rng(11)), 0, 0), int(4e9))
    a, b = view(seen_from(floor, 0, 0), 0), view(seen_from(floor, 0.2, 0.0), int(5e9))
    known = Known(sounding=lambda t_ns: SOUNDING, down=lambda t_ns: DOWN)
    closures = verify_pairs([(a, b), (a, far)], known)
    assert closures.t_ns.tolist() == [int(4e9), int(5e9)]
    assert closures.accepted.tolist() == [False, True]
    assert closures.inliers[1] >= 30
    assert all(closures.reason)
    assert relative_poses([], []).p.shape == (0, 3)


@pytest.mark.data
@pytest.mark.slow
def test_a_pool_of_tiles():
    """Real tiles: neighbouring images agree, images of other parts of the pool are never taken for them."""
    if not SUBVO.is_dir():
        pytest.skip(f"no {SUBVO}: set UWGRAPH_DATA to the folder of the recordings")
    forward = Rotation.from_euler("y", -18.0, degrees=True).as_matrix() @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    camera = Camera("pinhole", (677.0, 677.0), (319.5, 179.5), (640, 360), (-0.34, 0.22, 0.0, 0.0), forward)
    files = sorted((SUBVO / "images").glob("*.jpg"))
    mask = np.full((360, 640), 255, np.uint8)
    mask[:14, :120] = 0
    shown = (20, 22, 90, 100, 102, 160, 190, 215)
    views = {k: view_of(k, read_image(files[k]), camera, mask=mask, local=LocalSettings()) for k in shown}
    aids = Aids(sounding_a=SOUNDING, sounding_b=SOUNDING, down_a=DOWN)
    assert verify(views[20], views[22], aids).accepted
    assert verify(views[100], views[102], aids).accepted
    for a, b in ((20, 90), (20, 160), (22, 190), (90, 160), (100, 190), (102, 215), (20, 215), (160, 215)):
        assert not verify(views[a], views[b], aids).accepted


def test_matches_of_no_features():
    nothing = view(np.full((240, 320), 100, np.uint8))
    motion = verify(nothing, nothing, AIDS)
    assert not motion.accepted
    assert isinstance(motion.inliers, int)
