"""A sensor grows noisier in mid-dive: does an adaptive filter notice?

    python benchmarks/noise_step.py [--runs 200] [--duration 1200] [--json] [--save]

Simulated dives (FOG, Doppler log at 1 Hz with 0.05 m/s, depth, and acoustic fixes at 1 Hz): in mid-dive the
variance of the fixes is multiplied. The rig goes on stating what it stated, and the peer is the unscented filter that
believes it. Three cases: the stated variance is true at first and then 9 times too small; then 81 times (sigma x 9);
or it is 20 times too small from the beginning, and 180 times after the step. The adaptive filter learns R by the
residual form. Beside it the unbiased form, begun like ours and as it is written (k0 = 0: the first measurement replaces
what is stated); ``failures`` counts the measurements a run after which its R would not have been positive definite.

A filter that weighs a random walk of variance q against fixes of variance r, but takes r for r0, has the variance
sqrt(q r0) (r / r0 + 1) / 2 where sqrt(q r) is possible: that bounds what any adaptation can gain, and is in the table.
"""

from __future__ import annotations

from _bench import Figure, Row, finish, in_processes, parser  # isort: skip
from dataclasses import replace

import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.rig import DvlRig, FixesRig
from uwgraph.evaluate import judge
from uwgraph.filters import ESTIMATORS, Adaptation, EstimatorSettings, FilterSettings, task_of
from uwgraph.filters.kernels import compile_all
from uwgraph.frames import geodetic_from_ned, ned_from_geodetic
from uwgraph.graph import SmoothSettings
from uwgraph.simulate import DepthModel, DvlModel, SimulationSettings, simulate
from uwgraph.types import Fixes, FloatArray

CASES = {"R x 9": (1.0, 9.0), "R x 81": (1.0, 81.0), "stated R / 20, then x 9": (20.0, 180.0)}
"""True over stated variance before and after the step."""
FILTERS = {
    "ukf": ("ukf", Adaptation()),
    "aukf": ("aukf", Adaptation()),
    "aukf, unbiased": ("aukf", Adaptation(noise="unbiased")),
    "aukf, unbiased, k0 = 0": ("aukf", Adaptation(noise="unbiased", start=0)),
}
SIGMA = 1.0
DIVERGED_M = 100.0
START = SmoothSettings(initial="reference")


def mission(duration_s: float) -> SimulationSettings:
    return SimulationSettings(
        duration_s=duration_s,
        imu_rate_hz=20.0,
        truth_rate_hz=1.0,
        grade="fog",
        dvl=DvlModel(rig=DvlRig(sigma=0.05), rate_hz=1.0),
        depth_sensor=DepthModel(rate_hz=1.0),
        gnss=None,
        sun=None,
    )


def with_fixes(dive: Dive, ratios: tuple[float, float], seed: int) -> Dive:
    """Fixes along the truth, whose variance is a multiple of the stated one, before and after the middle."""
    truth = dive.reference
    assert truth is not None
    rng = np.random.default_rng([seed, 77])
    later = truth.t_ns > (truth.t_ns[0] + truth.t_ns[-1]) // 2
    sigma: FloatArray = SIGMA * np.sqrt(np.where(later, ratios[1], ratios[0]))
    p_n = ned_from_geodetic(dive.origin, truth.lat, truth.lon, truth.height)
    noisy = geodetic_from_ned(dive.origin, p_n + sigma[:, None] * rng.normal(size=p_n.shape))
    stated = np.tile(SIGMA**2 * np.eye(3), (len(truth), 1, 1))
    fixes = Fixes(truth.t_ns, *noisy, cov_n=stated, source=np.full(len(truth), "usbl"))
    rig = dive.rig.model_copy(update={"fixes": FixesRig(sigma=SIGMA)})
    return replace(dive, fixes=fixes, rig=rig)


def run(case: str, seed: int, duration_s: float) -> list[Row]:
    """One dive by every filter."""
    compile_all()
    dive = with_fixes(simulate(mission(duration_s), seed), CASES[case], seed)
    task = task_of(dive, START)
    rows: list[Row] = []
    for name, (estimator, adaptation) in FILTERS.items():
        settings = EstimatorSettings(filter=FilterSettings(samples_per_step=4, adaptation=adaptation))
        estimate = ESTIMATORS[estimator].run(task, settings, lambda *_: None)
        figures = judge(dive, estimate.solution).metrics
        eigenvalues = np.linalg.eigvalsh(estimate.solution.cov_pose)
        told = estimate.innovations
        assert told is not None
        fixes = told.select(told.kind == "fixes")
        rows.append(
            {
                "case": case,
                "filter": name,
                "rmse_m": figures["ate_rmse_m"],
                "max_m": figures["ate_max_m"],
                "nees_position": figures["nees_position"],
                "nonpositive": int((eigenvalues[:, 0] <= 0.0).sum()),
                "believed": float(np.sqrt(np.mean(fixes.noise[-1] ** 2))),
                "failures": int((fixes.accepted[:-1] & (np.diff(fixes.noise[:, 0]) == 0.0)).sum()),
            }
        )
    return rows


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--runs", type=int, default=200)
    options.add_argument("--duration", type=float, default=1200.0)
    args = options.parse_args()
    tasks = [(case, seed, args.duration) for case in CASES for seed in range(args.runs)]
    every = [row for rows in in_processes(run, tasks) for row in rows]
    table: list[Row] = []
    figures: list[Figure] = []
    for case, ratios in CASES.items():
        floor = np.sqrt(np.sum(np.sqrt(ratios)) / np.sum((np.array(ratios) + 1.0) / 2.0))
        fixed = _rms([r["rmse_m"] for r in every if r["case"] == case and r["filter"] == "ukf"])
        for name in FILTERS:
            rows = [r for r in every if r["case"] == case and r["filter"] == name]
            table.append(
                {
                    "case": case,
                    "filter": name,
                    "rmse_m": _rms([r["rmse_m"] for r in rows]),
                    "over_fixed": _rms([r["rmse_m"] for r in rows]) / fixed,
                    "theory": float(floor),
                    "nees": float(np.mean([r["nees_position"] for r in rows])),
                    "believed_sigma": float(np.median([r["believed"] for r in rows])),
                    "true_sigma": float(np.sqrt(ratios[1])),
                    "nonpositive_runs": sum(r["nonpositive"] > 0 for r in rows),
                    "diverged_runs": sum(not r["max_m"] < DIVERGED_M for r in rows),
                    "failures": float(np.mean([r["failures"] for r in rows])) if name != "ukf" else 0.0,
                }
            )
        adaptive = next(r for r in table if r["case"] == case and r["filter"] == "aukf")
        figures += [
            Figure(f"{case}: adaptive over fixed, position RMSE", adaptive["over_fixed"], 0.6),
            Figure(f"{case}: runs with a non-positive covariance", adaptive["nonpositive_runs"], 0),
            Figure(f"{case}: runs diverged", adaptive["diverged_runs"], 0),
        ]
    finish(args, "noise_step", {"cases": table}, figures)


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


if __name__ == "__main__":
    main()
