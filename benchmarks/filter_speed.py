"""How fast is a step of the unscented filter, and a filtered dive?

    python benchmarks/filter_speed.py [--steps 2000] [--snapir FOLDER] [--json] [--save]

The peer is filterpy's ``UnscentedKalmanFilter`` with the same 15-state inertial model, sigma points and noise, and with
rotations on the manifold through its hooks (``x_mean_fn``, ``residual_x``, ``state_add``, ``subtract``); the process
and the measurement are called point by point, as it does. Both predict at 100 Hz and take a Doppler velocity at 5 Hz, a
depth at 5 Hz and a heading at 1 Hz; adaptation is off. The states must be equal. With adaptation on the filter is timed
again.
With ``--snapir`` a recorded run is filtered from its reference's first state, all 100 Hz samples one by one.
"""

from __future__ import annotations

from _bench import Figure, Row, finish, parser, timed  # isort: skip
from pathlib import Path

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

import factors
from uwgraph.dive.importing import read_recording
from uwgraph.dive.rig import ImuRig
from uwgraph.filters import ESTIMATORS, Adaptation, EstimatorSettings, task_of
from uwgraph.filters.ins import Ins
from uwgraph.filters.kalman import Unscented
from uwgraph.filters.kernels import compile_all
from uwgraph.filters.monitor import Monitor, Policy
from uwgraph.filters.state import Belief, State
from uwgraph.graph import SmoothSettings
from uwgraph.graph.observed import Observed
from uwgraph.types import FloatArray

RATE_HZ = 100
EARTH = np.array([0.0, 0.0, 9.81, 5e-5, 0.0, 5e-5])
SIGMAS = np.repeat([0.02, 1.0, 0.3, 1e-4, 1e-2], 3)


def scene(steps: int) -> tuple[FloatArray, dict[int, list[Observed]]]:
    """IMU steps of a gently turning vehicle and what its sensors say, with noise."""
    rng = np.random.default_rng(0)
    t = np.arange(steps) / RATE_HZ
    rate = np.column_stack([0.02 * np.sin(t), 0.03 * np.cos(0.7 * t), np.full(steps, 0.1)])
    force = np.column_stack([0.1 * np.sin(0.5 * t), 0.1 * np.cos(0.3 * t), np.full(steps, -9.81)])
    imu = np.column_stack([np.full(steps, 1.0 / RATE_HZ), force, rate + 1e-3 * rng.normal(size=(steps, 3))])
    measured: dict[int, list[Observed]] = {}
    for k in range(20, steps + 1, 20):
        v = np.array([1.0, 0.0, 0.0]) + 0.01 * rng.normal(size=3)
        dvl = factors.DvlVelocity(v, 1e-4 * np.eye(3), imu[k - 1, 4:7], np.array([0.4, 0.0, 0.1]), EARTH[3:])
        measured[k] = [
            Observed(k, "dvl", dvl, ("pose", "velocity", "bias", "dvl")),
            Observed(k, "depth", factors.Depth(0.05 * rng.normal(), 0.05)),
        ]
        if k % RATE_HZ == 0:
            measured[k].append(Observed(k, "heading", factors.Heading(0.1 * k / RATE_HZ, 0.01)))
    return imu, measured


def ours(imu: FloatArray, measured: dict[int, list[Observed]], ins: Ins, policy: Policy) -> Belief:
    kalman, monitors = Unscented(ins), dict[str, Monitor]()
    belief = Belief(0, start(ins), np.diag(SIGMAS))
    for k, step in enumerate(imu, start=1):
        belief = kalman.predict(belief, k, step[None], EARTH)
        for observed in measured.get(k, ()):
            taken = policy.take(belief, lambda b, o=observed: kalman.see(b, o), monitors.get(observed.kind))
            belief, monitors[observed.kind] = taken.belief, taken.monitor
    return belief


