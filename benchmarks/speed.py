"""How fast is a smoothing run, against GTSAM's own Levenberg-Marquardt on the same graph?

    python benchmarks/speed.py [--hours 2] [--repeats 3] [--json] [--save]

A simulated dive (100 Hz IMU, 5 Hz DVL, 1 Hz sun, a keyframe a second), smoothed from memory to solution: reading the
streams, dead reckoning, preintegration, building, solving. Peer: ``gtsam.LevenbergMarquardtOptimizer`` (COLAMD, default
linear solver; where that fails, QR) from the same first guess on the same graph, which is already built: only its
``optimize()`` counts. To make the graphs equal the DVL's calibration is not estimated; the default settings, which do
estimate it, are reported too. Times are medians of repeats with their range.

The covariances of the one backward pass are held against one query per key of GTSAM's Bayes tree. Peak memory is that
of a process of its own, simulator excluded as far as the operating system tells.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from _bench import Figure, Row, Timing, finish, in_processes, parser, timed  # isort: skip
import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.graph.builder import Problem, build
from uwgraph.graph.initial import initial_state
from uwgraph.graph.keyframes import schedule
from uwgraph.graph.marginals import marginal_covariances
from uwgraph.graph.prepare import prepare
from uwgraph.graph.track import dead_reckon
from uwgraph.simulate import SimulationSettings, simulate
from uwgraph.types import Solution

NATIVE = SmoothSettings(initial="reference", dvl_calibration=False, covariances=False)
WITH_COVARIANCES = NATIVE.model_copy(update={"covariances": True})
DEFAULT = SmoothSettings(initial="reference")
CASES = {"native": NATIVE, "native, 1-sigma": WITH_COVARIANCES, "default, 1-sigma": DEFAULT}
STAGES = ("reading the streams", "building the graph", "solving", "covariances", "whole")


def problem_of(dive: Dive, settings: SmoothSettings) -> Problem:
    """The first graph that :func:`smooth` solves, with its first guess."""
    prepared = prepare(dive)
    initial = initial_state(prepared, settings)
    keyframes = schedule(prepared, settings, initial.t_ns, int(prepared.imu.t_ns[-1]))
    track = dead_reckon(prepared, initial.t_ns, initial.R_nb, initial.p_n, initial.cov_rotation_b)
    return build(prepared, settings, initial, keyframes, track)


def stages(dive: Dive, settings: SmoothSettings) -> tuple[dict[str, float], Solution]:
    """Seconds of every stage of one run, and of the whole."""
    spent: dict[str, float] = {}
    now, started = ["start"], [time.perf_counter()]

    def tell(stage: str, _: float) -> None:
        if stage != now[0]:
            moment = time.perf_counter()
            spent[now[0]] = spent.get(now[0], 0.0) + moment - started[0]
            now[0], started[0] = stage, moment

    seconds, solution = timed(lambda: smooth(dive, settings, tell))
    return {k: v for k, v in spent.items() if k != "start"} | {"whole": seconds}, solution


def rows_of(runs: Mapping[str, Sequence[dict[str, float]]]) -> list[Row]:
    """A row of stage medians for every kind of run."""
    rows: list[Row] = []
    for name, spent in runs.items():
        whole = Timing.of([s["whole"] for s in spent])
        medians = {stage: Timing.of([s.get(stage, 0.0) for s in spent]).median for stage in STAGES}
        rows.append({"run": name, **medians, "least": whole.least, "most": whole.most})
    return rows


def levenberg_marquardt(problem: Problem) -> tuple[dict[str, float], Row]:
    """Seconds of GTSAM's own ``optimize()``, and how it went."""
    for solver in ("default", "MULTIFRONTAL_QR"):
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setOrderingType("COLAMD")
        if solver != "default":
            parameters.setLinearSolverType(solver)
        optimizer = gtsam.LevenbergMarquardtOptimizer(problem.graph, problem.values, parameters)
        try:
            seconds, _ = timed(optimizer.optimize)
        except RuntimeError:
            continue
        account = {
            "linear_solver": solver,
            "iterations": int(optimizer.iterations()),
            "error": float(optimizer.error()),
        }
        return {"whole": seconds}, account
    sys.exit("error: neither linear solver of GTSAM's Levenberg-Marquardt solved the graph")


