"""Two trajectories brought to the same stamps and the same frame, and subtracted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from uwgraph.evaluate.align import Alignment, align
from uwgraph.evaluate.metrics import Comparison
from uwgraph.evaluate.people import People
from uwgraph.evaluate.reference import ReferenceAt, interpolate_rotations, interpolate_rows, known_rows
from uwgraph.evaluate.trajectory import Trajectory, seen_from, trajectory_of
from uwgraph.frames import rph_from_matrix, wrap_pi
from uwgraph.time import NS
from uwgraph.types import BoolArray, FloatArray, Origin, Solution, TimeArray, stream_fields


@dataclass(frozen=True)
class Matching:
    """How poses of two trajectories find each other, at the stamps of the sparser one."""

    how: Literal["interpolate", "nearest"] = "interpolate"
    """The denser trajectory is interpolated there, or gives its nearest pose."""
    max_dt_s: float | None = None
    """How far away a pose of the denser one may be, seconds. By default anything within its span and not in a long
    gap; for ``nearest`` half its median period."""


def compare_trajectories(
    estimate: Trajectory, reference: Trajectory, alignment: Alignment = "none", matching: Matching | None = None
) -> Comparison:
    """Match, align and subtract: in n of the reference's origin where both know theirs, else as the files have it.

    Headings are against n, depth is along its down axis. Poses without a partner stay, as not matched.
    """
    matching = matching or Matching()
    if reference.origin is not None:
        estimate = seen_from(estimate, reference.origin)
    if denser(estimate, reference) is reference:
        reference = sampled(reference, estimate.t_ns, matching)
    else:
        estimate = sampled(estimate, reference.t_ns, matching)
    truth = ReferenceAt(reference.p_n, reference.p_n[:, 2], reference.rph)
    solution = align(_solution(estimate), truth, alignment)
    read = _people(estimate, solution, turned=alignment in ("yaw", "se3"))
    e_n, e_rph = solution.p_n - truth.p_n, wrap_pi(read.rph - truth.rph)
    return Comparison(
        solution=solution,
        estimate=read,
        truth=truth,
        R_nb_true=reference.R_nb,
        alignment=alignment,
        matched=known_rows(e_n[:, :2]) | np.isfinite(e_rph[:, 2]),
        e_n=e_n,
        e_depth=e_n[:, 2],
        e_rph=e_rph,
    )


def denser(estimate: Trajectory, reference: Trajectory) -> Trajectory:
    """The one with the shorter median period, which is interpolated; the reference where they are alike."""
    return estimate if _period_ns(estimate) < _period_ns(reference) else reference


def sampled(trajectory: Trajectory, t_ns: TimeArray, matching: Matching) -> Trajectory:
    """The trajectory at other stamps, NaN where it does not reach; covariances are those of the nearest pose."""
    own = trajectory.t_ns
    if np.array_equal(own, t_ns):
        return trajectory
    after = np.clip(np.searchsorted(own, t_ns), 1, max(len(own) - 1, 1))
    before_is_nearer = np.abs(t_ns - own[after - 1]) <= np.abs(own[after % len(own)] - t_ns)
    nearest = np.where(before_is_nearer, after - 1, after % len(own))
    apart_s = np.abs(own[nearest] - t_ns) / NS
    limit_s = np.inf if matching.max_dt_s is None else matching.max_dt_s
    if matching.how == "nearest":
        found = trajectory.select(nearest)
        limit_s = _period_ns(trajectory) / 2 / NS if matching.max_dt_s is None else limit_s
    else:
        found = _interpolated(trajectory, t_ns, nearest)
    return _forgotten(replace(found, t_ns=t_ns), apart_s > limit_s)


def _forgotten(trajectory: Trajectory, far: BoolArray) -> Trajectory:
    """The trajectory with NaN in the rows that ``far`` marks."""
    kept: dict[str, Any] = {
        name: np.where(far.reshape(-1, *[1] * (array.ndim - 1)), np.nan, array)
        for name, array in stream_fields(trajectory)
        if name != "t_ns"
    }
    return Trajectory(trajectory.t_ns, **kept)


def _interpolated(trajectory: Trajectory, t_ns: TimeArray, nearest: TimeArray) -> Trajectory:
    """Positions by Hermite where velocities are known, else linearly; attitudes by slerp, lone angles linearly."""
    t, query = ((stamps - trajectory.t_ns[0]) / NS for stamps in (trajectory.t_ns, t_ns))
    p, v = trajectory.p_n, trajectory.v_n
    posed = known_rows(trajectory.R_nb.reshape(-1, 9))
    alone = np.column_stack([_angle(t, angle, query) for angle in trajectory.rph.T])
    return replace(
        trajectory_of(
            t_ns,
            np.hstack([interpolate_rows(t, p[:, :2], v[:, :2], query), interpolate_rows(t, p[:, 2:], v[:, 2:], query)]),
            R_nb=interpolate_rotations(t[posed], trajectory.R_nb[posed], query),
            rph=alone,
            v_n=interpolate_rows(t, v, np.full_like(v, np.nan), query),
            cov_p_n=trajectory.cov_p_n[nearest],
            cov_rph=trajectory.cov_rph[nearest],
            origin=trajectory.origin,
        ),
        frame=trajectory.frame,
        assumed=trajectory.assumed,
    )


def _angle(t: FloatArray, angle: FloatArray, query: FloatArray) -> FloatArray:
    """An angle at ``query``, along the shorter way."""
    known = np.isfinite(angle)
    unwrapped = np.unwrap(angle[known])[:, None]
    return interpolate_rows(t[known], unwrapped, np.full_like(unwrapped, np.nan), query)


def _period_ns(trajectory: Trajectory) -> float:
    return float(np.median(np.diff(trajectory.t_ns))) if len(trajectory) > 1 else np.inf


def _solution(estimate: Trajectory) -> Solution:
    """Poses as a solution of which nothing else is known; its place on Earth is not used."""
    unknown = np.full((len(estimate), 6, 6), np.nan)
    return Solution(
        origin=estimate.origin or Origin(np.nan, np.nan),
        t_ns=estimate.t_ns,
        R_nb=estimate.R_nb,
        p_n=estimate.p_n,
        v_n=estimate.v_n,
        bias_gyro=unknown[:, 0, :3],
        bias_accel=unknown[:, 0, :3],
        cov_pose=unknown,
        cov_v=unknown[:, :3, :3],
        cov_bias=unknown,
    )


def _people(estimate: Trajectory, aligned: Solution, *, turned: bool) -> People:
    """As people read it, against n. A lone heading, which no alignment can turn, is then not known."""
    posed = known_rows(aligned.R_nb.reshape(-1, 9))[:, None]
    unknown = np.full(len(estimate), np.nan)
    return People(
        lat=unknown,
        lon=unknown,
        height=-aligned.p_n[:, 2],
        rph=np.where(posed, rph_from_matrix(aligned.R_nb), np.nan if turned else estimate.rph),
        cov_p_n=estimate.cov_p_n,
        cov_rph=estimate.cov_rph,
    )
