"""The kinematic filter as one of the estimators."""

from __future__ import annotations

import numpy as np
import pytest

from uwgraph.evaluate import judge
from uwgraph.filters import ESTIMATORS, EstimatorSettings, task_of
from uwgraph.simulate import DvlModel, SimulationSettings, simulate


def test_it_answers_at_the_times_asked_for_and_its_covariance_is_honest() -> None:
    mission = SimulationSettings(duration_s=240.0, imu_rate_hz=50.0, leg_length_m=40.0, line_spacing_m=20.0)
    found = []
    for seed in range(4):
        dive = simulate(mission, seed)
        task = task_of(dive)
        estimate = ESTIMATORS["kinematic"].run(task, EstimatorSettings(), lambda doing, share: None)
        assert np.array_equal(estimate.solution.t_ns, task.t_ns)
        assert estimate.innovations is not None
        assert {"depth", "fixes", "sun"} <= set(estimate.innovations.kind.tolist())
        m = judge(dive, estimate.solution).metrics
        assert m["horizontal_rmse_m"] < 3.0
        assert m["heading_rmse_deg"] < 1.0
        found.append([m["nees_position"], m["nees_heading"]])
    assert np.all(np.mean(found, axis=0) < 2.5)


@pytest.mark.parametrize("seconds", [10.0, 60.0])
def test_without_bottom_lock_it_knows_that_it_does_not_know(seconds: float) -> None:
    """The position grows unsure, and nothing else: depth, heading and sun go on."""
    found = []
    for seed in range(4):
        dvl = DvlModel(lost_s=((120.0, 120.0 + seconds),))
        mission = SimulationSettings(
            duration_s=240.0, imu_rate_hz=50.0, leg_length_m=40.0, line_spacing_m=20.0, depth=8.0, dvl=dvl
        )
        dive = simulate(mission, seed)
        task = task_of(dive)
        solution = ESTIMATORS["kinematic"].run(task, EstimatorSettings(), lambda doing, share: None).solution
        m = judge(dive, solution).metrics
        assert m["heading_rmse_deg"] < 1.0
        assert m["depth_rmse_m"] < 0.1
        sigma = np.sqrt(np.trace(solution.cov_pose[:, 3:, 3:], axis1=1, axis2=2))
        before, after = (sigma[np.searchsorted(task.t_ns, task.t_ns[0] + round(t * 1e9))] for t in (119, 119 + seconds))
        assert after > 1.5 * before
        found.append([m["nees_position"], m["nees_heading"]])
    assert np.all(np.mean(found, axis=0) < 2.5), found
