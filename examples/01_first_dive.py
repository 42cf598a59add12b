"""A simulated dive, smoothed: how far off is the vehicle, and does it know?

    python examples/01_first_dive.py [seconds]

Simulates a lawn mower with a MEMS IMU, a Doppler log, a depth sensor and a sun sensor; smooths it with the
sun, and without it from the true first pose; prints both against the truth.
"""

from __future__ import annotations

import sys
from dataclasses import replace

from uwgraph.evaluate import judge, nees_bounds
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import SimulationSettings, simulate

SHOWN = ("horizontal_rmse_m", "final_error_percent", "heading_rmse_deg", "nees_position", "nees_heading")


def main(duration_s: float) -> None:
    dive = simulate(SimulationSettings(duration_s=duration_s, grade="mems"), seed=1)
    runs = {
        "with the sun": smooth(dive),
        "without": smooth(replace(dive, sun=None), SmoothSettings(initial="reference")),
    }
    judged = {name: judge(dive, solution).metrics for name, solution in runs.items()}
    print(f"{'':24}" + "".join(f"{name:>16}" for name in judged))
    for figure in SHOWN:
        print(f"{figure:24}" + "".join(f"{m[figure]:16.3f}" for m in judged.values()))
    low, high = nees_bounds(3)
    print(f"NEES is 1 on average; one run's nees_position lies in {low:.2f} to {high:.2f} 19 times in 20")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1200.0)
