"""Visual odometry over rendered images of a flat floor: the way, keyframes, blank images, what it refuses."""

import numpy as np
import pytest
from floor_views import DOWN, FLAT, seen_from, texture
from scipy.spatial.transform import Rotation

from uwgraph.dive.rig import AltitudeRig
from uwgraph.errors import ConfigError, DataError
from uwgraph.places.aids import Known, Sounding, soundings_of
from uwgraph.places.local import LocalSettings
from uwgraph.places.odometry import OdometrySettings, visual_odometry
from uwgraph.types import NOT_MEASURED, Altitude

ALTITUDE = 1.5
FAST = OdometrySettings(local=LocalSettings(limit=400))
SOUNDED = Known(sounding=lambda t_ns: Sounding(ALTITUDE, 0.01, np.zeros(3), DOWN))
X = np.linspace(-0.6, 0.6, 9)
HEADING = 0.1 * X


@pytest.fixture(scope="module")
def frames():
    rng = np.random.default_rng(0)
    floor = texture(rng)
    return [
        (int(1e9) * k, seen_from(floor, x, 0.0, heading, noise=rng))
        for k, (x, heading) in enumerate(zip(X, HEADING, strict=True))
    ]


def way_of(poses):
    """Where the steps lead from the first pose: position (3,) and rotation."""
    R, p = Rotation.identity(), np.zeros(3)
    for step, turn in zip(poses.p, poses.rotvec, strict=True):
        p, R = p + R.apply(step), R * Rotation.from_rotvec(turn)
    return p, R


def test_the_way_is_found(frames):
    done = []
    poses = visual_odometry(iter(frames), FLAT, known=SOUNDED, settings=FAST, progress=done.append)
    assert done == list(range(1, 10))
    assert poses.accepted.all()
    assert poses.from_ns[0] == 0
    assert poses.t_ns[-1] == frames[-1][0]
    np.testing.assert_array_equal(poses.from_ns[1:], poses.t_ns[:-1])
    p, R = way_of(poses)
    truth = Rotation.from_euler("z", HEADING[0]).inv().apply([X[-1] - X[0], 0.0, 0.0])
    assert np.linalg.norm(p - truth) < 0.02
    assert np.abs(R.as_rotvec() - [0.0, 0.0, HEADING[-1] - HEADING[0]]).max() < np.radians(0.5)


def test_a_larger_flow_makes_fewer_keyframes(frames):
    few, many = (
        visual_odometry(frames, FLAT, known=SOUNDED, settings=OdometrySettings(flow=flow, kept=0.0, local=FAST.local))
        for flow in (0.3, 0.1)
    )
    assert 1 <= len(few) < len(many)


def test_without_scale_the_direction_is_kept(frames):
    poses = visual_odometry(frames[:4], FLAT, settings=FAST)
    assert poses.accepted.all()
    assert poses.p[0, 0] > 0.98
    assert np.linalg.eigvalsh(poses.cov[0, 3:, 3:])[-1] == pytest.approx(NOT_MEASURED, rel=0.01)


def test_a_blank_image_is_stepped_over(frames):
    blank = [(t, np.full_like(image, 90) if t == frames[4][0] else image) for t, image in frames]
    poses = visual_odometry(blank, FLAT, known=SOUNDED, settings=FAST)
    assert poses.accepted.all()
    assert frames[4][0] not in set(poses.t_ns)
    assert abs(way_of(poses)[0][0] - 1.2) < 0.03


def test_another_place_is_a_failure_in_words(frames):
    other = texture(np.random.default_rng(7))
    later = [(t + int(100e9), seen_from(other, 0.1 * k, 0.0)) for k, (t, _) in enumerate(frames[:4])]
    poses = visual_odometry([*frames[:4], *later], FLAT, known=SOUNDED, settings=FAST)
    broken = ~poses.accepted
    assert broken.sum() == 1
    assert "too few" in poses.reason[broken][0]
    assert (np.diag(poses.cov[broken][0]) == NOT_MEASURED).all()
    assert poses.accepted[-1]


def test_only_blank_images_are_no_motion():
    frames = [(k, np.zeros((240, 320), np.uint8)) for k in range(3)]
    assert len(visual_odometry(frames, FLAT)) == 0
    assert visual_odometry([], FLAT).cov.shape == (0, 6, 6)


def test_frames_out_of_order_or_of_another_size_are_errors(frames):
    with pytest.raises(DataError, match="sort"):
        visual_odometry([frames[1], frames[0]], FLAT)
    with pytest.raises(DataError, match="pixels"):
        visual_odometry([(0, np.zeros((50, 50), np.uint8))], FLAT)
    with pytest.raises(DataError, match="cameras"):
        visual_odometry([(0, frames[0][1], frames[0][1])], FLAT)
    with pytest.raises(ConfigError):
        visual_odometry([(0, np.zeros((240, 320)))], FLAT)


def test_ranges_between_samples_but_not_over_gaps():
    t = np.array([0, 1, 2, 10], dtype=np.int64) * int(1e9)
    stream = Altitude(t, np.array([1.0, 3.0, np.nan, 5.0]), np.array([0.1, np.nan, 0.1, 0.1]))
    at = soundings_of(stream, AltitudeRig(sigma=0.2))
    middle = at(int(0.25e9))
    assert middle.range == pytest.approx(1.5)
    assert middle.sigma == pytest.approx(0.2)  # the larger of 0.1 and the rig's
    assert at(int(5e9)) is None
    assert at(-1) is None
    assert at(int(11e9)) is None
    assert at(0).range == 1.0
    assert soundings_of(stream.select(slice(0, 0)), AltitudeRig())(0) is None
