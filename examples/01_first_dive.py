"""Simulated dives, smoothed: how far off is the vehicle, and does it know?

    python examples/01_first_dive.py [seconds]

Simulates lawn mowers with a MEMS IMU, a Doppler log, a depth sensor and a sun sensor; smooths each with and without
the sun, both from the true first pose; prints both against the truth. One dive is one draw of the sensors' errors, and
in some the dive without the sun is the luckier one: so there are several, and their mean.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from uwgraph.evaluate import judge, nees_bounds
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import SimulationSettings, simulate

SEEDS = range(5)
SHOWN = ("horizontal_rmse_m", "heading_rmse_deg", "nees_position", "nees_heading")


def main(duration_s: float) -> None:
    start = SmoothSettings(initial="reference")
    figures = []
    print(f"{'':>6}" + "".join(f"{name:>36}" for name in SHOWN))
    print(f"{'seed':>6}" + f"{'with the sun':>20}{'without':>16}" * len(SHOWN))
    for seed in SEEDS:
        dive = simulate(SimulationSettings(duration_s=duration_s, grade="mems"), seed)
        both = [judge(d, smooth(d, start)).metrics for d in (dive, replace(dive, sun=None))]
        figures.append([m[name] for name in SHOWN for m in both])
        print_row(str(seed), figures[-1])
    print_row("mean", np.mean(figures, axis=0).tolist())
    low, high = nees_bounds(3, runs=len(SEEDS))
    print(f"the mean nees_position of {len(SEEDS)} honest runs lies in {low:.2f} to {high:.2f} 19 times in 20")


def print_row(name: str, row: list[float]) -> None:
    print(f"{name:>6}" + "".join(f"{x:{20 - 4 * (i % 2)}.3f}" for i, x in enumerate(row)))


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1200.0)
