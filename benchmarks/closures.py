"""Closures that do not lie: a simulated hour of patrol with false places among the true ones.

    python benchmarks/closures.py [--seeds 20] [--false-share 0.3] [--json] [--save]

The dive: an hour around a rectangle of 200 by 100 m at 1.5 m/s, MEMS IMU, DVL and depth, no sun, no compass and no fix
after the start, where the vehicle is handed its pose; the heading is the gyro's, and drifts. Closures are derived from
the truth every 10 s (0.1 m and 0.5 deg, 1-sigma per axis); of these 30 % are then made false: half of them single ones
anywhere, half in groups of six that agree with each other (one stretch of the way taken for another, or a texture that
repeats, shifted by a constant of 1 to 30 m, log-uniform). The peer is the same dive without its closures.
"""

from __future__ import annotations

from _bench import Figure, Row, finish, in_processes, parser, timed  # isort: skip
from dataclasses import replace

import numpy as np

from uwgraph.evaluate import judge
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import ClosureModel, SimulationSettings, add_closures, simulate
from uwgraph.simulate.closures import TRUE

MISSION = SimulationSettings(pattern="patrol", duration_s=3600.0, leg_length_m=200.0, line_spacing_m=100.0, sun=None)
SETTINGS = SmoothSettings(initial="reference")


def hour(seed: int, false_share: float) -> Row:
    """One dive, smoothed without its closures and with them."""
    dive = add_closures(simulate(MISSION, seed), ClosureModel(false_share=false_share), seed)
    assert dive.closures is not None
    seconds_without, open_loops = timed(lambda: smooth(replace(dive, closures=None), SETTINGS))
    seconds_with, closed = timed(lambda: smooth(dive, SETTINGS))
    assert closed.closures is not None
    without, with_closures = judge(dive, open_loops).metrics, judge(dive, closed).metrics
    true, accepted = dive.closures.reason == TRUE, closed.closures.accepted
    false_chi2 = closed.closures.chi2[~true]
    return {
        "seed": seed,
        "closures": len(true),
        "false": int((~true).sum()),
        "false_accepted": int((accepted & ~true).sum()),
        "true_kept": float(accepted[true].mean()),
        "least_chi2_false": float(false_chi2.min()) if len(false_chi2) else np.nan,
        "rmse_without_m": without["horizontal_rmse_m"],
        "rmse_with_m": with_closures["horizontal_rmse_m"],
        "ratio": with_closures["horizontal_rmse_m"] / without["horizontal_rmse_m"],
        "nees_without": without["nees_position"],
        "nees_with": with_closures["nees_position"],
        "nees_heading": with_closures["nees_heading"],
        "seconds_without": seconds_without,
        "seconds_with": seconds_with,
    }


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--false-share", type=float, default=0.3)
    args = options.parse_args()
    rows = in_processes(hour, [(seed, args.false_share) for seed in range(args.seeds)])

    def all_of(name: str) -> list[float]:
        return [row[name] for row in rows]

    together = np.sqrt(np.mean(np.square(all_of("rmse_with_m"))) / np.mean(np.square(all_of("rmse_without_m"))))
    nees = float(np.mean(all_of("nees_with")))
    figures = [
        Figure("false closures accepted, all seeds", float(sum(all_of("false_accepted"))), 0.0),
        Figure("position RMSE with closures over without, all seeds together", float(together), 0.4),
        Figure("position RMSE with closures over without, worst seed", max(all_of("ratio")), 0.4),
        Figure("position NEES, mean of the seeds", nees, 2.0),
        Figure("position NEES, mean of the seeds", nees, 0.5, at_least=True),
        Figure("true closures kept, worst seed", min(all_of("true_kept")), 0.9, at_least=True),
    ]
    seconds = {f"median_{name}": float(np.median(all_of(name))) for name in ("seconds_without", "seconds_with")}
    kept = {"mean_true_kept": float(np.mean(all_of("true_kept")))}
    finish(args, "closures", {"dives": rows, "summary": [seconds | kept]}, figures)


if __name__ == "__main__":
    main()
