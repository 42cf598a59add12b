"""A sun observation as a GTSAM factor: three ways to use it, from all that it knows to the heading alone.

    python examples/04_sun_heading_factor.py

One pose, roll and pitch known to half a degree from gravity, its heading not at all; the sun (simulated) is measured to
0.3 degrees across and 1 degree in height. A heading alone does not know that tilt moves the sun: it is too sure.
"""

from __future__ import annotations

import gtsam
import numpy as np

from factors import Direction, Heading, SunScatter
from uwgraph.frames import matrix_from_rph
from uwgraph.sun.observation import SunObservation

AZIMUTH, ELEVATION, HEADING = np.radians([120.0, 40.0, 215.0])
SIGMA_ACROSS, SIGMA_HEIGHT, SIGMA_TILT = np.radians([0.3, 1.0, 0.5])

s_n = np.array([np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH), -np.sin(ELEVATION)])
R_nb = matrix_from_rph(np.array([np.radians(2.0), np.radians(-3.0), HEADING]))


def measured(rng: np.random.Generator) -> SunObservation:
    """What a front end gives: a direction, and an information matrix of rank 2 that is zero along it."""
    up_b = -R_nb[2]
    across = np.cross(up_b, R_nb.T @ s_n) / np.cos(ELEVATION)
    E = np.stack([across, np.cross(R_nb.T @ s_n, across)], axis=1)
    s_b = R_nb.T @ s_n + E @ rng.normal(0.0, [SIGMA_ACROSS, SIGMA_HEIGHT])
    information = E @ np.diag([SIGMA_ACROSS**-2, SIGMA_HEIGHT**-2]) @ E.T
    return SunObservation(
        0, s_b / np.linalg.norm(s_b), information, np.linalg.pinv(information), "simulated", 1.0, up_b=up_b
    )


def main() -> None:
    sun = measured(np.random.default_rng(0))
    sigma_azimuth = SIGMA_ACROSS / np.cos(ELEVATION)
    ways = {
        "scatter (rank 2)": SunScatter(sun.information_b, s_n),
        "direction": Direction(sun.s_b, s_n, np.diag([SIGMA_HEIGHT**2, sigma_azimuth**2])),
        "heading alone": Heading(sun.heading(AZIMUTH), sigma_azimuth, np.radians(-3.0)),
    }
    level = gtsam.noiseModel.Diagonal.Sigmas([SIGMA_TILT, SIGMA_TILT, 1e3, 1.0, 1.0, 1.0])
    guess = matrix_from_rph(np.array([0.0, 0.0, HEADING + np.radians(20.0)]))
    for name, factor in ways.items():
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(gtsam.Rot3(R_nb), np.zeros(3)), level))
        graph.add(factor.lowered((0,)))
        values.insert(0, gtsam.Pose3(gtsam.Rot3(guess), np.zeros(3)))
        pose = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        sigma = np.sqrt(np.linalg.inv(graph.linearize(pose).hessian()[0])[2, 2])
        heading = np.degrees(pose.atPose3(0).rotation().yaw()) % 360.0
        print(f"{name:18} heading {heading:7.2f} +- {np.degrees(sigma):.2f} deg (true {np.degrees(HEADING):.2f})")


if __name__ == "__main__":
    main()
