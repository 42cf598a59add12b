"""Relative poses moved to keyframes, held against the truth there."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from graph_dives import SHORT, Truth
from gtsam.symbol_shorthand import X

from uwgraph.graph.prepare import Prepared, prepare
from uwgraph.graph.relative import closures_at_keyframes, odometry_at_keyframes, sqrt_information
from uwgraph.graph.se3 import Poses
from uwgraph.graph.track import Track
from uwgraph.simulate.closures import ClosureModel, OdometryModel, measure_closures, measure_odometry
from uwgraph.simulate.noise import Noise
from uwgraph.time import from_seconds
from uwgraph.types import NOT_MEASURED, FloatArray, RelativePoses, TimeArray

TURNING = SHORT.model_copy(update={"grade": "noise_free", "pattern": "patrol", "duration_s": 200.0, "depth": 2.0})
QUIET = Noise.of(0, "none", silent=True)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth.of(TURNING)


@pytest.fixture(scope="module")
def prepared(truth: Truth) -> Prepared:
    return prepare(truth.dive)


@pytest.fixture(scope="module")
def track(truth: Truth, prepared: Prepared) -> Track:
    return truth.track(prepared)


@pytest.fixture(scope="module")
def keyframes(truth: Truth) -> TimeArray:
    """Off every camera's stamps, 0.7 to 1.3 s apart."""
    steps = np.random.default_rng(0).uniform(0.7, 1.3, size=190)
    stamps = from_seconds(0.43 + np.cumsum(steps), truth.motion.start_ns)
    return stamps[stamps < truth.motion.start_ns + 199 * 10**9]


def poses(truth: Truth, t_ns: TimeArray) -> Poses:
    return Poses(truth.R_nb(t_ns), truth.p_n(t_ns))


def assert_true(between: object, truth: Truth, keyframes: TimeArray) -> None:
    found = between.T  # type: ignore[attr-defined]
    i, j = between.i, between.j  # type: ignore[attr-defined]
    error = poses(truth, keyframes[i]).to(poses(truth, keyframes[j])).to(found).log()
    np.testing.assert_allclose(error[:, :3], 0.0, atol=1e-4)
    np.testing.assert_allclose(error[:, 3:], 0.0, atol=2e-3)


def test_closures_are_those_of_the_keyframes(truth: Truth, track: Track, keyframes: TimeArray) -> None:
    stream = measure_closures(truth.motion, ClosureModel(period_s=1.7, apart_s=20.0), QUIET)
    between = closures_at_keyframes(stream, keyframes, track)
    assert len(between) > 5
    assert_true(between, truth, keyframes)
    moved_by = np.maximum(np.abs(keyframes[between.j] - stream.t_ns[between.sample]), 1) * 1e-9
    assert moved_by.max() > 0.3
    grown = np.linalg.eigvalsh(between.cov - stream.cov[between.sample])
    assert (np.trace(between.cov[:, 3:, 3:], axis1=1, axis2=2) > np.trace(stream.cov[0, 3:, 3:])).all()
    assert np.isfinite(grown).all()


def test_closures_that_nobody_can_place_are_left_out(truth: Truth, track: Track, keyframes: TimeArray) -> None:
    stream = measure_closures(truth.motion, ClosureModel(period_s=1.7, apart_s=20.0), QUIET).select(slice(0, 3))
    t_ns = np.array([keyframes[5] + 1000, keyframes[-1] + 1, keyframes[8]])
    from_ns = np.array([keyframes[5], keyframes[3], keyframes[2]])
    between = closures_at_keyframes(replace(stream, t_ns=t_ns, from_ns=from_ns), keyframes, track)
    assert between.sample.tolist() == [2]
    assert (between.i.tolist(), between.j.tolist()) == ([2], [8])


