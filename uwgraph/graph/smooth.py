"""Smoothing a dive: one call from streams to a trajectory with covariance."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from uwgraph.dive import Dive
from uwgraph.errors import SolveError
from uwgraph.graph.builder import DVL_CALIBRATION, Problem, build
from uwgraph.graph.closures import close_loops
from uwgraph.graph.diagnose import diagnose
from uwgraph.graph.initial import Initial, initial_state
from uwgraph.graph.keyframes import schedule
from uwgraph.graph.marginals import marginal_covariances
from uwgraph.graph.observed import Observed
from uwgraph.graph.prepare import Prepared, prepare
from uwgraph.graph.settings import SmoothSettings
from uwgraph.graph.solver import Solved, solve
from uwgraph.graph.track import Track, dead_reckon
from uwgraph.types import FloatArray, RelativePoses, Solution, TimeArray

Progress = Callable[[str, float], None]
"""Called with the name of the stage and how far it is, 0 to 1."""

MAX_ROUNDS = 3
MOVED_M = 200.0
MOVED_RAD = np.radians(2.0)
"""A solution further than this from the track it was linearised about makes another round."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A solved graph, for those who want more of it than the solution."""

    prepared: Prepared
    initial: Initial
    problem: Problem
    solved: Solved
    solution: Solution
    """Without covariances."""

    @cached_property
    def track(self) -> Track:
        """The solution as a track that can be asked at any time within it."""
        return _track(self.prepared, self.solution)


def smooth(
    dive: Dive,
    settings: SmoothSettings | None = None,
    progress: Progress | None = None,
    more: Sequence[Observed] = (),
) -> Solution:
    """Estimate every keyframe's state and its covariance from a whole dive.

    Parameters
    ----------
    more
        Measurements beside the dive's streams, of anybody's own models; each gets a keyframe at its moment. Those
        outside the IMU's span are left out.

    Raises
    ------
    DataError
        When a stream that smoothing needs is missing or unusable.
    InitialisationError
        When nothing tells where the dive starts or which way it points.
    SolveError
        When the graph has no unique solution; the message names what nothing measures.
    """
    settings = settings or SmoothSettings()
    tell = progress or _silent
    started = time.monotonic()
    found = solve_dive(dive, settings, tell, more=more)
    problem, solved, solution = found.problem, found.solved, found.solution
    if settings.covariances:
        tell("covariances", 0.0)
        solution = with_covariances(solution, problem, solved.values)
        if not all(np.isfinite(c).all() for c in (solution.cov_pose, solution.cov_v, solution.cov_bias)):
            raise _unsolvable(problem, "the covariance is not finite: the graph has no unique solution")
    tell("done", 1.0)
    info = _info(found, time.monotonic() - started)
    return replace(solution, info=info)


def solve_dive(
    dive: Dive,
    settings: SmoothSettings,
    tell: Progress,
    guess: Solution | None = None,
    more: Sequence[Observed] = (),
) -> Smoothed:
    """The solved graph of a dive, begun from dead reckoning or from an earlier solution of the same dive.

    Raises what :func:`smooth` does.
    """
    tell("reading the streams", 0.0)
    prepared = prepare(dive)
    initial = initial_state(prepared, settings)
    keyframes = schedule(prepared, settings, initial.t_ns, int(prepared.imu.t_ns[-1]))
    more = [o for o in more if keyframes[0] <= o.t_ns <= keyframes[-1]]
    keyframes = np.union1d(keyframes, np.array([o.t_ns for o in more], dtype=np.int64))
    if guess is None:
        track = dead_reckon(prepared, initial.t_ns, initial.R_nb, initial.p_n, initial.cov_rotation_b)
    else:
        track = _track(prepared, guess)
    rounds = _Rounds(prepared, settings, initial, keyframes, tell, more)
    smoothed = rounds.settle(track)
    if settings.closures and prepared.closures is not None:
        smoothed = rounds.close(smoothed, prepared.closures)
    return smoothed


@dataclass(frozen=True, eq=False)
class _Rounds:
    """Build and solve, until the track that the graph is linearised about is where the solution is."""

    prepared: Prepared
    settings: SmoothSettings
    initial: Initial
    keyframes: TimeArray
    tell: Progress
    more: Sequence[Observed]

    def settle(self, track: Track, closures: RelativePoses | None = None) -> Smoothed:
        """The solution from a first track on, with closures that are believed as they are."""
        for _ in range(MAX_ROUNDS):
            self.tell("building the graph", 0.0)
            problem = build(self.prepared, self.settings, self.initial, self.keyframes, track, closures, self.more)
            smoothed = self._smoothed(problem, _solve(problem, self.settings, self.tell))
            if not _moved(track, smoothed.solution):
                break
            track = smoothed.track
        return smoothed

    def close(self, before: Smoothed, closures: RelativePoses) -> Smoothed:
        """The solution with those closures that can be believed."""

        def solve(problem: Problem) -> Solved:
            return _solve(problem, self.settings, self.tell)

        self.tell("judging closures", 0.0)
        closed = close_loops(before.problem, before.solved, before.track, closures, self.settings, solve)
        after = self._smoothed(closed.problem, closed.solved)
        if _moved(before.track, after.solution):
            after = self.settle(after.track, closures.select(closed.verdicts.accepted))
        return replace(after, solution=replace(after.solution, closures=closed.verdicts))

    def _smoothed(self, problem: Problem, solved: Solved) -> Smoothed:
        solution = _solution(self.prepared, self.keyframes, solved.values)
        return Smoothed(self.prepared, self.initial, problem, solved, solution)


