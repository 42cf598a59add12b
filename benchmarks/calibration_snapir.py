"""A DVL calibrated on some real runs and applied to others: bias and final error, before and after.

    python benchmarks/calibration_snapir.py DATA [--train 1 2 4 6] [--test 7 9 12] [--json] [--save]

DATA holds folders TrajectoryN in the Snapir layout (IMU, DVL, GT). Scale, mounting and lever arm of the DVL come from
the training runs, from a rig that knows nothing of it (``before``); the positions of the reference, thinned, are their
fixes. The point of the vehicle that the reference is of is the mean of what import found on these runs. A test run gets
that rig. The DVL's clock there comes from the run's own motion, without the reference.

The DVL is judged by the reference's body velocity, taken from its positions: its own velocities contradict these by up
to 20 m over a run (``contradiction_m``; the bias against them is in the table too). The final error is that of a
smoothed run which starts from the reference's first state.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
from _bench import Figure, Row, finish, in_processes, parser, runs_of
from scipy.interpolate import CubicSpline

from uwgraph.calibrate import Calibration, ReferenceUse, calibrate_dives
from uwgraph.dive import Dive
from uwgraph.dive.importing import read_recording
from uwgraph.dive.inertial_track import inertial_track
from uwgraph.dive.reference_point import depth_is_copied
from uwgraph.dive.rig import DvlRig, Rig, Vector3
from uwgraph.dive.rigfile import apply_rig
from uwgraph.dive.timing import with_mounting
from uwgraph.evaluate import judge
from uwgraph.frames import matrix_from_rph, ned_from_geodetic
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.types import FloatArray

START = SmoothSettings(initial="reference")
MAX_BIAS = 5e-3
MAX_FINAL_PERCENT = 0.35


def calibrated(folders: list[Path]) -> Calibration:
    """The vehicle's numbers from the training runs."""
    dives = [read_recording(folder).dive for folder in folders]
    rig = dives[0].rig.model_copy(update={"dvl": unknown_dvl(dives[0].rig)})
    return calibrate_dives(dives, "dvl", names=[f.name for f in folders], reference=ReferenceUse(), rig=rig)


def unknown_dvl(rig: Rig) -> DvlRig:
    """A DVL of which nothing but the noise is known."""
    return DvlRig(sigma=rig.dvl.sigma)


def reference_point(folders: list[Path]) -> Vector3:
    """Mean place of the reference on the vehicle, as import found it run by run."""
    x, y, z = np.mean([read_recording(folder).dive.rig.reference.translation_m for folder in folders], axis=0).tolist()
    return x, y, z


def run(folder: Path, rig: Rig, point: Vector3) -> Row:
    """One test run, as logged and with the calibrated rig; the reference's point and clock serve both."""
    dive = read_recording(folder).dive
    for sensor in ("reference", "depth") if depth_is_copied(dive) else ("reference",):
        dive = with_mounting(dive, sensor, translation_m=point)
    after = apply_rig(dive, dive.rig.model_copy(update={"dvl": rig.dvl}), keep_clocks=True)
    before = replace(dive, rig=dive.rig.model_copy(update={"dvl": unknown_dvl(rig)}))
    row: Row = {"run": folder.name, "dvl_offset_s": after.rig.dvl.time_offset_s}
    for name, one in (("before", before), ("after", after)):
        metrics = judge(one, smooth(one, START)).metrics
        by_position, by_velocity = bias(one)
        row |= {f"{name}_{axis}_mm_s": 1e3 * float(b) for axis, b in zip("xyz", by_position, strict=True)}
        row |= {f"{name}_final_percent": metrics["final_error_percent"]}
    row |= {f"after_{axis}_by_velocity_mm_s": 1e3 * float(b) for axis, b in zip("xyz", by_velocity, strict=True)}
    return row | {"contradiction_m": contradiction(dive)}


def bias(dive: Dive) -> tuple[FloatArray, FloatArray]:
    """Mean of DVL velocity minus that of the reference in body axes, at the reference's point, shape (3,) each, m/s.

    The reference's velocity is first that of its positions, then the one that it states.
    """
    assert dive.imu is not None
    assert dive.dvl is not None
    assert dive.reference is not None
    reference, rig = dive.reference, dive.rig
    track = inertial_track(dive.imu, rig.imu)
    t_dvl = (dive.dvl.t_ns - dive.imu.t_ns[0]) * 1e-9 + rig.dvl.time_offset_s
    t = (reference.t_ns - dive.imu.t_ns[0]) * 1e-9 + rig.reference.time_offset_s
    v_dvl = CubicSpline(t_dvl, rig.dvl.scale * dive.dvl.v_s @ rig.dvl.R_bs.T)
    p_n = ned_from_geodetic(dive.origin, reference.lat, reference.lon, reference.height)
    R_nb = matrix_from_rph(reference.rph)

    def in_body(v_n: FloatArray) -> FloatArray:
        return np.einsum("kji,kj->ki", R_nb, v_n)

    both = (t > t_dvl[0]) & (t < t_dvl[-1])
    at_point = v_dvl(t) + np.cross(track.rate(t), rig.reference.l_b - rig.dvl.l_b)
    by_position = at_point - in_body(CubicSpline(t, p_n)(t, 1))
    by_velocity = at_point - in_body(reference.v_n)
    return by_position[both].mean(axis=0), by_velocity[both].mean(axis=0)


def contradiction(dive: Dive) -> float:
    """How far the integral of the reference's velocity ends from its last position, m."""
    assert dive.reference is not None
    reference = dive.reference
    p_n = ned_from_geodetic(dive.origin, reference.lat, reference.lon, reference.height)
    way = CubicSpline(reference.t_s, reference.v_n).integrate(0.0, reference.t_s[-1])
    return float(np.linalg.norm(p_n[-1] - p_n[0] - way))


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--train", type=int, nargs="+", default=[1, 2, 4, 6], help="runs to calibrate from")
    options.add_argument("--test", type=int, nargs="+", default=[7, 9, 12], help="runs to judge")
    args = options.parse_args()
    training = runs_of(args.data, args.train)
    found, point = calibrated(training), reference_point(training)
    rows = in_processes(run, [(folder, found.rig, point) for folder in runs_of(args.data, args.test)])
    numbers = [
        {"number": e.name, "unit": e.unit, "before": e.before, "after": e.after, "sigma": e.sigma, "told": e.observable}
        | {"scatter": e.scatter}
        for e in found.estimates
    ]
    figures = [
        Figure(f"{row['run']}: largest bias of the DVL after [mm/s]", largest(row), 1e3 * MAX_BIAS) for row in rows
    ]
    final = median(row["after_final_percent"] for row in rows)
    figures.append(Figure("median final error after [% of the way]", final, MAX_FINAL_PERCENT))
    finish(args, "calibration_snapir", {"calibration": numbers, "runs": rows}, figures)


def largest(row: Row) -> float:
    return max(abs(row[f"after_{axis}_mm_s"]) for axis in "xyz")


if __name__ == "__main__":
    main()
