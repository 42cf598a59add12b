"""Back at a place seen before: visual odometry, closures and the map of a simulated floor.

    python examples/10_places_and_map.py [folder]

A vehicle without DVL or satellites goes round the same rectangle over a simulated sea floor, with a cheap IMU, one
camera and an echo sounder. On the command line: ``uwgraph places match DIVE``, ``uwgraph smooth DIVE -o OUT``,
``uwgraph map DIVE --solution OUT -o MAP``.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from uwgraph.camera.model import DOWN_FORWARD, Camera
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.evaluate import judge
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import FloorModel, SimulationSettings, add_floor_images, simulate

CAMERA = Camera("pinhole", (260.0, 260.0), (159.5, 119.5), (320, 240), R_bs=DOWN_FORWARD)
PATROL = SimulationSettings(
    pattern="patrol", duration_s=130.0, speed=0.5, depth=3.0, leg_length_m=6.0, line_spacing_m=5.0,
    turn_rate_deg_s=12.0, current=(0.05, 0.02), surface_time_s=5.0, gnss=None, sun=None, dvl=None,
)  # fmt: skip


START = SmoothSettings(initial="reference")


def uwgraph(*arguments: object) -> None:
    subprocess.run([Path(sys.executable).with_name("uwgraph"), *map(str, arguments)], check=True)


def main(folder: Path) -> None:
    made = simulate(PATROL, seed=1)
    seen = add_floor_images(made, folder, camera=CAMERA, model=FloorModel(rate_hz=0.5, altitude=2.0), seed=1)
    write_dive(seen, folder / "dive", images_from=folder)
    uwgraph("places", "match", folder / "dive", "--along", "reference")
    dive = read_dive(folder / "dive")
    for name, one in (("without", replace(dive, odometry=None, closures=None)), ("with images", dive)):
        print(f"{name:12} horizontal RMSE {judge(one, smooth(one, START)).metrics['horizontal_rmse_m']:.2f} m")
    uwgraph("map", folder / "dive", "--along", "reference", "-o", folder / "map", "--voxel", "0.05")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(scratch))
