"""Does calibration find the rig that a simulated dive was made with, and is its covariance true?

    python benchmarks/calibration.py [--seeds 20] [--json] [--save]

The DVL's scale (1 %), mounting (1 degree per axis) and clock (up to 0.3 s) are drawn anew for every seed, and its lever
arm is not told; calibration starts from a bare rig. The dive is a 40-minute lawn mower of short legs in a current of
0.46 m/s, with a DVL of 5 mm/s per ping at 5 Hz. Positions are those of an acoustic fix every 5 s (1 m per axis,
1-sigma), or of a satellite receiver before and after the dive; with a MEMS IMU and the sun's direction, or a FOG and no
heading sensor at all. The peer is the drawn truth. NEES of all eight numbers together, divided by 8 and averaged over
the seeds, is held against its 95 % chi-square interval; the errors are root mean squares over the seeds.

The straight run is the cruise of a transit in dead calm, cut out between its accelerations: what it cannot tell must be
refused, every time.
"""

from __future__ import annotations

from _bench import Figure, Row, finish, in_processes, parser  # isort: skip
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.calibrate import calibrate_dives
from uwgraph.dive import Dive
from uwgraph.dive.rig import DvlRig, FixesRig
from uwgraph.evaluate import nees_bounds
from uwgraph.frames import geodetic_from_ned, rph_from_matrix
from uwgraph.simulate import DvlModel, SimulationSettings, simulate, trajectory_of
from uwgraph.simulate.noise import Noise
from uwgraph.time import from_seconds
from uwgraph.types import Fixes, FloatArray

ACOUSTIC_SIGMA, ACOUSTIC_PERIOD_S = 1.0, 5.0
DVL_SIGMA = 0.005
LEVER = (0.4, 0.1, 0.15)
MISSION = SimulationSettings(duration_s=2400.0, leg_length_m=120.0, current=(0.35, -0.3), waves=1.5)
DIVES = {
    "acoustic fixes and sun": (MISSION, True),
    "acoustic fixes, FOG": (MISSION.model_copy(update={"sun": None, "grade": "fog"}), True),
    "satellite fixes before and after, sun": (MISSION.model_copy(update={"surface_at_end": True}), False),
}
NAMES = (
    "dvl.scale",
    *(f"dvl.rotation_deg.{a}" for a in ("roll", "pitch", "yaw")),
    *(f"dvl.translation_m.{a}" for a in "xyz"),
    "dvl.time_offset_s",
)
STRAIGHT = MISSION.model_copy(update={"pattern": "transit", "duration_s": 900.0, "waves": 0.0, "depth": 10.0})
NOT_SHOWN = ("dvl.rotation_deg.roll", *NAMES[4:])


def with_acoustic_fixes(dive: Dive, settings: SimulationSettings, seed: int) -> Dive:
    """The dive with fixes of a transponder at the body origin, under water too."""
    motion = trajectory_of(settings, seed)
    t = np.arange(0.0, motion.duration_s, ACOUSTIC_PERIOD_S)
    noise = Noise.of(seed, "acoustic").normal(ACOUSTIC_SIGMA, (len(t), 3))
    lat, lon, height = geodetic_from_ned(motion.origin, motion.position(t) + noise)
    cov = np.tile(ACOUSTIC_SIGMA**2 * np.eye(3), (len(t), 1, 1))
    fixes = Fixes(from_seconds(t, motion.start_ns), lat, lon, height, cov, np.full(len(t), "usbl"))
    return replace(dive, fixes=fixes, rig=dive.rig.model_copy(update={"fixes": FixesRig(sigma=ACOUSTIC_SIGMA)}))


def drawn_dive(settings: SimulationSettings, seed: int, acoustic: bool) -> tuple[Dive, FloatArray]:
    """A dive with a bare rig for its DVL, and the true numbers in the order of ``NAMES``."""
    late = float(Noise.of(seed, "dvl clock").rng.uniform(-0.3, 0.3))
    true = DvlRig(
        translation_m=LEVER, time_offset_s=late, sigma=DVL_SIGMA, scale_sigma=0.01, misalignment_sigma_deg=1.0
    )
    settings = settings.model_copy(update={"dvl": DvlModel(rig=true)})
    dive = simulate(settings, seed)
    drawn = dive.provenance["drawn"]
    rph = np.degrees(rph_from_matrix(Rotation.from_rotvec(drawn["dvl_misalignment"]).as_matrix()))
    dive = replace(dive, rig=dive.rig.model_copy(update={"dvl": DvlRig(sigma=DVL_SIGMA)}))
    if acoustic:
        dive = with_acoustic_fixes(dive, settings, seed)
    return dive, np.array([1.0 + drawn["dvl_scale"], *rph, *LEVER, late])


