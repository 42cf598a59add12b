from __future__ import annotations

import numpy as np
import pytest
from graph_dives import START_NS, hand_made
from hypothesis import given
from hypothesis import strategies as st

from uwgraph.graph import SmoothSettings
from uwgraph.graph.keyframes import inside, nearest_keyframe, schedule
from uwgraph.graph.prepare import BodyDvl, BodyImu, Prepared
from uwgraph.time import from_seconds
from uwgraph.types import FloatArray, TimeArray

IMU_HZ = 50.0


def vehicle(duration_s: float, yaw_rate: FloatArray | float = 0.0, pings_s: FloatArray | None = None) -> Prepared:
    count = int(duration_s * IMU_HZ)
    w_b = np.zeros((count, 3))
    w_b[:, 2] = yaw_rate
    imu = BodyImu(from_seconds(np.arange(count + 1) / IMU_HZ, START_NS), np.tile([0.0, 0.0, -9.8], (count, 1)), w_b)
    if pings_s is None:
        return hand_made(imu)
    v_b, cov = np.zeros((len(pings_s), 3)), np.tile(np.eye(3), (len(pings_s), 1, 1))
    return hand_made(imu, BodyDvl(from_seconds(pings_s, START_NS), v_b, cov))


def keyframes_of(prepared: Prepared, **settings: float) -> TimeArray:
    t = prepared.imu.t_ns
    return schedule(prepared, SmoothSettings(**settings), int(t[0]), int(t[-1]))


def turns(prepared: Prepared, keyframes: TimeArray) -> FloatArray:
    """How far the gyro turned between keyframes, rad."""
    step = np.abs(prepared.imu.w_b[:, 2]) / IMU_HZ
    so_far = np.concatenate([[0.0], np.cumsum(step)])
    t0 = keyframes[0]
    return np.diff(np.interp(keyframes - t0, prepared.imu.t_ns - t0, so_far))


pings = st.lists(st.floats(0.0, 20.0), min_size=1, max_size=60, unique=True).map(np.sort)
periods = st.floats(0.1, 3.0)


@given(duration_s=st.floats(0.1, 20.0), period_s=periods, rate=st.floats(0.0, 2.0), pings_s=st.none() | pings)
def test_stamps_increase_from_the_first_to_the_last_without_long_gaps(
    duration_s: float, period_s: float, rate: float, pings_s: FloatArray | None
) -> None:
    prepared = vehicle(duration_s, rate, pings_s)
    k = keyframes_of(prepared, keyframe_period_s=period_s)
    assert k.dtype == np.int64
    assert (k[0], k[-1]) == (prepared.imu.t_ns[0], prepared.imu.t_ns[-1])
    gaps = np.diff(k)
    assert (gaps > 0).all()
    reach = 0 if pings_s is None else round(period_s * 1e9)  # half a period at either end
    assert gaps.max() <= round(period_s * 1e9) + reach + 1


@given(period_s=periods, pings_s=pings)
def test_keyframes_stand_on_pings_wherever_one_is_near(period_s: float, pings_s: FloatArray) -> None:
    prepared = vehicle(20.0, 0.0, pings_s)
    assert prepared.dvl is not None
    k = keyframes_of(prepared, keyframe_period_s=period_s)[1:-2]  # the last inner one may be close to the end
    distance = np.abs(k[:, None] - prepared.dvl.t_ns[None, :]).min(axis=1)
    assert ((distance == 0) | (distance > round(period_s * 1e9) // 2)).all()


@pytest.mark.parametrize("hz", [2.0, 5.0, 10.0])
def test_regular_pings_give_keyframes_of_one_period(hz: float) -> None:
    prepared = vehicle(20.0, 0.0, 0.03 + np.arange(0.0, 19.9, 1.0 / hz))
    gaps = np.diff(keyframes_of(prepared, keyframe_period_s=1.0))
    np.testing.assert_array_equal(gaps[1:-1], 1_000_000_000)


@given(
    limit_deg=st.floats(5.0, 60.0),
    period_s=periods,
    rates=st.lists(st.floats(-2.0, 2.0), min_size=10, max_size=10),
)
def test_no_interval_turns_by_more_than_the_limit(limit_deg: float, period_s: float, rates: list[float]) -> None:
    prepared = vehicle(10.0, np.repeat(rates, int(IMU_HZ)))
    k = keyframes_of(prepared, keyframe_period_s=period_s, keyframe_turn_deg=limit_deg)
    assert turns(prepared, k).max() <= np.radians(limit_deg) * (1.0 + 1e-6)


def test_a_straight_way_is_not_split_and_a_turn_only_where_it_is() -> None:
    rate = np.zeros(int(10 * IMU_HZ))
    rate[int(4 * IMU_HZ) : int(6 * IMU_HZ)] = np.radians(90.0)
    k = keyframes_of(vehicle(10.0, rate), keyframe_turn_deg=30.0)
    seconds = (k - k[0]) * 1e-9
    assert len(k) == 11 + 4
    np.testing.assert_allclose(seconds[(seconds > 4.0) & (seconds < 5.0)], [4 + 1 / 3, 4 + 2 / 3], atol=1e-6)


@given(k=st.lists(st.integers(0, 10**10), min_size=2, max_size=20, unique=True).map(sorted), t=st.integers(0, 10**10))
def test_nearest_is_nearest(k: list[int], t: int) -> None:
    keyframes, stamps = np.array(k) + START_NS, np.array([t]) + START_NS
    found = nearest_keyframe(keyframes, stamps)[0]
    assert abs(keyframes[found] - stamps[0]) == np.abs(keyframes - stamps[0]).min()
    assert inside(keyframes, stamps)[0] == (k[0] <= t <= k[-1])
