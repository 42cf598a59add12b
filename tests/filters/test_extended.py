"""The extended filter: the Kalman filter on a linear problem, and iterated the same as a graph of one state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X
from hypothesis import given, settings
from hypothesis import strategies as st
from linear import System, belief_of, covariance, held_to, predicted, updated, vector
from scipy.linalg import block_diag

import factors
from uwgraph.dive.rig import ImuRig
from uwgraph.filters import extended, unscented
from uwgraph.filters.ins import CORE, Ins
from uwgraph.filters.kalman import Kalman
from uwgraph.filters.state import Belief, State
from uwgraph.filters.unscented import Seen, Spread
from uwgraph.graph.observed import Observed
from uwgraph.types import FloatArray

DEG = np.pi / 180.0


@settings(max_examples=50, deadline=None)
@given(n=st.integers(1, 8), m=st.integers(1, 5), seed=st.integers(0, 2**32 - 1))
def test_a_linear_problem_gives_the_kalman_filter(n: int, m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = System.drawn(rng, n, m)
    x, P = rng.normal(size=n), covariance(rng, n)
    belief = belief_of(x, P)
    for k in range(10):
        z = rng.normal(size=m)
        belief = extended.predict(belief, k, vector(system.F @ belief.x.y), system.F, system.noise_rows)
        x, P = predicted(x, P, system.F, system.Q)
        held_to(belief, (x, P))
        seen = extended.see(belief, system.H @ belief.x.y - z, system.H)
        belief = unscented.moved_by(belief, seen, seen.with_noise(system.S_R))
        x, P = updated(x, P, system.H, system.R, z)
        held_to(belief, (x, P))


@pytest.mark.parametrize("seed", range(5))
def test_a_short_derivative_does_where_only_the_first_numbers_are_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = System.drawn(rng, 7, 2)
    H = np.hstack([system.H[:, :3], np.zeros((2, 4))])
    x, P, z = rng.normal(size=7), covariance(rng, 7), rng.normal(size=2)
    belief = belief_of(x, P)
    seen = extended.see(belief, H @ x - z, H[:, :3])
    held_to(unscented.moved_by(belief, seen, seen.with_noise(system.S_R)), updated(x, P, H, system.R, z))


# Constant parts of the state


@dataclass(frozen=True)
class Linear(Kalman):
    """A filter whose moving part is a random linear system, by sigma points or to first order."""

    system: System
    by_points: bool

    def step(self, core: Belief, t_ns: int, step: FloatArray, earth: FloatArray) -> Belief:
        return self.step_and_carry(core, t_ns, step, earth)[0]

    def step_and_carry(self, core: Belief, t_ns: int, step: FloatArray, earth: FloatArray) -> tuple[Belief, FloatArray]:
        F, rows = self.system.F, self.system.noise_rows
        if not self.by_points:
            return extended.predict_and_carry(core, t_ns, vector(F @ core.x.y), F, rows)

        def move(x: State) -> State:
            return State(x.R, x.y @ F.T, x.rot)

        return unscented.predict_and_carry(core, t_ns, move, rows, Spread().of(CORE))

    def see(self, belief: Belief, observed: Observed, nodes: Sequence[int] = ()) -> Seen:
        raise NotImplementedError


@pytest.mark.parametrize("by_points", [True, False], ids=["unscented", "extended"])
@pytest.mark.parametrize("constant", [6, 1, 0])
@pytest.mark.parametrize("seed", range(3))
def test_what_does_not_move_keeps_its_correlations(by_points: bool, constant: int, seed: int) -> None:
    """The core moved alone and what is constant carried along, against the filter of the whole state."""
    rng = np.random.default_rng(seed)
    n, m = CORE, 3
    core = System.drawn(rng, n, m)
    F, Q = block_diag(core.F, np.eye(constant)), block_diag(core.Q, np.zeros((constant, constant)))
    H = rng.normal(size=(m, n + constant))
    x, P = rng.normal(size=n + constant), covariance(rng, n + constant)
    belief, filtered = belief_of(x, P), Linear(Ins(ImuRig()), core, by_points)
    for k in range(20):
        belief = filtered.predict(belief, k, np.zeros((4, 7)), np.zeros(6))
        for _ in range(4):
            x, P = predicted(x, P, F, Q)
        held_to(belief, (x, P))
        z = rng.normal(size=m)
        seen = extended.see(belief, H @ belief.x.y - z, H)
        belief = unscented.moved_by(belief, seen, seen.with_noise(core.S_R))
        x, P = updated(x, P, H, core.R, z)
        held_to(belief, (x, P))


# The iterated filter and the graph

ARM = np.array([0.8, -0.3, 0.5])
SUN = np.array([0.5, 0.4, -np.sqrt(1.0 - 0.41)])


def sun_scatter(R_nb: FloatArray, sigma: float) -> factors.SunScatter:
    s_b = R_nb.T @ SUN
    return factors.SunScatter((np.eye(3) - np.outer(s_b, s_b)) / sigma**2, SUN)


def observed_once() -> list[Observed]:
    """Far from the prior, so that the first linearisation is wrong by much."""
    R = gtsam.Rot3.RzRyRx(0.1, -0.15, 0.9).matrix()
    position = factors.PositionFix(np.array([4.0, -7.0, 11.0]), np.diag([0.3, 0.2, 0.5]) ** 2, ARM)
    velocity = factors.DvlVelocity(np.array([1.2, 0.1, -0.1]), 0.02**2 * np.eye(3), np.array([0.02, 0.0, 0.1]), ARM)
    return [
        Observed(0, "fixes", position),
        Observed(0, "heading", factors.Heading(0.9, 2.0 * DEG, -0.15)),
        Observed(0, "sun", sun_scatter(R, 1.0 * DEG)),
        Observed(0, "depth", factors.Depth(11.2, 0.05, l_b=ARM)),
        Observed(0, "dvl", velocity, ("pose", "velocity", "bias", "dvl")),
    ]


def prior_belief() -> Belief:
    rng = np.random.default_rng(5)
    ins = Ins(ImuRig())
    x = ins.state(gtsam.Rot3.RzRyRx(0.2, 0.0, 0.5).matrix(), np.array([3.0, -8.0, 10.0]), np.array([1.0, 0.6, 0.0]))
    sigmas = np.repeat([0.3, 2.0, 0.5, 1e-3, 1e-2], 3)
    root = np.linalg.cholesky(0.5 * np.eye(CORE) + 0.5 * np.corrcoef(rng.normal(size=(CORE, 40))))
    return Belief(0, x, np.tril(sigmas[:, None] * root))


@dataclass(frozen=True, eq=False)
class Prior(factors.Measurement):
    """A belief as a factor: the graph's pose has its translation in body axes, its bias the accelerometer first."""

    variables = ("Pose3", "Vector", "ConstantBias")
    belief: Belief

    def residual(self, pose: gtsam.Pose3, v_n: FloatArray, bias: gtsam.imuBias.ConstantBias) -> FloatArray:
        return self.belief.x.to(state_of(self.belief.x, pose, v_n, bias))

    def jacobians(
        self, pose: gtsam.Pose3, v_n: FloatArray, bias: gtsam.imuBias.ConstantBias
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        away = self.residual(pose, v_n, bias)
        J = to_ours(pose.rotation().matrix())
        J[:3, :3] = gtsam.SO3.LogmapDerivative(away[:3])
        return J[:, :6], J[:, 6:9], J[:, 9:]

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Gaussian.Covariance(self.belief.P)

    def lowered(self, keys: Sequence[int], loss: factors.adapter.Loss | None = None) -> gtsam.NonlinearFactor:
        return self.reference(keys, loss)


def state_of(like: State, pose: gtsam.Pose3, v_n: FloatArray, bias: gtsam.imuBias.ConstantBias) -> State:
    y = np.concatenate([np.zeros(3), pose.translation(), v_n, bias.gyroscope(), bias.accelerometer()])
    return State(pose.rotation().matrix()[None], y, like.rot)


def to_ours(R_nb: FloatArray) -> FloatArray:
    """Derivative of our tangent by the graph's, shape (15, 15)."""
    T = np.eye(CORE)
    T[3:6, 3:6] = R_nb
    T[9:, 9:] = np.roll(np.eye(6), 3, axis=0)
    return T


def graph_posterior(prior: Belief, measured: Sequence[Observed]) -> Belief:
    """Gauss-Newton on a graph of one state until it stands still."""
    key = {"pose": X(0), "velocity": V(0), "bias": B(0), "dvl": gtsam.symbol("c", 0)}
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(Prior(prior).lowered([X(0), V(0), B(0)]))
    for o in measured:
        graph.push_back(o.model.lowered([key[role] for role in o.roles]))
    graph.push_back(gtsam.PriorFactorVector(key["dvl"], np.zeros(4), gtsam.noiseModel.Isotropic.Sigma(4, 1e-9)))
    y = prior.x.y
    values.insert(X(0), gtsam.Pose3(gtsam.Rot3(prior.x.R[0]), y[3:6]))
    values.insert(V(0), y[6:9])
    values.insert(B(0), gtsam.imuBias.ConstantBias(y[12:15], y[9:12]))
    values.insert(key["dvl"], np.zeros(4))
    for _ in range(60):
        delta = graph.linearize(values).optimize()
        values = values.retract(delta)
        if delta.norm() < 1e-13:
            break
    pose, bias = values.atPose3(X(0)), values.atConstantBias(B(0))
    order = gtsam.Ordering()
    for k in (X(0), V(0), B(0), key["dvl"]):
        order.push_back(k)
    information = graph.linearize(values).hessian(order)[0]
    T = to_ours(pose.rotation().matrix())
    P = T @ np.linalg.inv(information)[:CORE, :CORE] @ T.T
    return Belief(0, state_of(prior.x, pose, values.atVector(V(0)), bias), np.asarray(np.linalg.cholesky(P)))


@pytest.mark.parametrize("which", [(0,), (1,), (2,), (3,), (0, 1), (0, 2, 3), (0, 1, 2, 3), (0, 1, 2, 3, 4)])
def test_a_graph_of_one_state_is_the_iterated_filter(which: tuple[int, ...]) -> None:
    prior, ins = prior_belief(), Ins(ImuRig())
    measured = [observed_once()[n] for n in which]

    def linearize(x: State) -> tuple[FloatArray, FloatArray]:
        batch = State(x.R[None], x.y[None], x.rot)
        residuals = [ins.residuals(o, batch)[0] for o in measured]
        return np.concatenate(residuals), np.vstack([ins.jacobian(o, x) for o in measured])

    m = sum(len(o.whitener) for o in measured)
    filtered, expected = extended.iterate(prior, linearize, np.eye(m)), graph_posterior(prior, measured)
    assert np.abs(filtered.x.to(expected.x)).max() < 1e-8
    sigmas = np.sqrt(np.diag(expected.P))
    assert np.abs((filtered.P - expected.P) / np.outer(sigmas, sigmas)).max() < 1e-8
    once = extended.iterate(prior, linearize, np.eye(m), most=1)
    assert np.abs(once.x.to(expected.x)).max() > 1e-6, "one step is enough here: the test says nothing"


def test_one_iteration_is_the_plain_update() -> None:
    prior, ins = prior_belief(), Ins(ImuRig())
    fix = observed_once()[0]
    batch = State(prior.x.R[None], prior.x.y[None], prior.x.rot)
    z, H = ins.residuals(fix, batch)[0], ins.jacobian(fix, prior.x)
    seen = extended.see(prior, z, H)
    plain = unscented.moved_by(prior, seen, seen.with_noise(np.eye(3)))
    once = extended.iterate(prior, lambda x: (z, H), np.eye(3), most=1)
    np.testing.assert_allclose(once.x.to(plain.x), 0.0, atol=1e-12)
