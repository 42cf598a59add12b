"""What the sun is worth: MEMS-grade dives with and without a heading from the sun.

    python benchmarks/sun_value.py DATA [--runs 1 2 ...] [--seeds 20] [--json] [--save]
    python benchmarks/sun_value.py --simulated [--seeds 20] [--json] [--save]

On real motion: the recordings of DATA (Snapir layout), their IMU degraded to MEMS grade (gyro bias 20 deg/h, angle
random walk 0.3 deg/sqrt(h)), without and with a simulated sun heading of 0.5 deg (1 sigma, 1 Hz). The peer is the same
recording with its own FOG-grade IMU and no heading aid. Simulated: 30-minute dives with a MEMS IMU, with and without
the simulator's sun directions. Both sides start from the reference's first state.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from _bench import Figure, Row, finish, in_processes, parser, runs_of  # isort: skip
import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.importing import read_recording
from uwgraph.evaluate import judge
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import SimulationSettings, add_sun_heading, degrade_imu, simulate

START = SmoothSettings(initial="reference", covariances=False)
SIGMA_DEG, RATE_HZ = 0.5, 1.0
SIMULATED_S = 1800.0
PATTERNS: tuple[Literal["lawnmower", "transit"], ...] = ("lawnmower", "transit")


def errors(dive: Dive) -> tuple[float, float]:
    """Heading RMSE [deg] and horizontal RMSE [m]."""
    m = judge(dive, smooth(dive, START)).metrics
    return m["heading_rmse_deg"], m["horizontal_rmse_m"]


def real(folder: Path, seeds: int) -> Row:
    """One recording, all seeds."""
    recorded = read_recording(folder).dive
    heading_fog, position_fog = errors(recorded)
    without, with_sun = [], []
    for seed in range(seeds):
        mems = degrade_imu(recorded, "mems", seed)
        without.append(errors(mems))
        with_sun.append(errors(add_sun_heading(mems, SIGMA_DEG, RATE_HZ, seed)))
    (heading_0, position_0), (heading_1, position_1) = np.array(without).T, np.array(with_sun).T
    return {
        "run": folder.name,
        "heading_fog_deg": heading_fog,
        "heading_without_deg": float(np.median(heading_0)),
        "heading_with_deg": float(np.median(heading_1)),
        "heading_with_max_deg": float(heading_1.max()),
        "heading_ratio": float(np.median(heading_0 / heading_1)),
        "position_fog_m": position_fog,
        "position_without_m": float(np.median(position_0)),
        "position_with_m": float(np.median(position_1)),
        "position_over_fog": float(np.median(position_1) / position_fog),
        "position_over_fog_max": float(position_1.max() / position_fog),
        "heading_ratios": (heading_0 / heading_1).tolist(),
        "positions_over_fog": (position_1 / position_fog).tolist(),
    }


def simulated(pattern: Literal["lawnmower", "transit"], seed: int) -> tuple[float, float, float, float]:
    """Heading and position RMSE without and with the sun, of one simulated dive."""
    dive = simulate(SimulationSettings(pattern=pattern, duration_s=SIMULATED_S, grade="mems"), seed)
    return (*errors(replace(dive, sun=None)), *errors(dive))


def on_recordings(folders: list[Path], seeds: int) -> tuple[list[Row], list[Figure], Row]:
    rows = in_processes(real, [(folder, seeds) for folder in folders])
    per_seed = {row["run"]: {key: row[key] for key in ("heading_ratios", "positions_over_fog")} for row in rows}
    ratios = np.concatenate([row["heading_ratios"] for row in rows])
    over_fog = np.concatenate([row["positions_over_fog"] for row in rows])
    figures = [
        Figure("heading RMSE with the sun, worst run's median [deg]", max(r["heading_with_deg"] for r in rows), 0.1),
        Figure(
            "heading RMSE with the sun, worst run and seed [deg]", max(r["heading_with_max_deg"] for r in rows), 0.1
        ),
        Figure("heading: without over with, median", float(np.median(ratios)), 5.0, at_least=True),
        Figure("position with the sun over FOG grade, median", float(np.median(over_fog)), 1.15),
        Figure(
            "position with the sun over FOG grade, worst run's median", max(r["position_over_fog"] for r in rows), 1.5
        ),
        Figure("position with the sun over FOG grade, worst run and seed", float(over_fog.max()), 1.5),
    ]
    table = [{k: v for k, v in row.items() if k not in per_seed[row["run"]]} for row in rows]
    return table, figures, {"per_seed": per_seed}


def on_simulations(seeds: int) -> tuple[list[Row], list[Figure], Row]:
    tasks = [(pattern, seed) for pattern in PATTERNS for seed in range(seeds)]
    found = np.array(in_processes(simulated, tasks)).reshape(len(PATTERNS), seeds, 4)
    rows: list[Row] = []
    figures: list[Figure] = []
    for pattern, each in zip(PATTERNS, found, strict=True):
        heading_0, position_0, heading_1, position_1 = each.T
        ratio = position_0 / position_1
        rows.append(
            {
                "pattern": pattern,
                "heading_without_deg": float(np.median(heading_0)),
                "heading_with_deg": float(np.median(heading_1)),
                "position_without_m": float(np.median(position_0)),
                "position_with_m": float(np.median(position_1)),
                "position_ratio": float(np.median(ratio)),
                "position_ratio_least": float(ratio.min()),
                "position_ratio_most": float(ratio.max()),
            }
        )
        figures.append(Figure(f"{pattern}: position without over with, median", rows[-1]["position_ratio"], 3.0, True))
    return (
        rows,
        figures,
        {"position_ratios": dict(zip(PATTERNS, (found[..., 1] / found[..., 3]).tolist(), strict=True))},
    )


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path, nargs="?")
    options.add_argument("--runs", type=int, nargs="+")
    options.add_argument("--simulated", action="store_true")
    options.add_argument("--seeds", type=int, default=20)
    args = options.parse_args()
    if (args.data is None) != args.simulated:
        options.error("give either DATA or --simulated")
    if args.simulated:
        rows, figures, details = on_simulations(args.seeds)
        finish(args, "sun_value_simulated", {"dives": rows}, figures, details)
    else:
        rows, figures, details = on_recordings(runs_of(args.data, args.runs), args.seeds)
        finish(args, "sun_value", {"runs": rows}, figures, details)


if __name__ == "__main__":
    main()