def recovered(name: str, seed: int) -> Row:
    """Errors and stated sigmas of one dive, and its NEES over 8."""
    settings, acoustic = DIVES[name]
    dive, truth = drawn_dive(settings, seed, acoustic)
    found = calibrate_dives([dive], "dvl")
    estimates = [found.estimate(n) for n in NAMES]
    error = np.array([e.after for e in estimates]) - truth
    order = [found.names.index(n) for n in NAMES]
    covariance = found.covariance[np.ix_(order, order)]
    return {
        "error": error.tolist(),
        "sigma": [e.sigma for e in estimates],
        "told": all(e.observable for e in estimates),
        "converged": found.converged,
        "nees": float(error @ np.linalg.solve(covariance, error)) / len(NAMES),
    }


def refused(seed: int) -> Row:
    """What a straight run is said not to tell."""
    dive, _ = drawn_dive(STRAIGHT, seed, acoustic=True)
    found = calibrate_dives([cut(dive, 300.0, 850.0)], "dvl")
    left = [e.name for e in found.estimates if not e.observable]
    return {
        "refused": left,
        "as_it_was": all(e.after == e.before for e in found.estimates if not e.observable),
        "all": set(NOT_SHOWN) <= set(left),
    }


def cut(dive: Dive, start_s: float, end_s: float) -> Dive:
    """The dive between two times from its start."""
    assert dive.imu is not None
    t0 = dive.imu.t_ns[0]
    parts = {
        name: stream.select((stream.t_ns >= t0 + start_s * 1e9) & (stream.t_ns < t0 + end_s * 1e9))
        for name, stream in dive.streams()
    }
    return replace(dive, **parts)  # type: ignore[arg-type]


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--seeds", type=int, default=20)
    args = options.parse_args()
    tasks = [(name, seed) for name in DIVES for seed in range(args.seeds)]
    found = in_processes(recovered, tasks)
    straight = in_processes(refused, [(seed,) for seed in range(max(args.seeds // 4, 1))])
    rows: list[Row] = []
    figures: list[Figure] = []
    low, high = nees_bounds(len(NAMES), args.seeds)
    for i, name in enumerate(DIVES):
        runs = found[i * args.seeds : (i + 1) * args.seeds]
        errors = np.array([run["error"] for run in runs])
        rms = dict(zip(NAMES, np.sqrt(np.mean(errors**2, axis=0)).tolist(), strict=True))
        sigma = np.median([run["sigma"] for run in runs], axis=0)
        nees = float(np.mean([run["nees"] for run in runs]))
        rows += [
            {"dive": name, "number": n, "rms_error": rms[n], "median_sigma": float(s)}
            for n, s in zip(NAMES, sigma, strict=True)
        ]
        figures += [
            Figure(f"{name}: scale [%]", 100.0 * rms["dvl.scale"], 0.05),
            *(Figure(f"{name}: {n.rpartition('.')[2]} mounting [deg]", rms[n], 0.05) for n in NAMES[1:4]),
            Figure(f"{name}: clock offset [ms]", 1e3 * rms["dvl.time_offset_s"], 5.0),
            Figure(f"{name}: NEES", nees, high),
            Figure(f"{name}: NEES", nees, low, at_least=True),
            Figure(f"{name}: converged", float(np.mean([r["converged"] for r in runs])), 1.0, at_least=True),
        ]
    share = float(np.mean([run["all"] and run["as_it_was"] for run in straight]))
    figures.append(Figure("straight run: refused and left as it was", share, 1.0, at_least=True))
    details = {"straight_run_refuses": sorted(set.union(*(set(run["refused"]) for run in straight)))}
    finish(args, "calibration", {"numbers": rows}, figures, details)


if __name__ == "__main__":
    main()
