"""Many factors made at once are the factors made one by one."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from scipy.spatial.transform import Rotation

from factors import Displacements, SunScatter, sun_scatter_factors

RNG = np.random.default_rng(1)
N = 5


def random_values() -> gtsam.Values:
    values = gtsam.Values()
    for k, R in enumerate(Rotation.random(N + 1, random_state=2).as_matrix()):
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3(R), RNG.normal(size=3)))
    return values


def spread(dim: int) -> np.ndarray:
    A = RNG.normal(size=(N, dim, dim))
    return A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(dim)


def same(many: list[gtsam.NonlinearFactor], single: list[gtsam.NonlinearFactor]) -> None:
    values = random_values()
    for a, b in zip(many, single, strict=True):
        assert list(a.keys()) == list(b.keys())
        np.testing.assert_allclose(a.error(values), b.error(values), rtol=1e-12)
        A, B = (f.linearize(values).augmentedInformation() for f in (a, b))
        np.testing.assert_allclose(A, B, rtol=1e-10, atol=1e-10 * np.abs(B).max())


def test_sun_scatter() -> None:
    information = spread(3)
    s_n = RNG.normal(size=(N, 3))
    s_n /= np.linalg.norm(s_n, axis=1, keepdims=True)
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.5)
    many = sun_scatter_factors([X(k) for k in range(N)], information, s_n, huber)
    same(many, [SunScatter(information[k], s_n[k]).lowered((X(k),), huber) for k in range(N)])


def test_dvl_displacements() -> None:
    dR = Rotation.random(N, random_state=3).as_matrix()
    all_of = Displacements(RNG.normal(size=(N, 3)), dR, spread(3), np.ones(N, dtype=np.bool_))
    chosen = [0, 2, 4]
    keys = [(X(k), X(k + 1)) for k in chosen]
    many = all_of.lowered(keys, chosen)
    same(many, [all_of.measurement(k).lowered(pair) for k, pair in zip(chosen, keys, strict=True)])
