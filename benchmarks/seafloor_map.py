"""The map of a simulated sea floor against its truth: a stereo patrol, and the same with one camera and altitudes.

The sensor's own noise is the RMSE of every keyframe's points by themselves at the true poses; errors are vertical, at
the points' own north and east. Each map is made along the solution without closures and then re-deformed by the one
with closures, of which three in ten are false (simulated closures; the images are used for the map alone).
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import _bench
import numpy as np
from _bench import Figure, Row

from uwgraph.camera.eyes import choose_eyes
from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.export import Track, track_of_reference, track_of_solution
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.seafloor import deform_map, make_map
from uwgraph.seafloor.folder import CLOUD, KEYFRAMES
from uwgraph.seafloor.links import closures_of_solution
from uwgraph.seafloor.patch import read_patch
from uwgraph.seafloor.poses import poses_at
from uwgraph.simulate import SimulationSettings, simulate
from uwgraph.simulate.closures import ClosureModel
from uwgraph.simulate.degrade import add_closures
from uwgraph.simulate.floor import add_floor_images, terrain_of
from uwgraph.simulate.floor_model import FloorModel
from uwgraph.simulate.floor_terrain import Terrain
from uwgraph.types import FloatArray

MISSION = SimulationSettings(
    pattern="patrol", duration_s=330.0, speed=0.6, depth=12.0, leg_length_m=20.0, line_spacing_m=8.0,
    turn_rate_deg_s=8.0, current=(0.02, -0.03), surface_time_s=20.0, sun=None,
)  # fmt: skip
CLOSURES = ClosureModel(sigma=0.05, sigma_deg=0.3, period_s=4.0, apart_s=40.0, false_share=0.3)
BASELINE_M = 0.15


def flown(folder: Path, baseline_m: float, photos: Path | None) -> Dive:
    """The patrol over a floor, as a dive folder."""
    made = folder / "made"
    dive = add_floor_images(
        simulate(MISSION, seed=3), made, photos=photos, seed=1,
        model=FloorModel(stereo_baseline_m=baseline_m, rate_hz=0.7),
    )  # fmt: skip
    write_dive(dive, folder / "dive", images_from=made)
    return read_dive(folder / "dive")


def own_noise(folder: Path, dive: Dive, truth: Track, terrain: Terrain) -> tuple[float, float]:
    """RMSE of every keyframe's points at the true poses, m, and the RMS of the errors over their 1-sigma."""
    files = sorted((folder / KEYFRAMES).iterdir())
    poses, _ = poses_at(dive, truth, np.array([int(file.stem) for file in files]))
    errors, ratios = [], []
    for k, file in enumerate(files):
        patch = read_patch(file)
        error = _errors(patch.points_n(poses.R_nb[k], poses.p_n[k])[patch.measured], terrain)
        errors.append(error)
        ratios.append(error / np.hypot(patch.sigma, patch.common)[patch.measured])
    return _rms(np.concatenate(errors)), _rms(np.concatenate(ratios))


def map_row(name: str, folder: Path, figures: dict[str, Any], terrain: Terrain, noise: float) -> Row:
    """The errors of a map's cloud."""
    import open3d

    east, north, up = np.asarray(open3d.io.read_point_cloud(str(folder / CLOUD)).points).T
    error = _errors(np.column_stack([north, east, -up]), terrain)
    return {
        "map": name,
        "points": figures["points"],
        "RMSE m": _rms(error),
        "times own noise": _rms(error) / noise,
        "95 % m": float(np.quantile(np.abs(error), 0.95)),
        "keyframes agree to m": figures["spread_m"],
    }


def maps(folder: Path, baseline_m: float, photos: Path | None) -> tuple[list[Row], Row]:
    """Rows of the maps of one patrol, and what one look is worth."""
    dive = flown(folder, baseline_m, photos)
    terrain, truth = terrain_of(dive), track_of_reference(dive)
    kind = "stereo" if baseline_m else "altitude"
    settings = SmoothSettings(initial="reference")
    alone = smooth(dive, settings)
    closed = smooth(add_closures(dive, CLOSURES, seed=2), settings)
    eyes = choose_eyes(dive, folder / "dive")
    seconds, before = _bench.timed(lambda: make_map(dive, eyes, track_of_solution(alone), folder / "before"))
    after = deform_map(
        dive, folder / "before", track_of_solution(closed), folder / "after", closures_ns=closures_of_solution(closed)
    )
    best = deform_map(dive, folder / "before", truth, folder / "truth")
    noise, ratio = own_noise(folder / "before", dive, truth, terrain)
    rows = [
        map_row(f"{kind}, {how}", folder / name, figures, terrain, noise)
        for how, name, figures in (
            ("without closures", "before", before),
            ("re-deformed by closures", "after", after),
            ("true poses", "truth", best),
        )
    ]
    look = {
        "ranges": kind,
        "own noise m": noise,
        "error over 1-sigma": ratio,
        "keyframes": before["keyframes"],
        "s a keyframe": seconds / before["keyframes"],
    }
    return rows, look


def _errors(points_n: FloatArray, terrain: Terrain) -> FloatArray:
    return np.asarray(points_n[:, 2] - terrain.down(points_n[:, :2]))


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def main() -> None:
    parser = _bench.parser(__doc__)
    parser.add_argument("--photos", type=Path, help="folder of photographs of a real floor; noise without it")
    parser.add_argument("--keep", type=Path, help="keep dives and maps in this folder, to look at")
    args = parser.parse_args()
    rows: list[Row] = []
    looks: list[Row] = []
    with tempfile.TemporaryDirectory() as scratch:
        place = args.keep or Path(scratch)
        for name, baseline in (("stereo", BASELINE_M), ("mono", 0.0)):
            made, look = maps(place / name, baseline, args.photos)
            rows += made
            looks.append(look)
    figures = [
        Figure(f"RMSE over the sensor's own noise: {row['map']}", row["times own noise"], 2.0)
        for row in rows
        if "re-deformed" in row["map"]
    ]
    _bench.finish(args, "seafloor_map", {"one look": looks, "maps": rows}, figures)


if __name__ == "__main__":
    main()
