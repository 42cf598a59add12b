"""A rest at the start tells the gyro bias; a motion is not taken for one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.graph.rest import REST_SIGMA, Rest, bias_at_start, rest_at_start
from uwgraph.types import FloatArray, RelativePoses

BIAS = np.array([0.02, -0.03, 0.07])
T = 1_700_000_000_000_000_000 + np.arange(2001, dtype=np.int64) * 10_000_000
PINGS = T[10::20]


def rest(w_b: FloatArray, speed: FloatArray, sigma: float = 0.1) -> Rest:
    return rest_at_start(T, w_b, PINGS[: len(speed)], speed, sigma)


def still_then_moving(still_s: float) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(0)
    moving = (T[1:] - T[0]) * 1e-9 > still_s
    w_b = BIAS + 0.002 * rng.normal(size=(2000, 3)) + moving[:, None] * [0.0, 0.0, 0.3]
    return w_b, np.where((PINGS - T[0]) * 1e-9 > still_s, 1.0, 0.01)


@pytest.mark.parametrize("still_s", [3.0, 5.5, 20.0])
def test_the_mean_rate_at_rest_is_the_bias(still_s: float) -> None:
    found = rest(*still_then_moving(still_s))
    np.testing.assert_allclose(found.bias_gyro, BIAS, atol=5e-4)
    assert found.sigma == REST_SIGMA


@pytest.mark.parametrize(
    ("w_b", "speed", "sigma"),
    [
        (*still_then_moving(1.0), 0.1),  # too short
        (np.tile(BIAS, (2000, 1)), np.full(len(PINGS), 1.0), 0.1),  # a steady turn under way
        (np.tile(BIAS, (2000, 1)), np.zeros(0), 0.1),  # no DVL to tell a steady turn from a rest
        (np.tile(BIAS, (2000, 1)), np.zeros(len(PINGS)), 0.005),  # more than the rig holds possible
        (np.tile(BIAS, (2000, 1)), np.zeros(len(PINGS)), 1e-6),  # the rig knows better than any rest
    ],
)
def test_what_is_no_rest_leaves_the_rigs_word(w_b: FloatArray, speed: FloatArray, sigma: float) -> None:
    found = rest(w_b, speed, sigma)
    assert not found.bias_gyro.any()
    assert found.sigma == sigma


def turning(seed: int, steps: int = 100) -> tuple[RelativePoses, FloatArray]:
    """Strong turns that a camera sees at 5 Hz, some of them wrongly, and what a gyro with the bias makes of them."""
    rng = np.random.default_rng(seed)
    turn = rng.normal(0.0, 0.2, (steps, 3))
    gyro = Rotation.from_rotvec(turn) * Rotation.from_rotvec(np.tile(0.2 * BIAS, (steps, 1)))
    rotvec = (Rotation.from_rotvec(turn) * Rotation.from_rotvec(rng.normal(0.0, 1e-3, (steps, 3)))).as_rotvec()
    rotvec[::9] += 0.5
    t_ns = T[0] + np.arange(steps + 1) * 200_000_000
    seen = RelativePoses(
        t_ns[1:], t_ns[:-1], np.zeros((steps, 3)), rotvec, np.tile(1e-6 * np.eye(6), (steps, 1, 1)),
        np.ones(steps, dtype=np.bool_), np.full(steps, "seen"), np.full(steps, 50),
    )  # fmt: skip
    return seen, gyro.as_matrix()


@pytest.mark.parametrize("seed", range(3))
def test_a_camera_tells_the_bias_while_it_turns(seed: int) -> None:
    seen, dR = turning(seed)
    found = bias_at_start(seen, dR, 0.1)
    np.testing.assert_allclose(found.bias_gyro, BIAS, atol=3.0 * found.sigma)
    assert REST_SIGMA <= found.sigma < 0.01


def test_a_camera_does_not_overrule_what_is_known_better() -> None:
    seen, dR = turning(0)
    for few, sigma in ((seen, 1e-6), (seen, 0.005), (seen.select(slice(0, 1)), 0.1)):
        found = bias_at_start(few, dR[: len(few)], sigma)
        assert not found.bias_gyro.any()
        assert found.sigma == sigma
