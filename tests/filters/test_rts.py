"""The backward pass: on a linear problem it is the least-squares solution of all epochs at once."""

from __future__ import annotations

import numpy as np
import pytest
from linear import System, belief_of, covariance, held_to, vector

from uwgraph.dive.rig import ImuRig
from uwgraph.filters import extended
from uwgraph.filters.ins import Ins, start_root
from uwgraph.filters.kalman import Extended
from uwgraph.filters.rts import Passage, Remembering, smoothed
from uwgraph.filters.state import Belief
from uwgraph.filters.unscented import moved_by
from uwgraph.types import FloatArray

EPOCHS, N, M = 8, 4, 2


def batch(x0: FloatArray, P0: FloatArray, system: System, z: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Means, shape (epochs, n), and covariances, shape (epochs, n, n): one dense problem over all epochs."""
    n, K = len(x0), len(z) + 1
    rows, right = [], []

    def add(blocks: dict[int, FloatArray], value: FloatArray, cov: FloatArray) -> None:
        W = np.linalg.inv(np.linalg.cholesky(cov))
        row = np.zeros((len(value), n * K))
        for k, block in blocks.items():
            row[:, n * k : n * (k + 1)] = block
        rows.append(W @ row)
        right.append(W @ value)

    add({0: np.eye(n)}, x0, P0)
    for k, measured in enumerate(z):
        add({k: -system.F, k + 1: np.eye(n)}, np.zeros(n), system.Q)
        add({k + 1: system.H}, measured, system.R)
    A, b = np.vstack(rows), np.concatenate(right)
    P = np.asarray(np.linalg.inv(A.T @ A))
    x = np.asarray(P @ A.T @ b)
    return x.reshape(K, n), np.array([P[n * k : n * (k + 1), n * k : n * (k + 1)] for k in range(K)])


@pytest.mark.parametrize("seed", range(10))
def test_a_linear_problem_gives_the_batch_solution(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = System.drawn(rng, N, M)
    x0, P0 = rng.normal(size=N), covariance(rng, N)
    z = list(rng.normal(size=(EPOCHS, M)))
    belief, passages = belief_of(x0, P0), []
    for k, measured in enumerate(z):
        after = extended.predict(belief, k, vector(system.F @ belief.x.y), system.F, system.noise_rows)
        passages.append(Passage(belief, after, system.F, system.noise_rows.T))
        seen = extended.see(after, system.H @ after.x.y - measured, system.H)
        belief = moved_by(after, seen, seen.with_noise(system.S_R))
    found, (x, P) = smoothed(passages, belief), batch(x0, P0, system, z)
    assert len(found) == EPOCHS + 1
    for k, b in enumerate(found):
        held_to(b, (x[k], P[k]), tolerance=1e-8)


def test_a_filter_that_remembers_is_the_same_filter() -> None:
    """Prediction in one go over many steps, calibration and all, as the plain filter does it step by step."""
    rng = np.random.default_rng(0)
    ins = Ins(ImuRig(), None, True)
    x = ins.state(np.eye(3), np.zeros(3), np.array([1.0, 0.0, 0.0]))
    root = start_root([s * np.eye(k) for s, k in ((0.1, 3), (1.0, 3), (0.2, 3), (1e-3, 3), (1e-2, 3), (5e-3, 4))])
    root[6:9, :6] = 0.05 * rng.normal(size=(3, 6))
    root[15:, :15] = 1e-3 * rng.normal(size=(4, 15))
    start = Belief(0, x, root)
    steps = np.hstack([np.full((25, 1), 0.02), [0.1, 0.0, -9.8, 0.0, 0.0, 0.1] + 0.1 * rng.normal(size=(25, 6))])
    earth = np.array([0.0, 0.0, 9.8, 5e-5, 0.0, -5e-5])
    remembering = Remembering(ins)
    a, b = Extended(ins).predict(start, 7, steps, earth), remembering.predict(start, 7, steps, earth)
    np.testing.assert_allclose(a.x.to(b.x), 0.0, atol=1e-12)
    np.testing.assert_allclose(b.P, a.P, rtol=1e-9, atol=1e-15)
    passage = remembering.passages[0]
    np.testing.assert_allclose(
        passage.F @ start.P @ passage.F.T + passage.S_Q @ passage.S_Q.T, passage.after.P, rtol=1e-9, atol=1e-15
    )
    back = smoothed(remembering.passages, b)[0]
    np.testing.assert_allclose(back.x.to(start.x), 0.0, atol=1e-12)
    np.testing.assert_allclose(back.P, start.P, rtol=1e-7, atol=1e-12)