def _solve(problem: Problem, settings: SmoothSettings, tell: Progress) -> Solved:
    try:
        return solve(problem, settings, lambda done: tell("solving", done))
    except SolveError as failure:
        raise _unsolvable(problem, failure.problem) from None


def _unsolvable(problem: Problem, what: str) -> SolveError:
    """The failure with the variable, its time and the direction that nothing measures."""
    diagnosis = diagnose(problem)
    return SolveError(what, where=diagnosis.where, remedy=diagnosis.remedy)


def _track(prepared: Prepared, solution: Solution) -> Track:
    """The solution as a track that can be asked at any time within it."""
    bias = solution.bias_gyro - prepared.rest.bias_gyro
    return Track(prepared, solution.t_ns, solution.R_nb, solution.p_n, solution.v_n, bias)


def resample(dive: Dive, solution: Solution, t_ns: TimeArray) -> Solution:
    """The solution at any stamps within it: the IMU turns the attitude, covariances are the last keyframe's.

    The covariance of a pose is in body axes: what was known of n stays known, and turns with the body.
    """
    track = _track(prepare(dive), solution)
    k = np.clip(np.searchsorted(solution.t_ns, t_ns, side="right") - 1, 0, len(solution) - 1)
    R_nb = track.rotation_at(t_ns)
    turn = np.zeros((len(t_ns), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = np.swapaxes(R_nb, 1, 2) @ solution.R_nb[k]
    return replace(
        solution,
        t_ns=t_ns,
        R_nb=R_nb,
        p_n=track.position_at(t_ns),
        v_n=track.velocity_at(t_ns),
        bias_gyro=solution.bias_gyro[k],
        bias_accel=solution.bias_accel[k],
        cov_pose=turn @ solution.cov_pose[k] @ np.swapaxes(turn, 1, 2),
        cov_v=solution.cov_v[k],
        cov_bias=solution.cov_bias[k],
    )


def with_covariances(solution: Solution, problem: Problem, values: gtsam.Values) -> Solution:
    """The solution with the covariance of every state, from one elimination and one backward pass."""
    linear = problem.linearize(values)
    marginals = marginal_covariances(linear.eliminateSequential(problem.ordering(linear), gtsam.EliminateQR))
    K = len(solution)

    def stacked(symbol: Callable[[int], int]) -> FloatArray:
        return np.stack([marginals[symbol(k)] for k in range(K)])

    calibration = dict(solution.calibration)
    if DVL_CALIBRATION in marginals:
        calibration.update(_named("sigma", np.sqrt(np.diag(marginals[DVL_CALIBRATION]))))
    return replace(solution, cov_pose=stacked(X), cov_v=stacked(V), cov_bias=stacked(B), calibration=calibration)


def _solution(prepared: Prepared, keyframes: TimeArray, values: gtsam.Values) -> Solution:
    K = len(keyframes)
    poses = np.array([values.atPose3(X(k)).matrix() for k in range(K)])
    bias = np.array([values.atConstantBias(B(k)).vector() for k in range(K)])
    calibration: Mapping[str, Any] = {}
    if values.exists(DVL_CALIBRATION):
        calibration = _named("estimate", values.atVector(DVL_CALIBRATION))
    return Solution(
        origin=prepared.origin,
        t_ns=keyframes,
        R_nb=poses[:, :3, :3],
        p_n=poses[:, :3, 3],
        v_n=np.array([values.atVector(V(k)) for k in range(K)]),
        bias_gyro=bias[:, 3:] + prepared.rest.bias_gyro,
        bias_accel=bias[:, :3],
        cov_pose=np.full((K, 6, 6), np.nan),
        cov_v=np.full((K, 3, 3), np.nan),
        cov_bias=np.full((K, 6, 6), np.nan),
        calibration=calibration,
    )


def _named(what: str, c: FloatArray) -> dict[str, float]:
    """Calibration vector as named numbers in people's units."""
    angles = np.degrees(c[1:])
    names = ("x", "y", "z")
    return {
        f"dvl_scale_error_{what}": float(c[0]),
        **{f"dvl_misalignment_{n}_deg_{what}": float(a) for n, a in zip(names, angles, strict=True)},
    }


def _moved(track: Track, solution: Solution) -> bool:
    """Whether the solution went so far from the track that places and moved measurements should be taken anew."""
    apart = np.linalg.norm(track.position_at(solution.t_ns) - solution.p_n, axis=1).max()
    dR = np.swapaxes(track.rotation_at(solution.t_ns), 1, 2) @ solution.R_nb
    turned = np.arccos(np.clip((np.trace(dR, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)).max()
    return bool(apart > MOVED_M or turned > MOVED_RAD)


def _info(found: Smoothed, seconds: float) -> Mapping[str, Any]:
    solved, verdicts = found.solved, found.solution.closures
    return {
        "runtime_s": seconds,
        "keyframes": len(found.problem.keyframes),
        "factors": dict(found.problem.counts),
        "dvl_pings_refused": found.prepared.refused_pings,
        **({} if verdicts is None else {"closures": dict(Counter(verdicts.reason.tolist()))}),
        "initial": found.initial.source,
        "converged": solved.converged,
        "stopped_because": solved.why,
        "iterations": [asdict(i) for i in solved.trace],
    }


def _silent(stage: str, done: float) -> None:
    """Nobody is listening."""