class Peer:
    """The same model as filterpy wants it: a state is the tangent vector from a fixed one."""

    def __init__(self, ins: Ins) -> None:
        self.ins = ins
        self.base = ins.state(np.eye(3), np.zeros(3), np.zeros(3))
        points = MerweScaledSigmaPoints(
            15, alpha=1.0, beta=2.0, kappa=0.0, subtract=lambda x, d: self.add(x, -np.asarray(d))
        )
        self.filter = UnscentedKalmanFilter(
            dim_x=15,
            dim_z=3,
            dt=1.0 / RATE_HZ,
            hx=None,
            fx=self.move,
            points=points,
            x_mean_fn=self.mean,
            residual_x=self.difference,
            state_add=self.add,
        )
        rows = ins.noise_rows(1.0 / RATE_HZ)
        self.filter.x, self.filter.P, self.filter.Q = self.flat(start(ins)), np.diag(SIGMAS**2), rows.T @ rows

    def flat(self, x: State) -> FloatArray:
        return self.base.to(x)

    def state(self, x: FloatArray) -> State:
        return self.base.plus(x)

    def add(self, x: FloatArray, d: FloatArray) -> FloatArray:
        return self.flat(self.state(x).plus(d))

    def difference(self, a: FloatArray, b: FloatArray) -> FloatArray:
        return self.state(b).to(self.state(a))

    def mean(self, points: FloatArray, W: FloatArray) -> FloatArray:
        return self.add(points[0], sum(w * self.difference(p, points[0]) for w, p in zip(W, points, strict=True)))

    def move(self, x: FloatArray, dt: float, step: FloatArray) -> FloatArray:
        moved = self.ins.move(batch(self.state(x)), step, EARTH)
        return self.flat(State(moved.R[0], moved.y[0], moved.rot))

    def see(self, x: FloatArray, observed: Observed) -> FloatArray:
        return self.ins.residuals(observed, batch(self.state(x)))[0]

    def run(self, imu: FloatArray, measured: dict[int, list[Observed]]) -> tuple[State, FloatArray]:
        f = self.filter
        for k, step in enumerate(imu, start=1):
            f.predict(step=step)
            for observed in measured.get(k, ()):
                m = len(observed.whitener)
                f.update(np.zeros(m), R=np.eye(m), hx=lambda x, o=observed: self.see(x, o))
                f.sigmas_f = f.points_fn.sigma_points(f.x, f.P)  # or a second measurement would see the first's
        return self.state(f.x), f.P


def start(ins: Ins) -> State:
    return ins.state(np.eye(3), np.zeros(3), np.array([1.0, 0.0, 0.0]))


def batch(x: State) -> State:
    return State(x.R[None].copy(), x.y[None].copy(), x.rot)


def snapir(folder: Path) -> list[Row]:
    """One recorded run by each filter, every IMU sample a step."""
    task = task_of(read_recording(folder).dive, SmoothSettings(initial="reference"))
    span = float(task.t_ns[-1] - task.t_ns[0]) * 1e-9
    rows: list[Row] = []
    for name in ("eskf", "ukf", "aukf"):
        seconds = [
            timed(lambda n=name: ESTIMATORS[n].run(task, EstimatorSettings(), lambda *_: None))[0] for _ in range(3)
        ]
        rows.append({"filter": name, "run_s": span, "median_s": float(np.median(seconds)), "most_s": max(seconds)})
    return rows


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--steps", type=int, default=2000)
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--snapir", type=Path, help="a recorded run")
    args = options.parse_args()
    compile_all()
    ins = Ins(ImuRig())
    imu, measured = scene(args.steps)
    fixed, adaptive = Policy(1.0), Policy(1.0, Adaptation())
    times: dict[str, list[float]] = {"filterpy": [], "uwgraph": [], "uwgraph, adaptive": []}
    for _ in range(args.repeats):
        seconds, (x, P) = timed(lambda: Peer(ins).run(imu, measured))
        times["filterpy"].append(seconds)
        seconds, belief = timed(lambda: ours(imu, measured, ins, fixed))
        times["uwgraph"].append(seconds)
        times["uwgraph, adaptive"].append(timed(lambda: ours(imu, measured, ins, adaptive))[0])
    rows: list[Row] = [
        {
            "filter": name,
            "microseconds_a_step": 1e6 * float(np.median(t)) / args.steps,
            "least": 1e6 * min(t) / args.steps,
            "most": 1e6 * max(t) / args.steps,
        }
        for name, t in times.items()
    ]
    ratios = {name: float(np.median(np.divide(times["filterpy"], t))) for name, t in times.items()}
    sigma = np.sqrt(np.diag(P))
    figures = [
        Figure("mean: largest difference", float(np.abs(belief.x.to(x)).max()), 1e-6),
        Figure(
            "covariance: largest difference, correlations",
            float(np.abs((belief.P - P) / np.outer(sigma, sigma)).max()),
            1e-6,
        ),
        Figure("filterpy over uwgraph", ratios["uwgraph"], 20.0, at_least=True),
        Figure("filterpy over uwgraph, adaptive", ratios["uwgraph, adaptive"], 20.0, at_least=True),
    ]
    tables = {"steps": rows}
    if args.snapir:
        tables["snapir"] = snapir(args.snapir)
        figures += [
            Figure(f"{r['filter']}: {r['run_s']:.0f} s of recording [s]", r["median_s"], 10.0) for r in tables["snapir"]
        ]
    finish(args, "filter_speed", tables, figures)


if __name__ == "__main__":
    main()
