"""Visual odometry: a real pool (SUBVO) and simulated floors, against their references.

The pool's camera is calibrated from the pool's own tiles (``_pool``), and its height over the floor, the same all the
way to 2 %, stands in for an altimeter. Lengths are then in tiles; one scale, metres a tile, is fitted with origin and
heading. The reference moves by equal steps from image to image, also where seconds of the recording are missing (the
stamps tell), so errors of single steps mean nothing there. Nothing is fitted to the simulated dives.

    benchmarks/visual_odometry.py [--pool FOLDER] [--floor DIVE ...] [--save]

Floors are made by ``uwgraph simulate DIVE --pattern patrol --floor PHOTOS`` (``--stereo``).
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from _bench import RESULTS, Figure, Row, finish, parser
from _pool import calibrated
from scipy.spatial.transform import Rotation

from uwgraph.camera.eyes import choose_eyes
from uwgraph.camera.images import read_image
from uwgraph.dive.folder import read_dive
from uwgraph.evaluate.reference import reference_at
from uwgraph.frames import R_n_local, geodetic_from_ned, matrix_from_rph
from uwgraph.places.aids import Known, Sounding
from uwgraph.places.enhance import enhance, scene_mask
from uwgraph.places.known import known_of
from uwgraph.places.odometry import OdometrySettings, visual_odometry
from uwgraph.types import FloatArray, RelativePoses

POOL = Path(__file__).parents[2] / "shared" / "data" / "subvo"
DOWN = np.array([0.0, 0.0, 1.0])
SLOPE = np.radians(3.0)
"""The floor of a pool is level."""
UNSCALED = 1e3
"""m^2; a larger variance means that the length of a step was not measured."""


@dataclass
class Way:
    """Estimated and true positions at visual keyframes, horizontal, as complex numbers."""

    estimated: FloatArray
    true: FloatArray

    def aligned(self) -> tuple[FloatArray, float]:
        """The estimate after one scale, one heading and the origin (least squares), and the scale."""
        z, w = self.estimated - self.estimated.mean(), self.true - self.true.mean()
        a = np.vdot(z, w) / np.vdot(z, z)
        return a * z + self.true.mean(), float(abs(a))

    def row(self) -> Row:
        aligned, scale = self.aligned()
        distance = float(np.abs(np.diff(self.true)).sum())
        off = np.abs(aligned - self.true)
        from_start = self.estimated - self.estimated[0]
        first = max(2, len(from_start) // 4)  # heading of the first quarter, as nobody knows it, and the fitted scale
        turn = np.vdot(from_start[1:first], (self.true - self.true[0])[1:first])
        drift = abs(scale * turn / abs(turn) * from_start[-1] - (self.true[-1] - self.true[0]))
        return {
            "distance [m]": distance,
            "scale": scale,
            "RMSE [m]": float(np.sqrt(np.mean(off**2))),
            "RMSE [%]": 100.0 * float(np.sqrt(np.mean(off**2))) / distance,
            "worst [m]": float(off.max()),
            "end [%]": 100.0 * float(drift) / distance,
        }


def chained(poses: RelativePoses) -> FloatArray:
    """Positions of the ends in the axes of the first keyframe, shape (N + 1, 3).

    Refused steps are taken as they were found; those without a scale go on as fast as the step before.
    """
    R, p, speed = Rotation.identity(), [np.zeros(3)], 0.0
    seconds = (poses.t_ns - poses.from_ns) * 1e-9
    for step, turn, cov, s in zip(poses.p, poses.rotvec, poses.cov, seconds, strict=True):
        length = float(np.linalg.norm(step))
        if np.linalg.eigvalsh(cov)[-1] > UNSCALED and length > 0.0:
            step = step * (speed * s / length)
        else:
            speed = length / s
        p.append(p[-1] + R.apply(step))
        R = R * Rotation.from_rotvec(turn)
    return np.array(p)


def of_pool(folder: Path) -> tuple[Row, Row, dict[str, int], Way]:
    """Calibration, error, what became of the pairs, and the way."""
    files = sorted((folder / "images").glob("*.jpg"))
    stamps = [re.fullmatch(r".*_(\d+)_(\d+)_([\d.]+)", f.stem) for f in files]
    t_ns = [round((3600 * int(m[1]) + 60 * int(m[2]) + float(m[3])) * 1e9) for m in stamps if m]
    mask = scene_mask(enhance(read_image(f)) for f in files[::5])
    settings = OdometrySettings(longest_s=60.0)

    pool = calibrated(files)
    camera = pool.camera
    calibration = {
        "targets": pool.targets,
        "rms [px]": pool.rms_px,
        "f [px]": camera.f[0],
        "k1": camera.distortion[0],
        "k2": camera.distortion[1],
        "height [tiles]": pool.height,
        "sigma [tiles]": pool.height_sigma,
    }
    height = Sounding(pool.height, max(pool.height_sigma, 0.02 * pool.height), np.zeros(3), DOWN)
    known = Known(sounding=lambda t: height, down=lambda t: DOWN, slope_sigma=SLOPE)
    frames = ((t, read_image(f)) for t, f in zip(t_ns, files, strict=True))
    poses = visual_odometry(frames, camera, known=known, settings=settings, mask=mask)
    table = np.loadtxt(folder / "gt1.csv", delimiter=",", skiprows=1) * 0.01
    index = {t: k for k, t in enumerate(t_ns)}
    at = [index[t] for t in (poses.from_ns[0], *poses.t_ns)]
    p = chained(poses)
    way = Way(p[:, 0] + 1j * p[:, 1], -table[at, 1] + 1j * table[at, 0])  # Z points back, X to the right
    unscaled = int((np.linalg.eigvalsh(poses.cov)[:, -1] > UNSCALED).sum())
    row = {"pairs": len(poses), "accepted": int(poses.accepted.sum()), "no scale": unscaled, **way.row()}
    return calibration, row, counted(poses), way


def counted(poses: RelativePoses) -> dict[str, int]:
    reasons, counts = np.unique([re.sub(r"\d+", "N", r) for r in poses.reason.tolist()], return_counts=True)
    return {str(r): int(n) for r, n in zip(reasons, counts, strict=True)}


def of_floor(folder: Path, most: int) -> tuple[Row, Row]:
    """Errors of a simulated dive against its truth, without any alignment, and their consistency."""
    dive = read_dive(folder)
    eyes = choose_eyes(dive, folder)
    known = known_of(dive, eyes.t_ns)

    def frames() -> Iterator[tuple[int, FloatArray]]:
        for k, t in enumerate(eyes.t_ns[:most].tolist()):
            yield (t, *eyes.read(k))  # type: ignore[misc]

    began = time.process_time()
    poses = visual_odometry(frames(), eyes.cameras, known=known)
    seconds = (time.process_time() - began) / min(most, len(eyes))
    assert dive.reference is not None
    T = [
        reference_at(dive.reference, dive.origin, t + dive.rig.visual.time_offset_ns)
        for t in (poses.from_ns, poses.t_ns)
    ]
    R = [R_n_local(dive.origin, *geodetic_from_ned(dive.origin, at.p_n)[:2]) @ matrix_from_rph(at.rph) for at in T]
    true_p = np.einsum("kji,kj->ki", R[0], T[1].p_n - T[0].p_n)
    measured = Rotation.from_rotvec(poses.rotvec)
    turn = (measured.inv() * Rotation.from_matrix(np.swapaxes(R[0], 1, 2) @ R[1])).as_rotvec()
    error = np.c_[turn, measured.inv().apply(true_p - poses.p)]
    used = poses.accepted & (np.linalg.eigvalsh(poses.cov)[:, -1] < UNSCALED)
    nees = np.einsum("ki,kij,kj->k", error[used], np.linalg.inv(poses.cov[used]), error[used]) / 6.0
    distance = float(np.linalg.norm(true_p, axis=1).sum())
    way = chained(poses) @ R[0][0].T + T[0].p_n[0]
    truth = np.vstack([T[0].p_n[:1], T[1].p_n])
    off = np.linalg.norm(way - truth, axis=1)
    name = f"floor, {'stereo' if eyes.second else 'echo sounder'}"
    row = {
        "on": name,
        "images": min(most, len(eyes)),
        "pairs": len(poses),
        "accepted": int(poses.accepted.sum()),
        "distance [m]": distance,
        "end [%]": 100.0 * off[-1] / distance,
        "RMSE [%]": 100.0 * float(np.sqrt(np.mean(off**2))) / distance,
        "step [mm]": 1e3 * float(np.sqrt(np.mean(error[used, 3:] ** 2))),
        "turn [deg]": float(np.degrees(np.sqrt(np.mean(error[used, :3] ** 2)))),
        "s/image": seconds,
    }
    return row, {"on": name, "NEES": float(nees.mean()), "median": float(np.median(nees)), "worst": float(nees.max()),
                 **counted(poses)}  # fmt: skip


def picture(ways: dict[str, Way], path: Path) -> None:
    """Estimated and true ways, from above."""
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(6.0, 6.0), layout="constrained")
    for name, way in ways.items():
        axis.plot(way.true.imag, way.true.real, "k.-", lw=0.8, label="reference")
        aligned, _ = way.aligned()
        axis.plot(aligned.imag, aligned.real, ".-", label=f"visual odometry, {name}")
    axis.set(xlabel="right [m]", ylabel="forward [m]", aspect="equal")
    axis.legend()
    figure.savefig(path, dpi=120)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--pool", type=Path, default=POOL, help="the SUBVO recording")
    options.add_argument("--floor", type=Path, nargs="*", default=[], help="simulated dives with images of the floor")
    options.add_argument("--images", type=int, default=240, help="of each of them so many are used")
    args = options.parse_args()
    cv2.setNumThreads(1)
    calibration, pool, reasons, way = of_pool(args.pool)
    tables: dict[str, list[Row]] = {"camera of the pool, from its images": [calibration], "pool": [pool]}
    floors = [of_floor(folder, args.images) for folder in args.floor]
    if floors:
        tables |= {"simulated floors": [row for row, _ in floors], "consistency": [nees for _, nees in floors]}
    figures = [Figure(f"{row['on']}: NEES / 6", row["NEES"], 1.5) for _, row in floors]
    finish(args, "visual_odometry", tables, figures, {"pool pairs": reasons})
    if args.save:
        picture({"pool": way}, RESULTS / "visual_odometry.png")


if __name__ == "__main__":
    main()
