"""The chain against GTSAM's batch elimination of everything at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, C, V, X
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.errors import SolveError
from uwgraph.graph.builder import Problem, build
from uwgraph.graph.chain import Chain
from uwgraph.graph.initial import initial_state
from uwgraph.graph.keyframes import schedule
from uwgraph.graph.marginals import marginal_covariances
from uwgraph.graph.prepare import prepare
from uwgraph.graph.settings import SmoothSettings
from uwgraph.graph.solver import solve
from uwgraph.graph.track import dead_reckon
from uwgraph.simulate import SimulationSettings, simulate

SIZE = {"x": 3, "v": 2, "c": 2}
THRESHOLDS = {"x": np.array([1e-3] * 3 + [0.1] * 3), "v": np.full(3, 0.02), "b": np.array([0.01] * 3 + [1e-4] * 3)}
TIGHT = {symbol: 1e-9 * limit for symbol, limit in THRESHOLDS.items()}


def size(key: int) -> int:
    return SIZE[chr(gtsam.symbolChr(key))]


class Linear:
    """Random linear measurements of a chain of moments, each with two variables, and of one shared variable."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.graph = gtsam.NonlinearFactorGraph()
        self.every = gtsam.Values()
        self.links: dict[int, list[gtsam.NonlinearFactor]] = {}

    def guess(self, keys: Sequence[int]) -> gtsam.Values:
        values = gtsam.Values()
        for key in keys:
            values.insert(key, self.rng.normal(size=size(key)))
        return values

    def measurement(self, keys: Sequence[int], rows: int) -> gtsam.NonlinearFactor:
        """Of zero point: the same system wherever it is linearised."""
        blocks = [(key, self.rng.normal(size=(rows, size(key)))) for key in keys]
        flat = [each for block in blocks for each in block]
        linear = gtsam.JacobianFactor(*flat, self.rng.normal(size=rows), gtsam.noiseModel.Unit.Create(rows))
        zero = gtsam.Values()
        for key in keys:
            zero.insert(key, np.zeros(size(key)))
        factor = gtsam.LinearContainerFactor(linear, zero)
        self.graph.push_back(factor)
        return factor

    def moment(self, k: int) -> None:
        """What is measured when moment k is reached: it, its way from the one before, one long before, the shared."""
        if k == 0:
            self.measure([C(0), X(0)], 2)
            self.measure([X(0), V(0), C(0)], 6)
            return
        self.measure([V(k - 1), X(k)], 4)
        self.measure([X(k - 1), V(k)], 4)
        if k >= 3 and k % 2:
            self.measure([X(k - 2), X(k), C(0)], 2)

    def measure(self, keys: Sequence[int], rows: int) -> int:
        """One more measurement; the number of the link it belongs to."""
        link = min(gtsam.symbolIndex(key) for key in keys if key != C(0))
        self.links.setdefault(link, []).append(self.measurement(keys, rows))
        return link

    def begin(self, k: int, chain: Chain) -> Chain:
        """The chain with moment k and what is measured then."""
        values = self.guess([*keys_of(k), *([C(0)] if k == 0 else [])])
        self.every.insert(values)
        self.moment(k)
        return chain.extended(
            keys_of(k), values, {i: self.links[i] for i in range(max(k - 2, 0), k + 1) if i in self.links}
        )

    def batch(self) -> tuple[gtsam.Values, dict[int, np.ndarray]]:
        """Estimate and covariance of everything."""
        linear = self.graph.linearize(self.every)
        net = linear.eliminateSequential(gtsam.Ordering.ColamdGaussianFactorGraph(linear), gtsam.EliminateQR)
        return self.every.retract(net.optimize()), dict(marginal_covariances(net))


def keys_of(k: int) -> list[int]:
    return [V(k), X(k)]


def assert_newest(chain: Chain, made: Linear) -> None:
    estimate, covariance = made.batch()
    mine, mine_covariance = chain.newest_estimate(), chain.covariances()
    for key in (*keys_of(chain.last), C(0)):
        np.testing.assert_allclose(mine.atVector(key), estimate.atVector(key), atol=1e-8)
        np.testing.assert_allclose(mine_covariance[key], covariance[key], rtol=1e-7, atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(3, 8))
def test_a_forgetting_chain_knows_of_the_newest_what_the_batch_knows(seed: int, lag: int) -> None:
    made, chain = Linear(seed), Chain(gtsam.Values())
    for k in range(14):
        chain = made.begin(k, chain).relinearized({"x": np.full(3, 0.3)})
        assert_newest(chain, made)
        chain = chain.forgetting(len(chain.links) - lag)
        assert (len(chain.links), chain.last) == (min(k + 1, lag), k)
        assert_newest(chain, made)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.data())
def test_late_measurements_tell_what_they_would_have_told_in_time(seed: int, data: st.DataObject) -> None:
    made, chain = Linear(seed), Chain(gtsam.Values())
    for k in range(12):
        chain = made.begin(k, chain)
        chain = chain.forgetting(len(chain.links) - 6)
        late = data.draw(st.integers(chain.first, k))
        links = {made.measure([X(late)], 2), made.measure([V(late), C(0)], 1)}
        chain = chain.rebuilt({i: made.links[i] for i in links})
        assert_newest(chain, made)
    estimate, _ = made.batch()
    for key in chain.variables:
        np.testing.assert_allclose(chain.estimate().atVector(key), estimate.atVector(key), atol=1e-8)


