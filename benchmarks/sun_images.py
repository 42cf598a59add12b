"""From rendered images to a heading, on real motion: sky images along recordings, processed and smoothed end to end.

    python benchmarks/sun_images.py DATA [--runs 1 2 ...] [--methods polarization gradient] [--json] [--save]

Each recording (Snapir layout) keeps its motion; its IMU is degraded to MEMS grade, its clock set to a time of day (it
has none), and the sky above it is rendered through waves at a fixed depth. The images become a sun stream, the stream
goes into the smoother. The peer is the same recording with its own FOG-grade IMU and no sun.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from _bench import Figure, Row, finish, in_processes, parser, runs_of  # isort: skip
import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.folder import write_dive
from uwgraph.dive.importing import read_recording
from uwgraph.evaluate import judge
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import ImageModel, Scene, add_sun_images, begin_at, degrade_imu
from uwgraph.sun.process import Processed, process_images

START = SmoothSettings(initial="reference", covariances=False)
BEGIN_NS = 1_654_675_200_000_000_000
"""2022-06-08T08:00:00Z: the day of the recordings, the sun at 65 degrees."""


def errors(dive: Dive) -> tuple[float, float]:
    """Heading RMSE [deg] and horizontal RMSE [m]."""
    m = judge(dive, smooth(dive, START)).metrics
    return m["heading_rmse_deg"], m["horizontal_rmse_m"]


def processed(dive: Dive, method: str, scene: Scene, options: dict[str, Any], seed: int) -> Processed:
    """The sun stream of images rendered along a dive."""
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        kind = "polarization" if method == "polarization" else "gradient"
        seen = add_sun_images(dive, folder, scene=scene, model=ImageModel(kind=kind, **options), seed=seed)
        write_dive(seen, folder / "dive", images_from=folder)
        return process_images(seen, folder / "dive", "sky", n=scene.n)


def one(folder: Path, method: str, scene: Scene, options: dict[str, Any], seed: int) -> Row:
    """One recording by one method."""
    recorded = begin_at(read_recording(folder).dive, BEGIN_NS)
    heading_fog, position_fog = errors(recorded)
    mems = degrade_imu(recorded, "mems", seed)
    heading_without, position_without = errors(mems)
    done = processed(mems, method, scene, options, seed)
    heading, position = errors(replace(mems, sun=done.sun))
    return {
        "run": folder.name,
        "method": method,
        "images": done.images,
        "used": done.used,
        "heading_fog_deg": heading_fog,
        "heading_without_deg": heading_without,
        "heading_with_deg": heading,
        "position_fog_m": position_fog,
        "position_without_m": position_without,
        "position_with_m": position,
        "position_over_fog": position / position_fog,
    }


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--runs", type=int, nargs="+")
    options.add_argument("--methods", nargs="+", default=["polarization", "gradient"])
    options.add_argument("--rate", type=float, default=0.1, help="images per second")
    options.add_argument("--depth", type=float, default=5.0, help="metres")
    options.add_argument("--wind", type=float, default=3.0, help="m/s")
    options.add_argument("--swell", type=float, default=0.3, help="significant height, metres")
    options.add_argument("--seed", type=int, default=0)
    args = options.parse_args()
    scene = Scene(wind=args.wind, swell_height=args.swell)
    model = {"rate_hz": args.rate, "depth": args.depth}
    folders = runs_of(args.data, args.runs)
    rows = in_processes(one, [(f, method, scene, model, args.seed) for method in args.methods for f in folders])
    figures = []
    for method in args.methods:
        of = [row for row in rows if row["method"] == method]
        worst, median = max(r["heading_with_deg"] for r in of), float(np.median([r["position_over_fog"] for r in of]))
        figures.append(Figure(f"{method}: heading RMSE, worst run [deg]", worst, 0.3))
        figures.append(Figure(f"{method}: position over FOG grade, median", median, 1.2))
    finish(args, "sun_images", {"runs": rows}, figures)


if __name__ == "__main__":
    main()
