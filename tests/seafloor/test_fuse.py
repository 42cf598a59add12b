"""Fusion: weights, layers, and sums that do not depend on the order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.errors import ConfigError
from uwgraph.seafloor import fuse
from uwgraph.seafloor.fuse import Cloud, Fusion

V = 0.1


def points(*rows: tuple[float, float, float]) -> np.ndarray:
    return np.array(rows, dtype=np.float64)


def fused(*keyframes: tuple[np.ndarray, float], common: float = 0.0) -> Cloud:
    """Keyframes of points with one 1-sigma each; the colour is the number of the keyframe."""
    fusion = Fusion(V)
    for k, (p, sigma) in enumerate(keyframes):
        fusion.add(p, np.full((len(p), 3), float(k)), np.full(len(p), sigma), common)
    return fusion.cloud()


def test_two_looks_are_weighted_by_inverse_variance() -> None:
    cloud = fused((points((0.05, 0.05, 10.0)), 0.01), (points((0.05, 0.05, 10.03)), 0.02))
    assert len(cloud) == 1
    np.testing.assert_allclose(cloud.points_n[0, 2], (10.0 * 4 + 10.03) / 5)
    np.testing.assert_allclose(cloud.sigma, (1 / 0.01**2 + 1 / 0.02**2) ** -0.5)
    assert cloud.keyframes.tolist() == [2]
    # weighted variance 0.03^2 * 4/25, unbiased for two
    np.testing.assert_allclose(cloud.spread, 0.03 * np.sqrt(4 / 25 * 2), rtol=1e-6)


def test_many_points_of_one_keyframe_are_one_look() -> None:
    p = np.column_stack([np.full(50, 0.05), np.full(50, 0.05), np.linspace(9.99, 10.01, 50)])
    cloud = fused((p, 0.02))
    np.testing.assert_allclose(cloud.sigma, 0.02)
    assert cloud.keyframes.tolist() == [1]
    assert np.isnan(cloud.spread).all()


def test_what_is_common_is_not_averaged() -> None:
    many = [(points((0.05, 0.05, 10.0)), 0.02)] * 100
    np.testing.assert_allclose(fused(*many, common=0.05).sigma, np.hypot(0.002, 0.05))


def test_a_gap_keeps_layers_apart_and_noise_does_not() -> None:
    floor, rail = points((0.05, 0.05, 10.0)), points((0.05, 0.05, 9.0))
    cloud = fused((floor, 0.02), (rail, 0.02), (points((0.05, 0.05, 10.1)), 0.02))
    assert len(cloud) == 2
    assert sorted(cloud.keyframes.tolist()) == [1, 2]
    rng = np.random.default_rng(0)
    noisy = [(points((0.05, 0.05, 10.0 + rng.normal(0.0, 0.05))), 0.05) for _ in range(200)]
    assert len(fused(*noisy)) == 1


def test_cells_are_those_of_the_axes_on_both_sides_of_the_origin() -> None:
    p = np.array([(n, e, 5.0) for n in (-0.15, -0.05, 0.05) for e in (-0.05, 0.05)])
    assert len(fused((p, 0.01))) == 6


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_order_and_buffer_do_not_matter(seed: int, rows: int) -> None:
    rng = np.random.default_rng(seed)
    looks = [(rng.uniform(-0.3, 0.3, (30, 3)) * [1, 1, 0.05] + [0, 0, 7.0], 0.03) for _ in range(6)]
    whole = fused(*looks)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fuse, "_BUFFER_ROWS", rows)
        parts = fused(*looks)
        fusion = Fusion(V)
        for p, sigma in looks[::-1]:
            fusion.add(p, np.zeros_like(p), np.full(len(p), sigma))
        back = fusion.cloud()
    for other in (parts, back):
        np.testing.assert_allclose(other.points_n, whole.points_n, atol=1e-9)
        np.testing.assert_allclose(other.sigma, whole.sigma)


def test_nothing_and_too_much() -> None:
    empty = Fusion(V)
    empty.add(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    assert len(empty.cloud()) == 0
    with pytest.raises(ConfigError, match="voxel_m"):
        Fusion(1e-9).add(points((10.0, 0.0, 0.0)), np.zeros((1, 3)), np.ones(1))
