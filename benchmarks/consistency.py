"""Does the covariance tell the truth, and does the error vanish with the noise?

    python benchmarks/consistency.py [--seeds 20] [--only nees noise_free] [--json] [--save]

NEES of simulated dives, started from the dive's own sensors with default settings: position (3 degrees of freedom) and
heading (1), each divided by its degrees of freedom, averaged over the seeds at one epoch (the middle of the dive) and
over all epochs; held against the 95 % chi-square interval of as many independent draws as there are seeds. (The average
over the epochs of a dive scatters less than one epoch: the interval is wide for it.) Dives: the default 20-minute lawn
mower, and a 20 km straight transit over the ellipsoid.

Noise-free dives: what is left is the error of the discretisation. The peer is the analytic truth. Rates of the IMU and
of the other sensors are doubled one by one, to see whose sampling limits.
"""

from __future__ import annotations

from _bench import Figure, Row, finish, in_processes, parser  # isort: skip
import numpy as np

from uwgraph.dive.body_reference import body_reference
from uwgraph.evaluate import compare, judge, nees, nees_bounds
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import DepthModel, DvlModel, SimulationSettings, SunModel, simulate

MISSIONS = {
    "20 min lawn mower": SimulationSettings(),
    "20 km transit": SimulationSettings(pattern="transit", duration_s=8000.0, speed=2.5, imu_rate_hz=50.0),
}
REFERENCE = SmoothSettings(initial="reference")
# IMU [Hz], DVL [Hz], and keyframe period [s] of the noise-free dives
RATES = ((100.0, 5.0, 1.0), (200.0, 5.0, 1.0), (100.0, 10.0, 1.0), (200.0, 10.0, 1.0), (200.0, 10.0, 0.5))


def nees_of(mission: str, seed: int) -> Row:
    """NEES of one dive at its middle and on average, and its largest depth error."""
    dive = simulate(MISSIONS[mission], seed)
    judged = judge(dive, smooth(dive))
    reference = body_reference(dive)
    assert reference is not None
    c = compare(judged.solution, reference)
    position = nees(c.e_n, c.estimate.cov_p_n)
    heading = nees(c.e_rph[:, 2:], c.estimate.cov_rph[:, 2:, 2:])
    middle = len(position) // 2
    m = judged.metrics
    return {
        "position_middle": float(position[middle]),
        "heading_middle": float(heading[middle]),
        "position_mean": m["nees_position"],
        "heading_mean": m["nees_heading"],
        "depth_max_m": float(np.nanmax(np.abs(c.e_depth))),
        "depth_rmse_m": m["depth_rmse_m"],
        "horizontal_rmse_m": m["horizontal_rmse_m"],
        "heading_rmse_deg": m["heading_rmse_deg"],
        "distance_m": m["distance_m"],
        "runtime_s": m["runtime_s"],
    }


def consistency(seeds: int) -> tuple[list[Row], list[Figure]]:
    tasks = [(mission, seed) for mission in MISSIONS for seed in range(seeds)]
    found = in_processes(nees_of, tasks)
    rows: list[Row] = []
    figures: list[Figure] = []
    for i, mission in enumerate(MISSIONS):
        runs = found[i * seeds : (i + 1) * seeds]

        def mean(key: str, runs: list[Row] = runs) -> float:
            return float(np.mean([run[key] for run in runs]))

        rows.append(
            {
                "dive": mission,
                **{key: mean(key) for key in runs[0] if key != "depth_max_m"},
                "depth_max_m": max(run["depth_max_m"] for run in runs),
            }
        )
        for what, dof in (("position", 3), ("heading", 1)):
            low, high = nees_bounds(dof, seeds)
            for when in ("middle", "mean"):
                name = f"{mission}: NEES of {what}, {when}"
                figures.append(Figure(name, mean(f"{what}_{when}"), high))
                figures.append(Figure(name, mean(f"{what}_{when}"), low, at_least=True))
    figures.append(Figure("20 km transit: largest depth error [m]", rows[1]["depth_max_m"], 0.05))
    return rows, figures


def noise_free(imu_hz: float, other_hz: float, period_s: float) -> Row:
    """Errors of a 20-minute dive without noise, largest over the dive."""
    mission = SimulationSettings(
        grade="noise_free",
        imu_rate_hz=imu_hz,
        dvl=DvlModel(rate_hz=other_hz),
        depth_sensor=DepthModel(rate_hz=other_hz),
        sun=SunModel(rate_hz=1.0 / period_s),
    )
    dive = simulate(mission)
    solution = smooth(dive, REFERENCE.model_copy(update={"keyframe_period_s": period_s}))
    judged = judge(dive, solution)
    assert judged.reference is not None
    c = compare(judged.solution, judged.reference)
    heading = np.degrees(c.e_rph[:, 2])
    return {
        "imu_hz": imu_hz,
        "dvl_hz": other_hz,
        "keyframe_period_s": period_s,
        "position_max_m": float(np.nanmax(np.linalg.norm(c.e_n, axis=1))),
        "position_rmse_m": float(np.sqrt(np.nanmean(np.sum(c.e_n**2, axis=1)))),
        "heading_max_deg": float(np.nanmax(np.abs(heading))),
        "heading_rmse_deg": float(np.sqrt(np.nanmean(heading**2))),
    }


def discretisation() -> tuple[list[Row], list[Figure]]:
    rows = in_processes(noise_free, RATES)
    slow, fast, all_fast = rows[0], rows[1], rows[3]
    return rows, [
        Figure("noise-free, 100 Hz: largest position error [m]", slow["position_max_m"], 0.02),
        Figure("noise-free, 100 Hz: largest heading error [deg]", slow["heading_max_deg"], 0.01),
        Figure("noise-free: position, 100 over 200 Hz", slow["position_max_m"] / fast["position_max_m"], 3.5, True),
        Figure(
            "noise-free: position, IMU and DVL at 100 and 5 over 200 and 10 Hz",
            slow["position_max_m"] / all_fast["position_max_m"],
            3.5,
            True,
        ),
        Figure("noise-free: heading, 100 over 200 Hz", slow["heading_max_deg"] / fast["heading_max_deg"], 3.5, True),
    ]


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--only", choices=("nees", "noise_free"), nargs="+", default=("nees", "noise_free"))
    args = options.parse_args()
    tables, figures = {}, []
    for part, job in (("noise_free", discretisation), ("nees", lambda: consistency(args.seeds))):
        if part in args.only:
            tables[part], more = job()
            figures += more
    finish(args, "consistency", tables, figures)


if __name__ == "__main__":
    main()
