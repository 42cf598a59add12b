"""Filters on the real Snapir runs: what they agree on, and what they gain over dead reckoning."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from filter_dives import run

from uwgraph.dive.importing import read_recording
from uwgraph.filters import FilterSettings
from uwgraph.graph import SmoothSettings
from uwgraph.simulate import add_sun_heading

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
RUNS = (1, 2, 4, 6, 7, 9, 12)
REFERENCE = SmoothSettings(initial="reference")
COARSE = FilterSettings(samples_per_step=10)
pytestmark = pytest.mark.data


@pytest.mark.slow
def test_filters_of_all_runs_agree_and_do_not_fall_behind_dead_reckoning() -> None:
    """Heading and Doppler log alone are hard to beat on a FOG, and the reference itself is unsure by a metre or two.

    So a filter is held to dead reckoning over all runs, and in a single one to a quarter of a metre.
    """
    if not (DATA / "snapir").is_dir():
        pytest.skip(f"no {DATA / 'snapir'}: set UWGRAPH_DATA to the folder of the recordings")
    squares: dict[str, list[float]] = {"dr": [], "eskf": [], "ukf": []}
    for n in RUNS:
        dive = read_recording(DATA / "snapir" / f"Trajectory{n}").dive
        runs = {name: run(name, dive, COARSE, REFERENCE) for name in squares}
        for name, found in runs.items():
            squares[name].append(found["horizontal_rmse_m"] ** 2)
        apart = np.abs(runs["eskf"].solution.p_n - runs["ukf"].solution.p_n).max()
        assert apart < 0.01, (n, apart)
        for name in ("eskf", "ukf"):
            assert runs[name]["horizontal_rmse_m"] < runs["dr"]["horizontal_rmse_m"] + 0.25, n
            assert runs[name]["depth_rmse_m"] < runs["dr"]["depth_rmse_m"], n
            assert runs[name]["heading_rmse_deg"] < 0.05, n
            innovations = runs[name].innovations
            assert innovations is not None
            assert innovations.accepted.all(), n
    over_all = {name: np.sqrt(np.mean(of_runs)) for name, of_runs in squares.items()}
    assert over_all["eskf"] < 1.1 * over_all["dr"], over_all
    assert over_all["ukf"] < 1.1 * over_all["dr"], over_all


@pytest.mark.slow
def test_a_sun_finds_the_heading_that_nobody_told() -> None:
    """Run 2 begun 20 degrees off, with a simulated sun heading of half a degree once a second."""
    if not (DATA / "snapir").is_dir():
        pytest.skip(f"no {DATA / 'snapir'}: set UWGRAPH_DATA to the folder of the recordings")
    dive = add_sun_heading(read_recording(DATA / "snapir" / "Trajectory2").dive, sigma_deg=0.5)
    assert dive.reference is not None
    off = float(np.degrees(dive.reference.rph[0, 2])) + 20.0
    begun = SmoothSettings(heading_deg=off, heading_sigma_deg=20.0)
    found = run("ukf", dive, COARSE, begun)
    errors = np.degrees(np.sqrt(found.solution.cov_pose[-1, 2, 2]))
    assert errors < 0.2
    assert found["heading_rmse_deg"] < 2.0
