"""Information of several dives added, refused and held against each other, on linear problems."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.calibrate.combine import TOLD, Unknowns, added, combine, scatter
from uwgraph.calibrate.information import Information
from uwgraph.calibrate.parameters import Parameter
from uwgraph.types import FloatArray

SCALE = Parameter("dvl", "scale", None, prior=0.02, limit=0.005)
YAW = Parameter("dvl", "rotation_deg", 2, prior=5.0, limit=0.5)
CLOCK = Parameter("dvl", "time_offset_s", None, prior=0.5, limit=0.05)
THREE = (SCALE, YAW, CLOCK)


def measured(rng: np.random.Generator, truth: FloatArray, now: FloatArray, strength: float = 30.0) -> Information:
    """A dive that measured random combinations of its numbers (in prior sigmas), linearised at ``now``."""
    A = strength * rng.standard_normal((6, len(truth)))
    y = A @ truth + rng.standard_normal(6)
    return Information(A.T @ A, A.T @ (y - A @ now))


@given(st.integers(0, 10_000), st.integers(1, 4), st.booleans())
@settings(max_examples=50, deadline=None)
def test_where_it_was_linearised_does_not_matter(seed: int, dives: int, common_clock: bool) -> None:
    unknowns = Unknowns.of(THREE, dives, common_clock=common_clock)
    truth = np.random.default_rng(seed).standard_normal(len(unknowns))
    found = []
    for now in (np.zeros(len(unknowns)), np.linspace(-1.0, 1.0, len(unknowns))):
        rng = np.random.default_rng(seed + 1)
        information = [measured(rng, truth[place], now[place]) for place in unknowns.places]
        found.append(combine(unknowns, added(unknowns, information), now))
    np.testing.assert_allclose(found[0].z, found[1].z, atol=1e-6)
    np.testing.assert_allclose(found[0].covariance, found[1].covariance, atol=1e-9)
    assert len(unknowns) == (3 if common_clock else 2 + dives)


def test_every_prior_counts_once() -> None:
    unknowns = Unknowns.of((SCALE, YAW), 5, common_clock=False)
    nothing = [Information(1e3 * np.eye(2), np.zeros(2))] * 5
    found = combine(unknowns, added(unknowns, nothing), np.zeros(2))
    np.testing.assert_allclose(np.diag(found.covariance), 1.0 / (5e3 + 1.0))


def test_the_errors_are_those_that_the_covariance_says() -> None:
    """Truths drawn from the priors, one number not told: NEES of the others is one."""
    unknowns = Unknowns.of(THREE, 1, common_clock=True)
    rng = np.random.default_rng(5)
    squares = []
    for _ in range(400):
        truth = rng.standard_normal(3)
        A = np.array([[40.0, 0.0, 0.1], [0.0, 60.0, 0.8], [30.0, 20.0, 0.0]])  # the clock is hardly seen
        y = A @ truth + rng.standard_normal(3)
        found = combine(unknowns, Information(A.T @ A, A.T @ y), np.zeros(3))
        assert found.told.tolist() == [True, True, False]
        e = (found.z - truth)[:2]
        squares.append(e @ np.linalg.solve(found.covariance[:2, :2], e) / 2)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.15)


def test_what_is_known_too_loosely_is_not_told() -> None:
    """Well below its prior, but of no use: 5 degrees to 1, and a limit of 0.5."""
    unknowns = Unknowns.of((SCALE, YAW), 1, common_clock=True)
    found = combine(unknowns, Information(np.diag([1e4, 24.0]), np.array([100.0, 24.0])), np.zeros(2))
    assert found.told.tolist() == [True, False]
    assert TOLD > found.sigma[1] == pytest.approx(0.2)


@given(st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_a_dive_alone_is_the_dive_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    unknowns = Unknowns.of((SCALE, YAW), 2, common_clock=True)
    truth = rng.standard_normal(2)
    information = [measured(rng, truth, np.zeros(2)) for _ in range(2)]
    s = scatter(unknowns, information, np.zeros(2), 0)
    for d, value, sigma in zip(s.dives, s.values, s.sigmas, strict=True):
        M = information[d].matrix + np.diag([0.0, 1.0])  # its own prior taken off, the other's not
        P = np.linalg.inv(M)
        assert sigma == pytest.approx(np.sqrt(P[0, 0]), rel=1e-6)
        assert value == pytest.approx((P @ information[d].vector)[0], abs=1e-6)


def test_dives_that_agree_are_left_and_dives_that_scatter_widen() -> None:
    unknowns = Unknowns.of((SCALE,), 4, common_clock=True)
    rng = np.random.default_rng(0)

    def birge(extra: float) -> float:
        values = rng.standard_normal(4) * np.hypot(0.01, extra)
        information = [Information(np.array([[1e4]]), np.array([1e4 * v])) for v in values]
        return scatter(unknowns, information, np.zeros(1), 0).birge

    assert np.mean([birge(0.0) > 1.0 for _ in range(200)]) < 0.12
    assert np.median([birge(0.05) for _ in range(200)]) == pytest.approx(5.0, rel=0.3)
