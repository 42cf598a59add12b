"""A rest at the start tells the gyro bias; a motion is not taken for one."""

from __future__ import annotations

import numpy as np
import pytest

from uwgraph.graph.rest import REST_SIGMA, Rest, rest_at_start
from uwgraph.types import FloatArray

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