@pytest.mark.parametrize("period_s", [0.1, 0.45, 2.3])
def test_odometry_is_that_of_the_keyframes(truth: Truth, track: Track, keyframes: TimeArray, period_s: float) -> None:
    """Steps finer than keyframes are joined, coarser ones reach over some."""
    stream = measure_odometry(truth.motion, OdometryModel(period_s=period_s), QUIET)
    between = odometry_at_keyframes(stream, keyframes, track)
    assert_true(between, truth, keyframes)
    np.testing.assert_array_equal(between.j[:-1], between.i[1:])
    if period_s < 0.5:
        assert (between.j - between.i == 1).all()
        assert len(between) >= len(keyframes) - 3


def test_a_gap_is_not_bridged(truth: Truth, track: Track, keyframes: TimeArray) -> None:
    stream = measure_odometry(truth.motion, OdometryModel(period_s=0.25), QUIET)
    gap = (stream.from_ns > keyframes[20]) & (stream.from_ns < keyframes[24])
    between = odometry_at_keyframes(stream.select(~gap), keyframes, track)
    assert_true(between, truth, keyframes)
    assert not ((between.i < 23) & (between.j > 21)).any()


def test_joined_steps_are_as_unsure_as_they_say(truth: Truth, track: Track, keyframes: TimeArray) -> None:
    model = OdometryModel(period_s=0.1, sigma=0.02, sigma_deg=0.3)
    d2 = []
    for seed in range(8):
        between = odometry_at_keyframes(measure_odometry(truth.motion, model, Noise.of(seed, "vo")), keyframes, track)
        error = between.T.to(poses(truth, keyframes[between.i]).to(poses(truth, keyframes[between.j]))).log()
        d2.append(np.sum((sqrt_information(between.cov) @ error[:, :, None])[..., 0] ** 2, axis=1))
    assert np.mean(d2) == pytest.approx(6.0, rel=0.05)


def one(cov: FloatArray) -> RelativePoses:
    t = np.array([2 * 10**9])
    return RelativePoses(
        t, t - 10**9, np.array([[3.0, 1.0, 0.5]]), np.array([[0.1, 0.2, -0.3]]), cov[None],
        np.array([True]), np.array(["test"]), np.array([50]),
    )  # fmt: skip


def test_what_was_not_measured_weighs_nothing_and_what_was_is_kept() -> None:
    direction = np.array([0.8, 0.0, 0.6])
    known = np.diag(np.repeat([1e-5, 1e-3], 3))
    cov = known.copy()
    cov[3:, 3:] += NOT_MEASURED * np.outer(direction, direction)
    S = sqrt_information(cov[None])[0]
    along = np.concatenate([np.zeros(3), direction])
    np.testing.assert_allclose(S @ along, 0.0, atol=1e-6)
    across = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    assert np.linalg.norm(S @ across) == pytest.approx(1e-3**-0.5, rel=1e-3)
    assert np.linalg.matrix_rank(S) == 5


def test_the_factor_is_whitened_by_the_covariance(truth: Truth, track: Track, keyframes: TimeArray) -> None:
    rng = np.random.default_rng(4)
    A = rng.normal(size=(6, 6))
    stream = replace(one(1e-4 * A @ A.T + 1e-6 * np.eye(6)), from_ns=keyframes[10:11], t_ns=keyframes[50:51])
    between = closures_at_keyframes(stream, keyframes, track)
    values = gtsam.Values()
    d = np.array([0.01, -0.02, 0.005, 0.1, 0.05, -0.2])
    T = gtsam.Pose3(gtsam.Rot3(between.T.R[0]), between.T.p[0])
    values.insert(X(10), gtsam.Pose3())
    values.insert(X(50), T.compose(gtsam.Pose3.Expmap(d)))
    expected = 0.5 * d @ np.linalg.solve(stream.cov[0], d)
    (factor,) = between.factors()
    assert type(factor) is gtsam.BetweenFactorPose3
    assert factor.error(values) == pytest.approx(expected, rel=1e-6)
