"""The kinematic filter as one of the estimators."""

from __future__ import annotations

import numpy as np

from uwgraph.evaluate import judge
from uwgraph.filters import ESTIMATORS, EstimatorSettings, task_of
from uwgraph.simulate import SimulationSettings, simulate


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
