"""Another IMU in another medium: EuRoC through the same pipeline.

    python benchmarks/euroc.py DATA [--seed 0] [--json] [--save]

DATA holds one EuRoC sequence. Its 200 Hz MEMS IMU is the recorded one; body velocity (5 Hz) and depth (5 Hz) are
simulated from the sequence's reference, for it was flown in a room. The initial state is the reference's first. The
peer is the reference (motion capture and a batch estimate). Nothing aids the heading: its error is the gyro's drift.
"""

from __future__ import annotations

from pathlib import Path

from _bench import finish, parser

from uwgraph.dive.importing import read_recording
from uwgraph.evaluate import judge
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import add_depth, add_dvl

SHOWN = (
    "duration_s",
    "distance_m",
    "matched",
    "horizontal_rmse_m",
    "final_error_m",
    "depth_rmse_m",
    "heading_rmse_deg",
    "nees_position",
    "nees_heading",
    "runtime_s",
)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--seed", type=int, default=0)
    args = options.parse_args()
    recorded = read_recording(args.data).dive
    dive = add_depth(add_dvl(recorded, seed=args.seed), seed=args.seed)
    solution = smooth(dive, SmoothSettings(initial="reference"))
    m = judge(dive, solution).metrics
    finish(args, "euroc", {"runs": [{"run": args.data.name, **{name: m[name] for name in SHOWN}}]})


if __name__ == "__main__":
    main()
