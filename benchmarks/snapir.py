"""Real dives: each recording imported and smoothed once, and judged by its reference.

    python benchmarks/snapir.py DATA [--runs 1 2 ...] [--limits 2.5 2.8 ...] [--json] [--save]

DATA holds folders TrajectoryN in the Snapir layout (IMU, DVL, GT). The initial state is the reference's first; no
heading aid. The peer is the reference, an INS that used the same sensors, and the limits are what a plain prototype on
GTSAM's CombinedImuFactor reached. The clocks are put right by the import: what it found is in the table.

Besides position and heading there is the dead-reckoned way: the part of the position error that comes from the DVL's
scale and mounting cannot be told from the reference's own corrections.
"""

from __future__ import annotations

from pathlib import Path

from _bench import Figure, Row, finish, parser, runs_of

from uwgraph.dive.importing import read_recording
from uwgraph.evaluate import judge
from uwgraph.graph import SmoothSettings, smooth

START = SmoothSettings(initial="reference")


def run(folder: Path) -> Row:
    dive = read_recording(folder).dive
    solution = smooth(dive, START)
    m = judge(dive, solution).metrics
    rig = dive.rig
    return {
        "run": folder.name,
        "distance_m": m["distance_m"],
        "horizontal_rmse_m": m["horizontal_rmse_m"],
        "final_error_m": m["final_error_m"],
        "final_error_percent": m["final_error_percent"],
        "heading_rmse_deg": m["heading_rmse_deg"],
        "depth_rmse_m": m["depth_rmse_m"],
        "nees_position": m["nees_position"],
        "matched": m["matched"],
        "dvl_offset_s": rig.dvl.time_offset_s,
        "reference_offset_s": rig.reference.time_offset_s,
        "dvl_yaw_deg": rig.dvl.rotation_deg[2] + solution.calibration.get("dvl_misalignment_z_deg_estimate", 0.0),
        "runtime_s": m["runtime_s"],
    }


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--runs", type=int, nargs="+")
    options.add_argument("--limits", type=float, nargs="+", help="horizontal RMSE, one for each run [m]")
    options.add_argument("--heading-limit", type=float, help="heading RMSE of every run [deg]")
    args = options.parse_args()
    rows = [run(folder) for folder in runs_of(args.data, args.runs)]
    figures = []
    if args.limits:
        if len(args.limits) != len(rows):
            options.error(f"{len(args.limits)} limits for {len(rows)} runs")
        figures += [
            Figure(f"{row['run']}: horizontal RMSE [m]", row["horizontal_rmse_m"], limit)
            for row, limit in zip(rows, args.limits, strict=True)
        ]
    if args.heading_limit:
        figures += [
            Figure(f"{row['run']}: heading RMSE [deg]", row["heading_rmse_deg"], args.heading_limit) for row in rows
        ]
    finish(args, "snapir", {"runs": rows}, figures)


if __name__ == "__main__":
    main()