def test_a_gap_that_nothing_bridges_is_no_obstacle() -> None:
    made = Linear(1)
    chain = made.begin(0, Chain(gtsam.Values()))
    alone = made.guess(keys_of(1))
    made.every.insert(alone)
    made.measure([X(1), V(1), C(0)], 6)
    chain = chain.extended(keys_of(1), alone, {1: made.links[1]})
    assert_newest(chain, made)
    assert_newest(chain.forgetting(), made)


def swum_linear(moments: int) -> tuple[Linear, Chain]:
    made, chain = Linear(1), Chain(gtsam.Values())
    for k in range(moments):
        chain = made.begin(k, chain)
    return made, chain


def test_the_chain_before_an_update_is_as_it_was() -> None:
    """Undoing an update is to keep the chain before it."""
    made, chain = swum_linear(6)
    before = chain.newest_estimate().atVector(X(5)), chain.covariances()[X(5)]
    made.measure([X(3)], 2)
    chain.rebuilt({3: made.links[3]}).relinearized({"x": np.zeros(3)}).forgetting(3).estimate()
    again = replace(chain)
    np.testing.assert_array_equal(again.newest_estimate().atVector(X(5)), before[0])
    np.testing.assert_array_equal(again.covariances()[X(5)], before[1])


@pytest.mark.parametrize(
    ("link", "keys"), [(1, [X(1), X(4)]), (9, [X(9)]), (4, [X(3), X(4)]), (3, [X(5)]), (3, [C(0)])]
)
def test_what_does_not_belong_to_a_link_is_refused(link: int, keys: list[int]) -> None:
    made, chain = swum_linear(6)
    with pytest.raises(KeyError):
        chain.forgetting(3).rebuilt({link: [made.measurement(keys, 2)]})


def test_what_nobody_measures_is_an_error_and_no_answer() -> None:
    made = Linear(1)
    velocity_only = {0: [made.measurement([V(0)], 2)]}
    chain = Chain(gtsam.Values()).extended([V(0), X(0)], made.guess([V(0), X(0)]), velocity_only)
    with pytest.raises(SolveError, match="x0"):
        chain.newest_estimate()
    with pytest.raises(SolveError, match="x0"):
        chain.extended([V(1), X(1)], made.guess([V(1), X(1)]), {0: [made.measurement([V(0), X(1)], 2)]})


@pytest.fixture(scope="module")
def problem() -> Problem:
    dive = simulate(SimulationSettings(duration_s=60.0, imu_rate_hz=50.0), 3)
    chosen = SmoothSettings(dvl_calibration=False)
    prepared = prepare(dive)
    initial = initial_state(prepared, chosen)
    keyframes = schedule(prepared, chosen, initial.t_ns, int(prepared.imu.t_ns[-1]))
    track = dead_reckon(prepared, initial.t_ns, initial.R_nb, initial.p_n, initial.cov_rotation_b)
    return build(prepared, chosen, initial, keyframes, track)


def swum(problem: Problem, lag: int) -> Chain:
    """The dive's keyframes one by one, each linearised anew where it moved."""
    links: list[list[gtsam.NonlinearFactor]] = [[] for _ in problem.keyframes]
    for i in range(problem.graph.size()):
        factor = problem.graph.at(i)
        links[min(map(gtsam.symbolIndex, factor.keys()))].append(factor)
    chain = Chain(gtsam.Values())
    for k in range(len(links)):
        keys = [V(k), B(k), X(k)]
        so_far = {i: [f for f in links[i] if max(map(gtsam.symbolIndex, f.keys())) <= k] for i in (k - 1, k) if i >= 0}
        chain = chain.extended(keys, problem.values.extract(keys), so_far).relinearized(THRESHOLDS)
        chain = chain.forgetting(len(chain.links) - lag)
    return chain


def test_a_chain_that_forgets_nothing_ends_where_the_batch_solver_does(problem: Problem) -> None:
    chain = swum(problem, lag=1000)
    for _ in range(20):
        before, chain = chain, chain.relinearized(TIGHT)
        if chain is before:
            break
    batch = solve(problem, SmoothSettings(tolerance=1e-10), lambda done: None).values
    mine = chain.estimate()
    for k in range(len(problem.keyframes)):
        apart = batch.atPose3(X(k)).localCoordinates(mine.atPose3(X(k)))
        assert np.abs(apart).max() < 1e-6


def test_a_short_window_stays_within_its_sigma_of_the_batch(problem: Problem) -> None:
    chain = swum(problem, lag=10)
    batch = solve(problem, SmoothSettings(), lambda done: None).values
    linear = problem.linearize(batch)
    covariance = marginal_covariances(linear.eliminateSequential(problem.ordering(linear), gtsam.EliminateQR))
    last = X(len(problem.keyframes) - 1)
    sigma = np.sqrt(np.diag(covariance[last]))
    apart = batch.atPose3(last).localCoordinates(chain.newest_estimate().atPose3(last))
    assert np.abs(apart / sigma).max() < 0.1
    np.testing.assert_allclose(np.sqrt(np.diag(chain.covariances()[last])), sigma, rtol=0.02)
