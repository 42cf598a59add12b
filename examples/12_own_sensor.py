"""A sensor of your own: one class, and the smoother and every filter use it.

    python examples/12_own_sensor.py [seconds]

Acoustic ranges to two beacons on the sea floor, for a vehicle that sees no sun. The class states the residual and its
noise; Jacobians are numerical until you write them (``factors.check_jacobians`` checks yours), and a Python factor
stands in for a native one.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import gtsam
import numpy as np

import factors
from uwgraph.evaluate import judge
from uwgraph.filters import ESTIMATORS, EstimatorSettings, FilterSettings, task_of
from uwgraph.frames import ned_from_geodetic
from uwgraph.graph import Observed, SmoothSettings
from uwgraph.simulate import SimulationSettings, simulate

BEACONS_N = np.array([[60.0, 20.0, 40.0], [20.0, -70.0, 35.0]])
START = SmoothSettings(initial="reference")
SETTINGS = EstimatorSettings(filter=FilterSettings(samples_per_step=4))


@dataclass(frozen=True, eq=False)
class Range(factors.Measurement):
    """Distance from the body to a beacon at a known place."""

    variables = ("Pose3",)
    beacon_n: np.ndarray
    distance: float
    sigma: float = 0.3

    def residual(self, pose: gtsam.Pose3) -> np.ndarray:
        return np.array([np.linalg.norm(pose.translation() - self.beacon_n) - self.distance])

    def noise(self) -> gtsam.noiseModel.Gaussian:
        return gtsam.noiseModel.Isotropic.Sigma(1, self.sigma)


if __name__ == "__main__":
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 400.0
    dive = simulate(SimulationSettings(duration_s=seconds, imu_rate_hz=50.0, sun=None), seed=10)
    truth, rng = dive.reference.select(slice(300, None, 50)), np.random.default_rng(10)  # every 5 s
    ranges = []
    for k, p in enumerate(ned_from_geodetic(dive.origin, truth.lat, truth.lon, truth.height)):
        beacon = BEACONS_N[k % 2]
        distance = float(np.linalg.norm(p - beacon) + 0.3 * rng.normal())
        ranges.append(Observed(int(truth.t_ns[k]), "range", Range(beacon, distance)))
    for name in ("ukf", "aukf", "smooth"):
        for more in ((), ranges):
            estimate = ESTIMATORS[name].run(task_of(dive, START, more=more), SETTINGS, lambda *_: None)
            rmse = judge(dive, estimate.solution).metrics["horizontal_rmse_m"]
            print(f"{name:7} {'with' if more else 'without':8} ranges: horizontal RMSE {rmse:.2f} m")
