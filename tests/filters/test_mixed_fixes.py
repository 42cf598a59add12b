"""Fixes with a height and fixes without, of one receiver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uwgraph.filters import ESTIMATORS, EstimatorSettings, FilterSettings, task_of
from uwgraph.simulate import SimulationSettings, simulate


def test_fixes_with_and_without_height_go_together() -> None:
    dive = simulate(SimulationSettings(duration_s=90.0, imu_rate_hz=50.0))
    assert dive.fixes is not None
    height = dive.fixes.height.copy()
    height[::2] = np.nan
    mixed = replace(dive, fixes=replace(dive.fixes, height=height))
    settings = EstimatorSettings(filter=FilterSettings(samples_per_step=4))
    for name in ("ukf", "aukf"):
        told = ESTIMATORS[name].run(task_of(mixed), settings, lambda doing, share: None).innovations
        assert told is not None
        assert set(told.dof[told.kind == "fixes"].tolist()) == {2, 3}
