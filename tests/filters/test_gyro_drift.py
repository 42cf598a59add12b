"""The gyro's bias as a constant and a Markov drift: against the bias that walks, and against a simulated drift."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uwgraph.dive.rig import ImuRig
from uwgraph.filters import unscented
from uwgraph.filters.estimate import first_belief, task_of
from uwgraph.filters.ins import BG, CORE, DRIFT, GyroDrift, Ins, start_root
from uwgraph.filters.kalman import Extended, Unscented
from uwgraph.filters.monitor import Policy
from uwgraph.filters.run import Epochs, Filtering, Runner
from uwgraph.filters.sensors import observations
from uwgraph.filters.state import Belief, State
from uwgraph.frames import earth_rate_n
from uwgraph.graph.observed import Observed
from uwgraph.simulate import SimulationSettings, simulate
from uwgraph.types import FloatArray, Origin

SHORT = SimulationSettings(duration_s=60.0, leg_length_m=20.0, line_spacing_m=20.0, surface_time_s=5.0)
RUNS = 30
GRAVITY = np.array([0.0, 0.0, 9.81])


def test_a_drift_that_never_decays_is_a_bias_that_walks():
    task = task_of(simulate(SHORT, 3))
    rig = task.prepared.dive.rig.imu
    walking, drifting = Ins(rig), Ins(rig, GyroDrift(np.inf, np.inf))
    start = first_belief(task, walking)
    S = np.zeros((CORE + 3, CORE + 3))
    S[:CORE, :CORE] = start.S
    S[DRIFT, DRIFT], S[BG, BG] = S[BG, BG], 0.0  # the constant part is known, the other has its uncertainty
    y = np.concatenate([start.x.y, np.zeros(3)])
    beliefs = [
        filtered(task, walking, start),
        filtered(task, drifting, Belief(start.t_ns, State(start.x.R, y, start.x.rot), S)),
    ]

    one, other = beliefs
    same = np.r_[0:9, DRIFT.start : DRIFT.stop, 12:15]
    sigma = np.sqrt(np.diag(one.P))
    np.testing.assert_allclose(other.x.R, one.x.R, atol=1e-9)
    np.testing.assert_allclose(other.x.y[same] / sigma, one.x.y / sigma, atol=1e-9)
    np.testing.assert_allclose(
        other.P[np.ix_(same, same)] / np.outer(sigma, sigma), one.P / np.outer(sigma, sigma), atol=1e-9
    )
    assert np.all(other.x.y[BG] == 0.0)


def filtered(task, ins: Ins, start: Belief) -> Belief:
    """The last belief of an extended filter over the whole dive."""
    measured = sorted(observations(task.prepared, task.track), key=lambda o: o.t_ns)
    measured = [o for o in measured if start.t_ns < o.t_ns <= task.t_ns[-1]]
    stamps = np.array([o.t_ns for o in measured])
    grid = np.unique(np.concatenate([[start.t_ns], stamps]))
    by_epoch: dict[int, list[Observed]] = {}
    for epoch, observed in zip(np.searchsorted(grid, stamps).tolist(), measured, strict=True):
        by_epoch.setdefault(epoch, []).append(observed)
    epochs = Epochs.of(task.prepared, task.track, grid, 1)
    beliefs, _ = Runner(Extended(ins), Policy(0.9999), epochs, by_epoch, {}, {}).run(
        Filtering(start), np.array([len(grid) - 1]), lambda share: None
    )
    return beliefs[-1]


@pytest.mark.parametrize("tau", [30.0, 300.0])
def test_nees_of_a_simulated_markov_drift(tau: float):
    rng = np.random.default_rng(int(tau))
    rig = ImuRig(gyro_noise_density=1e-5, accel_noise_density=1e-3, gyro_bias_walk=2e-5, accel_bias_walk=1e-6)
    ins = Ins(rig, GyroDrift(tau, 3600.0))
    runs = np.array([normalised_errors(ins, rng) for _ in range(RUNS)])
    drift, both = runs.T
    # runs of 6 and of 3 degrees of freedom: 4 sigma of the mean
    assert both.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 6.0 / RUNS))
    assert drift.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 3.0 / RUNS))


def normalised_errors(ins: Ins, rng: np.random.Generator, seconds: int = 120) -> tuple[float, float]:
    """NEES over the degrees of freedom of the Markov drift, and of constant and drift together, of one run at rest."""
    assert ins.drift is not None
    tau, sigma_constant, sigma_attitude = ins.drift.gyro_tau_s, 1e-4, 1e-4
    stationary = ins.noise.gyro_bias_walk * np.sqrt(tau / 2.0)
    constant, drift = sigma_constant * rng.normal(size=3), stationary * rng.normal(size=3)
    sigmas = np.repeat([sigma_attitude, 1e-2, 1e-2, sigma_constant, 1e-6, stationary], 3)
    earth = np.concatenate([GRAVITY, earth_rate_n(Origin(0.7, 0.0))])
    kalman, truth = Unscented(ins), Rotation.from_euler("ZYX", [1.0, 0.1, -0.2])
    R_start = truth * Rotation.from_rotvec(sigma_attitude * rng.normal(size=3))
    belief = Belief(0, ins.state(R_start.as_matrix(), np.zeros(3), np.zeros(3)), start_root([np.diag(sigmas)]))
    decay = np.exp(-1.0 / tau)
    for second in range(seconds):
        white = ins.noise.gyro_noise_density * rng.normal(size=3)
        w_b = truth.inv().apply(earth[3:]) + constant + drift + white
        step = np.concatenate([[1.0], truth.inv().apply(-GRAVITY), w_b])
        belief = kalman.predict(belief, second, step[None], earth)
        drift = decay * drift + stationary * np.sqrt(1.0 - decay**2) * rng.normal(size=3)
        if second % 4 == 0:
            seen = truth * Rotation.from_rotvec(sigma_attitude * rng.normal(size=3))
            belief = attitude_used(belief, seen, sigma_attitude, kalman)
    off = np.concatenate([constant, drift]) - belief.x.y[np.r_[BG, DRIFT]]
    cov = belief.P[np.ix_(np.r_[BG, DRIFT], np.r_[BG, DRIFT])]
    return float(off[3:] @ np.linalg.solve(cov[3:, 3:], off[3:])) / 3, float(off @ np.linalg.solve(cov, off)) / 6


def attitude_used(belief: Belief, seen: Rotation, sigma: float, kalman: Unscented) -> Belief:
    def residual(x: State) -> FloatArray:
        return np.asarray((seen.inv() * Rotation.from_matrix(x.R[:, 0])).as_rotvec()) / sigma

    told = unscented.see(belief, residual, kalman.weights(belief.x.size))
    return unscented.moved_by(belief, told, told.with_noise(np.eye(3)))
