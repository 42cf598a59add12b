"""Doppler pings that contradict their neighbours, and only those."""

from __future__ import annotations

import numpy as np
import pytest

from uwgraph.graph.pings import NEIGHBOURS, contradicted
from uwgraph.graph.prepare import prepare
from uwgraph.simulate import DvlModel, SimulationSettings, simulate
from uwgraph.types import FloatArray, TimeArray

SIGMA = 0.01


def line(pings: int, rate_hz: float = 5.0, seed: int = 0) -> tuple[TimeArray, FloatArray, FloatArray]:
    """Stamps, velocities along a line with white noise, and the stated sigma."""
    rng = np.random.default_rng(seed)
    t = np.arange(pings) / rate_hz
    u = np.outer(t, [0.3, -0.2, -9.8]) + SIGMA * rng.normal(size=(pings, 3))
    return (t * 1e9).astype(np.int64), u, np.full(pings, SIGMA)


def test_a_line_has_no_contradictions() -> None:
    t, u, sigma = line(5000)
    assert not contradicted(t, u, sigma).any()


@pytest.mark.parametrize("share", [0.02, 0.2, 0.35])
def test_wrong_pings_are_found_and_others_are_not(share: float) -> None:
    t, u, sigma = line(3000)
    rng = np.random.default_rng(1)
    wrong = rng.random(len(t)) < share
    u[wrong] += rng.choice([-1.0, 1.0], size=(wrong.sum(), 3)) * rng.uniform(0.5, 2.0, size=(wrong.sum(), 3))
    found = contradicted(t, u, sigma)
    assert found[wrong].mean() > 0.99
    assert found[~wrong].mean() < 0.01


def test_the_ends_of_a_dive_are_judged_too() -> None:
    t, u, sigma = line(100)
    u[[0, -1]] += 1.0
    assert np.flatnonzero(contradicted(t, u, sigma)).tolist() == [0, 99]


def test_noise_above_what_is_stated_is_no_contradiction() -> None:
    t, u, sigma = line(3000)
    assert contradicted(t, u, 0.02 * sigma).mean() < 1e-3


def test_few_pings_and_long_gaps_are_left_alone() -> None:
    t, u, sigma = line(NEIGHBOURS - 1)
    u[3] += 5.0
    assert not contradicted(t, u, sigma).any()
    t, u, sigma = line(60, rate_hz=0.2)
    u[30] += 5.0
    assert not contradicted(t, u, sigma).any()


@pytest.mark.parametrize("rate_hz", [1.0, 5.0])
def test_a_turning_vehicle_is_none_of_it(rate_hz: float) -> None:
    dvl = DvlModel(rate_hz=rate_hz)
    dive = simulate(SimulationSettings(duration_s=300.0, dvl=dvl, leg_length_m=20.0, line_spacing_m=8.0))
    assert prepare(dive).refused_pings <= 1