def covariance_difference(dive: Dive, sampled: int) -> tuple[float, float, float]:
    """Largest difference to one query per key, relative to the sigmas; seconds of one pass, and a query."""
    problem = problem_of(dive, NATIVE)
    linear = problem.linearize(problem.values)
    bayes_net = linear.eliminateSequential(problem.ordering(linear), gtsam.EliminateQR)
    one_pass, marginals = timed(lambda: marginal_covariances(bayes_net))
    tree = linear.eliminateMultifrontal(problem.ordering(linear), gtsam.EliminateQR)
    frames = np.unique(np.linspace(0, len(problem.keyframes) - 1, sampled).astype(int)).tolist()
    keys = [symbol(k) for k in frames for symbol in (X, V, B)]

    def queries() -> list[np.ndarray]:
        return [np.linalg.inv(tree.marginalFactor(key, gtsam.EliminateQR).information()) for key in keys]

    seconds, asked = timed(queries)
    worst = 0.0
    for key, expected in zip(keys, asked, strict=True):
        sigma = np.sqrt(np.diag(expected))
        worst = max(worst, float(np.abs((marginals[key] - expected) / np.outer(sigma, sigma)).max()))
    return worst, one_pass, seconds / len(keys)


def peak_memory_gb(folder: str) -> tuple[float, float]:
    """Of this process: after reading the dive, and after smoothing it with covariances."""
    scale = 1e-9 * (1 if sys.platform == "darwin" else 1024)
    dive = read_dive(Path(folder))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale
    smooth(dive, DEFAULT)
    return before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--hours", type=float, default=2.0)
    options.add_argument("--repeats", type=int, default=3)
    args = options.parse_args()
    dive, half = (simulate(SimulationSettings(duration_s=3600.0 * h)) for h in (args.hours, args.hours / 2))

    problem = problem_of(dive, NATIVE)
    runs: dict[str, list[dict[str, float]]] = {name: [] for name in (*CASES, "default, half the dive", "GTSAM's LM")}
    for _ in range(args.repeats):  # one after the other, so that a busy machine is busy for all
        for name, settings in CASES.items():
            runs[name].append(stages(dive, settings)[0])
        spent, account = levenberg_marquardt(problem)
        runs["GTSAM's LM"].append(spent)
        spent, _ = stages(half, DEFAULT)
        runs["default, half the dive"].append(spent)
    rows = rows_of(runs)

    def ratio(a: str, b: str) -> float:
        """Median of the ratios within the rounds."""
        pairs = zip(runs[a], runs[b], strict=True)
        return Timing.of([x["whole"] / y["whole"] for x, y in pairs]).median

    difference, one_pass, query = covariance_difference(dive, sampled=100)
    with TemporaryDirectory() as folder:
        write_dive(dive, Path(folder) / "dive")
        [(loaded, peak)] = in_processes(peak_memory_gb, [(str(Path(folder) / "dive"),)])

    figures = [
        Figure("preintegrate, build, solve over GTSAM's LM", ratio("native", "GTSAM's LM"), 3.0),
        Figure("with the 1-sigma of every state over GTSAM's LM", ratio("native, 1-sigma", "GTSAM's LM"), 5.0),
        Figure("default settings, 1-sigma included, over GTSAM's LM", ratio("default, 1-sigma", "GTSAM's LM"), 5.0),
        Figure(f"{args.hours:g} h over {args.hours / 2:g} h", ratio("default, 1-sigma", "default, half the dive"), 2.3),
        Figure("peak memory [GB]", peak, 1.0),
        Figure("covariances: one pass against queries by key, in sigmas", difference, 1e-8),
    ]
    details = {
        "keyframes": len(problem.keyframes),
        "gtsam_lm": account,
        "covariances": {"one_pass_s": one_pass, "a_query_ms": 1e3 * query},
        "memory_with_the_dive_loaded_gb": loaded,
    }
    finish(args, "speed", {"seconds": rows}, figures, details)


if __name__ == "__main__":
    main()
