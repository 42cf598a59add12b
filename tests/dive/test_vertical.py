"""The vertical from the IMU, against the truth of simulated dives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uwgraph.dive import Dive
from uwgraph.dive.body_reference import body_reference
from uwgraph.dive.vertical import vertical
from uwgraph.errors import DataError
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate import SimulationSettings, simulate


def tilt_errors(dive: Dive) -> tuple[np.ndarray, np.ndarray]:
    reference = body_reference(dive)
    inside = (reference.t_ns >= dive.imu.t_ns[0]) & (reference.t_ns <= dive.imu.t_ns[-1])
    found = vertical(dive, reference.t_ns[inside])
    truth_b = -matrix_from_rph(reference.rph[inside])[:, 2]
    return np.linalg.norm(np.cross(found.up_b, truth_b), axis=1), found.sigma


@pytest.mark.parametrize(("grade", "limit_deg"), [("fog", 0.02), ("mems", 0.4)])
def test_dvl_and_imu_know_the_vertical_all_along(grade, limit_deg):
    error, _ = tilt_errors(simulate(SimulationSettings(grade=grade, duration_s=600.0), seed=1))
    assert np.degrees(error.max()) < limit_deg


def test_sigma_is_honest_over_dives():
    ratios = [np.mean((e / s) ** 2) / 2 for e, s in _mems(range(5))]
    assert 0.3 < np.mean(ratios) < 1.5


def _mems(seeds):
    return [tilt_errors(simulate(SimulationSettings(grade="mems", duration_s=200.0), seed)) for seed in seeds]


def test_without_a_dvl_the_vehicle_s_own_accelerations_are_in_the_sigma():
    dive = replace(simulate(SimulationSettings(grade="fog", duration_s=600.0), seed=0), dvl=None)
    error, sigma = tilt_errors(dive)
    assert np.degrees(np.median(error)) < 0.3
    assert np.mean((error / sigma) ** 2) / 2 < 2.0


def test_images_outside_the_imu_are_refused():
    dive = simulate(SimulationSettings(duration_s=60.0), seed=0)
    with pytest.raises(DataError, match="outside the time of the IMU"):
        vertical(dive, dive.imu.t_ns[-1:] + 10_000_000_000)
