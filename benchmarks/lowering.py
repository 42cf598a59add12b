"""What lowering is worth: native factors against the same graph of Python CustomFactors, inside GTSAM's own LM.

    python benchmarks/lowering.py [--poses 2000] [--repeats 3] [--json] [--save]

A chain of poses along a lawn mower: gyro and DVL as a relative pose, depth and a sun direction at every pose. The same
measurements become factors by ``lowered()`` and by ``reference()``; optimizer, first guess and ordering are the same.
Inside an optimizer every call of a Python factor copies all values, so the ratio grows with the number of poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from _bench import Figure, Timing, finish, parser, timed  # isort: skip
import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from factors import Depth, Measurement, RelativePose, SunScatter
from uwgraph.simulate import SimulationSettings, trajectory_of

SUN_N = np.array([0.3, 0.6, -np.sqrt(0.55)])
SUN_SIGMA = np.radians(0.5)
ODOMETRY_SIGMAS = np.array([1e-3, 1e-3, 1e-3, 0.02, 0.02, 0.02])

Placed = tuple[Measurement, tuple[int, ...]]


def measurements(poses: Sequence[gtsam.Pose3], rng: np.random.Generator) -> list[Placed]:
    """Noisy measurements of a true track, each with its keys."""
    cov = np.diag(ODOMETRY_SIGMAS**2)
    placed: list[Placed] = []
    for k, (a, b) in enumerate(pairwise(poses)):
        motion = a.between(b).retract(ODOMETRY_SIGMAS * rng.standard_normal(6))
        placed.append((RelativePose(motion, cov), (X(k), X(k + 1))))
    for k, pose in enumerate(poses):
        s_b = pose.rotation().matrix().T @ SUN_N
        s_b = gtsam.Rot3.Expmap(SUN_SIGMA * rng.standard_normal(3)).matrix() @ s_b
        information = (np.eye(3) - np.outer(s_b, s_b)) / SUN_SIGMA**2
        placed.append((SunScatter(information, SUN_N), (X(k),)))
        placed.append((Depth(pose.translation()[2] + 0.05 * rng.standard_normal(), 0.05), (X(k),)))
    return placed


def graph_of(placed: Sequence[Placed], first: gtsam.Pose3, *, native: bool) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(gtsam.PriorFactorPose3(X(0), first, gtsam.noiseModel.Diagonal.Sigmas(np.full(6, 0.01))))
    for measurement, keys in placed:
        graph.push_back(measurement.lowered(keys) if native else measurement.reference(keys))
    return graph


def solve(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, repeats: int) -> tuple[Timing, gtsam.Values]:
    seconds = []
    for _ in range(repeats):
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values)
        spent, solution = timed(optimizer.optimize)
        seconds.append(spent)
    return Timing.of(seconds), solution


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--poses", type=int, default=2000)
    options.add_argument("--repeats", type=int, default=3)
    args = options.parse_args()
    motion = trajectory_of(SimulationSettings(duration_s=float(args.poses)), 0)
    t = np.arange(args.poses, dtype=np.float64)
    poses = [gtsam.Pose3(gtsam.Rot3(R), p) for R, p in zip(motion.attitude(t), motion.position(t), strict=True)]
    rng = np.random.default_rng(0)
    placed = measurements(poses, rng)
    values = gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(X(k), pose.retract(np.repeat([0.02, 0.5], 3) * rng.standard_normal(6)))

    native, solution = solve(graph_of(placed, poses[0], native=True), values, args.repeats)
    python, same = solve(graph_of(placed, poses[0], native=False), values, 1)
    apart = max(
        float(np.abs(solution.atPose3(X(k)).localCoordinates(same.atPose3(X(k)))).max()) for k in range(args.poses)
    )
    row = {
        "poses": args.poses,
        "factors": len(placed),
        "lowered_s": native.median,
        "least_s": native.least,
        "most_s": native.most,
        "custom_factors_s": python.median,
        "solutions_apart": apart,
    }
    figures = [Figure("CustomFactors over lowered factors", python.median / native.median, 25.0, at_least=True)]
    finish(args, "lowering", {"LM": [row]}, figures)


if __name__ == "__main__":
    main()
