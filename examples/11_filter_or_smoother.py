"""Filters and the smoother on one simulated dive, judged by the same ruler.

    python examples/11_filter_or_smoother.py [seconds] [folder]

A vehicle with a cheap IMU sees the sun only late in the dive. A filter cannot go back; a smoother does. On the command
line: ``uwgraph compare DIVE -o OUT``, which leaves figures, pictures and ``report.html``.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from uwgraph.dive import Dive
from uwgraph.evaluate.contest import run_contest
from uwgraph.evaluate.contest_output import write_contest
from uwgraph.filters import EstimatorSettings, FilterSettings
from uwgraph.simulate import SimulationSettings, simulate

SETTINGS = EstimatorSettings(filter=FilterSettings(samples_per_step=4))


def late_sun(seconds: float) -> Dive:
    """A dive whose sun comes out when two thirds of it are over."""
    dive = simulate(SimulationSettings(duration_s=seconds, imu_rate_hz=50.0), seed=1)
    assert dive.sun is not None
    return replace(dive, sun=dive.sun.select(dive.sun.t_s > 2.0 * seconds / 3.0))


def main(seconds: float, folder: Path) -> None:
    contest = run_contest(late_sun(seconds), ["dr", "eskf", "ukf", "aukf", "smooth"], SETTINGS, title="late sun")
    print(f"{'':7} {'RMSE m':>8} {'last m':>8} {'heading deg':>12} {'NEES':>6}")
    for entry in contest.entries:
        m = entry.judged.metrics
        nees = "" if m["nees_position"] is None else f"{m['nees_position']:6.2f}"
        position = f"{m['horizontal_rmse_m']:8.2f} {m['final_error_m']:8.2f}"
        print(f"{entry.name:7} {position} {m['heading_rmse_deg']:12.3f} {nees}")
    write_contest(contest, folder / "compared", SETTINGS.model_dump(mode="json"))
    print(f"open {folder / 'compared' / 'report.html'} in a browser")


if __name__ == "__main__":
    duration = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    main(duration, Path(sys.argv[2]) if len(sys.argv) > 2 else Path(tempfile.mkdtemp()))
