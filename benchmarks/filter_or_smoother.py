"""Filters against smoothers on the same measurements: where smoothing helps, and where it cannot.

    python benchmarks/filter_or_smoother.py [--seeds 50] [--json] [--save]

Simulated dives of 15 minutes (lawn mower, MEMS IMU, Doppler log, depth, sun, GNSS at the surface at both ends), each
estimator from the same first state with the noise that was drawn. Cases: as it is; it stays down at the end; the sun's
directions reach the filters 2 s late; the sun is seen in the last third only (a cloud); a fifth of the Doppler pings
are wrong by 1 m/s.

``middle`` is the middle third of the dive, ``last`` its last epoch, after which nobody has more than a filter has. The
figures hold the graph smoother against the best filter (of eskf, ukf, aukf; by the same error over all seeds). Theory
says: nothing to gain at the last epoch, and before it as much as later measurements tell.
"""

from __future__ import annotations

from _bench import Figure, Row, finish, in_processes, parser  # isort: skip
from dataclasses import replace

import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.body_reference import body_reference
from uwgraph.evaluate import compare, nees
from uwgraph.evaluate.judge import judging_stamps
from uwgraph.filters import ESTIMATORS, EstimatorSettings, FilterSettings, task_of
from uwgraph.filters.kernels import compile_all
from uwgraph.simulate import DvlModel, SimulationSettings, simulate

NAMES = ("dr", "eskf", "ukf", "aukf", "rts", "smooth")
FILTERS = ("eskf", "ukf", "aukf")
CASES = ("fixes at both ends", "no fix at the end", "sun 2 s late", "sun in the last third", "20 % outliers")
LATE_S = 2.0
MISSION = SimulationSettings(duration_s=900.0, imu_rate_hz=50.0, truth_rate_hz=5.0, surface_at_end=True)


def dive_of(case: str, seed: int) -> Dive:
    mission = MISSION.model_copy(update={"surface_at_end": case != "no fix at the end"})
    if case == "20 % outliers":
        mission = mission.model_copy(update={"dvl": DvlModel(outlier_fraction=0.2, outlier_sigma=1.0)})
    dive = simulate(mission, seed)
    if case == "sun in the last third":
        assert dive.sun is not None
        t = dive.sun.t_s
        dive = replace(dive, sun=dive.sun.select(t > 2.0 * t[-1] / 3.0))
    return dive


def run(case: str, seed: int) -> list[Row]:
    """One dive by every estimator."""
    compile_all()
    dive = dive_of(case, seed)
    delays = {"sun": LATE_S} if case == "sun 2 s late" else {}
    settings = EstimatorSettings(filter=FilterSettings(samples_per_step=4, delays_s=delays))
    reference = body_reference(dive)
    assert reference is not None
    task = task_of(dive, settings.smooth)
    task = replace(task, t_ns=judging_stamps(task.t_ns, reference.t_ns))
    rows: list[Row] = []
    for name in NAMES:
        solution = ESTIMATORS[name].run(task, settings, lambda *_: None).solution
        c = compare(solution, reference)
        error = np.hypot(c.e_n[:, 0], c.e_n[:, 1])
        heading = np.degrees(c.e_rph[:, 2])
        third = slice(len(error) // 3, 2 * len(error) // 3)
        position = nees(c.e_n, c.estimate.cov_p_n)
        turn = nees(c.e_rph[:, 2:], c.estimate.cov_rph[:, 2:, 2:])
        rows.append(
            {
                "case": case,
                "estimator": name,
                "rmse_m": _rms(error),
                "middle_m": _rms(error[third]),
                "last_m": float(error[-1]),
                "heading_deg": _rms(heading),
                "heading_middle_deg": _rms(heading[third]),
                "nees_position": float(np.nanmean(position)) if np.isfinite(position).any() else np.nan,
                "nees_heading": float(np.nanmean(turn)) if np.isfinite(turn).any() else np.nan,
            }
        )
    return rows


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--seeds", type=int, default=50)
    options.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    args = options.parse_args()
    every = [r for rows in in_processes(run, [(c, s) for c in args.cases for s in range(args.seeds)]) for r in rows]
    table: list[Row] = []
    for case in args.cases:
        for name in NAMES:
            rows = [r for r in every if r["case"] == case and r["estimator"] == name]
            errors = {k: _rms(np.array([r[k] for r in rows])) for k in rows[0] if k.endswith(("_m", "_deg"))}
            averages = {k: float(np.mean([r[k] for r in rows])) for k in ("nees_position", "nees_heading")}
            table.append({"case": case, "estimator": name, **errors, **averages})
    gains = [_gain(table, case) for case in args.cases]
    figures = [
        Figure(f"{g['case']}: smoother over best filter, heading in the middle", g["heading_middle_deg"], 0.7)
        for g in gains
    ]
    figures += [
        Figure(f"{g['case']}: smoother over best filter, position in the middle", g["middle_m"], 0.7) for g in gains
    ]
    finish(
        args,
        "filter_or_smoother",
        {"errors": table, "smoother over best filter": gains},
        figures,
        {"seeds": args.seeds},
    )


def _gain(table: list[Row], case: str) -> Row:
    """Errors of the graph smoother over those of the best filter."""
    of = {r["estimator"]: r for r in table if r["case"] == case}
    keys = [k for k in of["smooth"] if k.endswith(("_m", "_deg"))]
    return {"case": case, **{k: of["smooth"][k] / min(of[f][k] for f in FILTERS) for k in keys}}


def _rms(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


if __name__ == "__main__":
    main()
