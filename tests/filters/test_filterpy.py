"""The unscented filter against filterpy's, on the same 15-state inertial model: two implementations, one filter."""

from __future__ import annotations

from functools import partial

import gtsam
import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

import factors
from uwgraph.dive.rig import ImuRig
from uwgraph.filters.ins import BA, BG, CORE, THETA, Ins, P, V, start_root
from uwgraph.filters.kalman import Unscented
from uwgraph.filters.state import Belief, State
from uwgraph.filters.unscented import Spread, moved_by
from uwgraph.graph.observed import Observed
from uwgraph.types import FloatArray

ALPHA, BETA, KAPPA = 1.0, 2.0, 0.0
DT = 0.02
EARTH = np.array([0.01, 0.0, 9.80, 5e-5, 0.0, -5e-5])
NOISE = ImuRig(
    gyro_noise_density=1e-3, accel_noise_density=1e-2, gyro_bias_walk=1e-4, accel_bias_walk=1e-3, gyro_bias_sigma=2e-3
)
ARM = np.array([0.4, -0.2, 0.3])


def as_vector(x: State) -> FloatArray:
    """Rotation vector and numbers in one array, as filterpy has states."""
    v = x.y.copy()
    v[THETA] = gtsam.Rot3.Logmap(gtsam.Rot3(x.R[0]))
    return v


def as_state(v: FloatArray) -> State:
    y = v.copy()
    y[THETA] = 0.0
    return State(gtsam.Rot3.Expmap(v[THETA]).matrix()[None], y, np.array([0]))


def oracle(ins: Ins, start: Belief) -> UnscentedKalmanFilter:
    """filterpy's filter with additions and differences on the manifold."""

    def plus(v: FloatArray, d: FloatArray) -> FloatArray:
        return as_vector(as_state(v).plus(d))

    def minus(a: FloatArray, b: FloatArray) -> FloatArray:
        return as_state(b).to(as_state(a))

    def mean(sigmas: FloatArray, Wm: FloatArray) -> FloatArray:
        return plus(sigmas[0], Wm @ np.array([minus(s, sigmas[0]) for s in sigmas]))

    def fx(v: FloatArray, dt: float, step: FloatArray) -> FloatArray:
        x = as_state(v)
        moved = ins.move(State(x.R[None], x.y[None], x.rot), step, EARTH)
        return as_vector(State(moved.R[0], moved.y[0], x.rot))

    points = MerweScaledSigmaPoints(CORE, ALPHA, BETA, KAPPA, subtract=lambda v, d: plus(v, -d))
    ukf = UnscentedKalmanFilter(CORE, 3, DT, None, fx, points, x_mean_fn=mean, residual_x=minus, state_add=plus)
    rows = ins.noise_rows(DT)
    ukf.x, ukf.P, ukf.Q = as_vector(start.x), start.P, rows.T @ rows
    return ukf


def measured(k: int, rng: np.random.Generator) -> list[Observed]:
    """DVL at every fifth step, depth at every seventh, heading at every eleventh."""
    now = []
    if k % 5 == 0:
        v = np.array([1.5, 0.1, 0.0]) + 0.02 * rng.normal(size=3)
        model = factors.DvlVelocity(v, 0.02**2 * np.eye(3), np.array([0.02, 0.01, 0.1]), ARM)
        now.append(Observed(k, "dvl", model, ("pose", "velocity", "bias", "dvl")))
    if k % 7 == 0:
        now.append(Observed(k, "depth", factors.Depth(20.0 + 0.05 * rng.normal(), 0.05, l_b=ARM)))
    if k % 11 == 0:
        now.append(Observed(k, "heading", factors.Heading(0.7 + 0.1 * k * DT + 0.02 * rng.normal(), 0.02, 0.1)))
    return now


def test_mean_and_covariance_are_filterpys() -> None:
    rng = np.random.default_rng(0)
    ins = Ins(NOISE)
    x = ins.state(gtsam.Rot3.RzRyRx(0.05, 0.1, 0.7).matrix(), np.array([0.0, 0.0, 20.0]), np.array([1.1, 0.9, 0.0]))
    sigmas = (0.1, 1.0, 0.3, 2e-3, 2e-2)
    belief = Belief(0, x, start_root([s * np.eye(3) for s in sigmas]))
    ours, theirs = Unscented(ins, Spread(ALPHA, BETA, KAPPA)), oracle(ins, belief)
    updates = 0
    for k in range(1, 201):
        f, w = np.array([0.98, -0.49, -9.74]), np.array([0.02, 0.01, 0.1])
        step = np.concatenate([[DT], f + 0.3 * rng.normal(size=3), w + 0.02 * rng.normal(size=3)])
        belief = ours.predict(belief, k, step[None], EARTH)
        theirs.predict(step=step)
        for observed in measured(k, rng):
            seen = ours.see(belief, observed)
            belief = moved_by(belief, seen, seen.with_noise(np.eye(len(seen.mean))))
            hx = partial(_residual, ins, observed)
            theirs.update(np.zeros(len(seen.mean)), R=np.eye(len(seen.mean)), hx=hx)
            theirs.sigmas_f = theirs.points_fn.sigma_points(theirs.x, theirs.P)
            updates += 1
        away = belief.x.to(as_state(theirs.x))
        spread = np.sqrt(np.diag(theirs.P))
        assert np.abs(away).max() < 1e-6
        assert np.abs((belief.P - theirs.P) / np.outer(spread, spread)).max() < 1e-6
    assert updates > 80
    # the filter moved and learnt: equality of what did nothing would be no result
    assert np.linalg.norm(belief.x.y[P] - x.y[P]) > 3.0
    assert np.abs(belief.x.y[np.r_[BG, BA]]).max() > 1e-4
    assert np.sqrt(np.diag(belief.P)[V]).max() < 0.05


def _residual(ins: Ins, observed: Observed, v: FloatArray) -> FloatArray:
    x = as_state(v)
    return ins.residuals(observed, State(x.R[None], x.y[None], x.rot))[0]
