"""The inertial process: against an exact reference, its derivatives against differences, and its noise."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

import factors
from uwgraph.dive.rig import ImuRig
from uwgraph.filters.ins import BA, BG, CORE, DRIFT, NODE, THETA, GyroDrift, Ins, P, V, start_root
from uwgraph.filters.state import Belief, State
from uwgraph.graph.observed import Observed
from uwgraph.types import FloatArray

RATE_HZ = 100
GRAVITY = np.array([0.003, -0.002, 9.8])
EARTH_RATE = 7.292115e-5 * np.array([np.cos(0.75), 0.0, -np.sin(0.75)])
EARTH = np.concatenate([GRAVITY, EARTH_RATE])
NOISE = ImuRig(gyro_noise_density=1e-3, accel_noise_density=1e-2, gyro_bias_walk=1e-4, accel_bias_walk=1e-3)
DRIFTING = GyroDrift(gyro_tau_s=30.0, accel_tau_s=50.0)
LAYOUTS = {
    "walk": Ins(NOISE),
    "Markov": Ins(NOISE, DRIFTING),
    "calibrated": Ins(NOISE, None, True),
    "Markov, calibrated": Ins(NOISE, DRIFTING, True),
}
EACH_LAYOUT = pytest.mark.parametrize("ins", LAYOUTS.values(), ids=LAYOUTS.keys())


def drawn(ins: Ins, rng: np.random.Generator) -> State:
    """Any attitude, metres, metres a second, and biases far larger than real ones."""
    x = ins.state(rotation(rng), rng.normal(size=3), rng.normal(size=3))
    y = x.y.copy()
    y[BG], y[BA] = 0.02 * rng.normal(size=3), 0.3 * rng.normal(size=3)
    y[CORE:] = 0.02 * rng.normal(size=ins.size - CORE)
    return replace(x, y=y)


def rotation(rng: np.random.Generator) -> FloatArray:
    return np.asarray(gtsam.Rot3.Expmap(rng.normal(size=3)).matrix())


def batch(x: State) -> State:
    return State(x.R[None].copy(), x.y[None].copy(), x.rot)


def motion(seconds: float, rate: float) -> factors.inertial.Steps:
    """Turning by about ``rate`` [rad/s] about all axes, under forces of 10 m/s^2 and more."""
    n = round(seconds * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    w = rate * np.column_stack([1.5 * np.sin(3.0 * t), np.cos(2.0 * t), 0.8 + 0.0 * t])
    f = np.column_stack([4.0 * np.cos(2.0 * t), 3.0 * np.sin(t), -9.8 + 2.0 * np.sin(4.0 * t)])
    return factors.inertial.Steps(np.full(n, 1.0 / RATE_HZ), f, w, np.array([0, n]))


def after(ins: Ins, x: State, steps: factors.inertial.Steps, earth: FloatArray) -> State:
    moving = batch(x)
    for step in np.column_stack([steps.dt, steps.f_b, steps.w_b]):
        moving = ins.move(moving, step, earth)
    return State(moving.R[0], moving.y[0], x.rot)


@pytest.mark.parametrize(
    ("rate", "earth_rate", "tolerance"),
    [
        (0.0, 0.0, 1e-9),
        (0.1, 0.0, 1e-8),
        (1.0, 0.0, 5e-6),
        # what is left is the centrifugal force, which the reference takes at the moving place
        (0.1, 1.0, 1e-6),
    ],
    ids=["straight", "a vehicle", "a shaken hand", "a vehicle on the Earth"],
)
def test_seconds_of_motion_are_those_of_the_exact_reference(rate: float, earth_rate: float, tolerance: float) -> None:
    rng = np.random.default_rng(2)
    ins, steps, omega = Ins(NOISE), motion(5.0, rate), earth_rate * EARTH_RATE
    x = drawn(ins, rng)
    exact = factors.InertialMotion(steps, factors.ImuNoise(1e-3, 1e-2, 1e-4, 1e-3), GRAVITY, omega, x.y[P])
    bias = gtsam.imuBias.ConstantBias(x.y[BA], x.y[BG])
    pose, v_n = exact.predict(gtsam.Pose3(gtsam.Rot3(x.R[0]), x.y[P]), x.y[V], bias)
    moved = after(ins, x, steps, np.concatenate([GRAVITY, omega]))
    np.testing.assert_allclose(moved.R[0], pose.rotation().matrix(), atol=1e-11)
    np.testing.assert_allclose(moved.y[V], v_n, atol=tolerance)
    np.testing.assert_allclose(moved.y[P], pose.translation(), atol=tolerance)
    np.testing.assert_array_equal(moved.y[np.r_[BG, BA]], x.y[np.r_[BG, BA]])


def test_a_markov_drift_adds_to_the_bias_and_dies_away() -> None:
    rng = np.random.default_rng(3)
    plain, drifting = Ins(NOISE), Ins(NOISE, DRIFTING)
    step = np.array([0.01, 0.5, -0.3, -9.7, 0.1, 0.2, -0.1])
    with_drift = drawn(drifting, rng)
    y = with_drift.y[:CORE].copy()
    y[BG] += with_drift.y[DRIFT]
    without = State(with_drift.R, y, with_drift.rot)
    a, b = drifting.move(batch(with_drift), step, EARTH), plain.move(batch(without), step, EARTH)
    np.testing.assert_allclose(a.R, b.R, atol=1e-15)
    np.testing.assert_allclose(a.y[0, 3:9], b.y[0, 3:9], atol=1e-15)
    np.testing.assert_allclose(a.y[0, DRIFT], with_drift.y[DRIFT] * np.exp(-0.01 / 30.0), rtol=1e-12)
    np.testing.assert_allclose(a.y[0, BA], with_drift.y[BA] * np.exp(-0.01 / 50.0), rtol=1e-12)
    np.testing.assert_array_equal(a.y[0, BG], with_drift.y[BG])


# Derivatives


def slope(f: object, x: State, columns: int, step: float = 1e-5) -> FloatArray:
    """Central differences by the first numbers of the tangent of a function of many states."""
    d = step * np.eye(x.size)[:columns]
    return np.asarray((f(x.plus(d)) - f(x.plus(-d))).T / (2.0 * step))  # type: ignore[operator]


def transition_error(ins: Ins, x: State, dt: float, earth: FloatArray) -> float:
    step = np.array([dt, 3.0, -2.0, -9.0, 0.5, -0.3, 0.4])
    moved = ins.move(batch(x), step, earth)
    centre = State(moved.R[0], moved.y[0], x.rot)
    expected = slope(lambda states: centre.to(ins.move(states, step, earth)), x, x.size)
    return float(np.abs(ins.transition(x, step, earth) - expected).max())


@EACH_LAYOUT
@pytest.mark.parametrize("seed", range(3))
def test_the_transition_is_the_derivative_of_the_motion(ins: Ins, seed: int) -> None:
    """To third order in the step, as it says."""
    x = drawn(ins, np.random.default_rng(seed))
    still = np.concatenate([GRAVITY, np.zeros(3)])
    assert transition_error(ins, x, 0.01, EARTH) < 2e-6
    assert transition_error(ins, x, 0.04, still) < 2e-4
    assert transition_error(ins, x, 0.04, still) > 7.0 * transition_error(ins, x, 0.02, still)


def observations(node_ns: int) -> list[Observed]:
    """One of every kind; the roles say which part of the state is asked."""
    arm, v = np.array([0.5, -0.3, 0.2]), np.array([1.0, 0.2, -0.1])
    wide = np.diag([0.04, 0.09, np.inf])
    s_b = np.array([0.36, 0.48, -0.8])
    T_ij = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, 0.2, -0.4), np.array([2.0, -1.0, 0.3]))
    dvl = factors.DvlVelocity(v, np.diag([1e-4, 4e-4, 1e-4]), np.array([0.1, -0.2, 0.3]), arm, EARTH_RATE)
    return [
        Observed(1, "depth", factors.Depth(10.0, 0.1, np.array([0.01, 0.0, 1.0]), l_b=arm)),
        Observed(1, "fixes", factors.PositionFix(np.array([1.0, 2.0, 3.0]), wide, arm)),
        Observed(1, "heading", factors.Heading(0.3, 0.02, 0.1)),
        Observed(1, "sun", factors.SunScatter((np.eye(3) - np.outer(s_b, s_b)) / 0.01**2, np.array([0.6, 0.0, -0.8]))),
        Observed(1, "direction", factors.Direction(s_b, np.array([0.6, 0.0, -0.8]), np.diag([1e-4, 4e-4]))),
        Observed(1, "dvl", dvl, ("pose", "velocity", "bias", "dvl")),
        Observed(1, "closures", factors.RelativePose(T_ij, 0.01 * np.eye(6)), ("node", "pose"), node_ns),
        Observed(1, "seen", factors.RelativePose(T_ij, 0.01 * np.eye(6)), ("pose", "node"), node_ns),
    ]


@EACH_LAYOUT
@pytest.mark.parametrize("which", range(8))
def test_the_jacobian_is_the_derivative_of_the_residual(ins: Ins, which: int) -> None:
    """With two poses remembered, so that a wrong place in the state is seen."""
    rng = np.random.default_rng(which)
    observed = observations(node_ns=70)[which]
    belief = Belief(0, drawn(ins, rng), 0.3 * np.eye(ins.size))
    for _ in range(2):
        belief = ins.remember(belief)
    x = belief.x.plus(0.3 * rng.normal(size=belief.x.size))
    nodes = (60, 70)
    reach = ins.reach(observed, nodes)
    assert reach == (ins.size + 2 * NODE if "node" in observed.roles else ins.size)
    expected = slope(lambda states: ins.residuals(observed, states, nodes), x, x.size)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_array_equal(expected[:, reach:], 0.0)
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(ins.jacobian(observed, x, nodes), expected[:, :reach], atol=1e-6 * scale)


def test_a_remembered_pose_is_the_one_that_was() -> None:
    """And as unsure, and bound to it: their difference has no variance."""
    rng = np.random.default_rng(0)
    ins = Ins(NOISE, None, True)
    root = np.tril(rng.normal(size=(ins.size, ins.size)))
    belief = ins.remember(Belief(0, drawn(ins, rng), root))
    at = ins.node_at((33,), 33)
    np.testing.assert_array_equal(belief.x.R[1], belief.x.R[0])
    np.testing.assert_array_equal(belief.x.y[at + 3 : at + 6], belief.x.y[P])
    D = np.zeros((NODE, belief.x.size))
    D[:, :NODE], D[:, at : at + NODE] = np.eye(NODE), -np.eye(NODE)
    np.testing.assert_allclose(D @ belief.S, 0.0, atol=1e-12)


# Noise


def covariance_after(ins: Ins, seconds: float, dt: float) -> FloatArray:
    """Of the noise alone, straight and level, from a state known exactly."""
    x, step = ins.state(np.eye(3), np.zeros(3), np.zeros(3)), np.array([dt, 0.0, 0.0, -9.8, 0.0, 0.0, 0.0])
    C = np.zeros((ins.size, ins.size))
    rows = ins.noise_rows(dt)
    for _ in range(round(seconds / dt)):
        F = ins.transition(x, step, np.array([0.0, 0.0, 9.8, 0.0, 0.0, 0.0]))
        C = F @ C @ F.T + rows.T @ rows
    return np.asarray(C)


@pytest.mark.parametrize("ins", [LAYOUTS["walk"], LAYOUTS["Markov"]], ids=["walk", "Markov"])
def test_the_noise_of_many_small_steps_is_that_of_few(ins: Ins) -> None:
    fine, coarse = covariance_after(ins, 2.0, 0.005), covariance_after(ins, 2.0, 0.04)
    sigmas = np.sqrt(np.diag(fine) + 1e-30)
    np.testing.assert_allclose(coarse / np.outer(sigmas, sigmas), fine / np.outer(sigmas, sigmas), atol=0.03)


def test_the_variances_are_those_of_integrated_white_noise() -> None:
    C, t = np.diag(covariance_after(Ins(NOISE), 1.0, 0.01)), 1.0
    np.testing.assert_allclose(C[THETA], 1e-6 * t, rtol=1e-2)
    np.testing.assert_allclose(C[BG], 1e-8 * t, rtol=1e-9)
    np.testing.assert_allclose(C[BA], 1e-6 * t, rtol=1e-9)
    down = C[V][2], C[P][2]  # the axis to which the tilt gives nothing
    np.testing.assert_allclose(down, (1e-4 * t, 1e-4 * t**3 / 3.0), rtol=1e-2)


def test_a_markov_drift_varies_as_its_walk_says() -> None:
    """Stationary variance walk^2 tau / 2, drawn with the process's own noise; begun with nothing it is never more."""
    rng = np.random.default_rng(0)
    ins, dt, M = Ins(NOISE, DRIFTING), 1.0, 4000
    rows, step = ins.noise_rows(dt), np.array([dt, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    x = State(np.tile(np.eye(3), (M, 1, 1, 1)), np.zeros((M, ins.size)), np.array([0]))
    for _ in range(150):
        x = ins.move(x, step, np.zeros(6))
        x.y[:, 9:] += (rng.normal(size=(M, len(rows))) @ rows)[:, 9:]
    np.testing.assert_allclose(x.y[:, DRIFT].var(axis=0), 1e-8 * 30.0 / 2.0, rtol=0.06)
    np.testing.assert_allclose(x.y[:, BA].var(axis=0), 1e-6 * 50.0 / 2.0, rtol=0.06)
    np.testing.assert_array_equal(x.y[:, BG], 0.0)


def test_a_start_root_is_block_diagonal() -> None:
    S = start_root([np.tril(np.ones((3, 3))), 2.0 * np.eye(2)])
    np.testing.assert_array_equal(S[:3, :3], np.tril(np.ones((3, 3))))
    np.testing.assert_array_equal(S[3:, 3:], 2.0 * np.eye(2))
    assert S[:3, 3:].any() == S[3:, :3].any() == np.False_
