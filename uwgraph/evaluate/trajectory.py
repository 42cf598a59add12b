"""Poses from anywhere, a file of others or a dive's reference, in one Cartesian frame so that they can be compared."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uwgraph.evaluate.people import congruence, people
from uwgraph.evaluate.reference import known_rows
from uwgraph.frames import R_n_local, geodetic_from_ned, matrix_from_rph, ned_from_geodetic, rph_from_matrix
from uwgraph.types import FloatArray, Origin, Reference, Solution, Stream, TimeArray


@dataclass(frozen=True, eq=False)
class Trajectory(Stream):
    """Poses in time order against n (NED, or whatever Cartesian frame stands for it); NaN where not known."""

    p_n: FloatArray
    """Position, shape (K, 3), m; the down component may be NaN."""
    R_nb: FloatArray
    """Rotation body (FRD) to n, shape (K, 3, 3)."""
    rph: FloatArray
    """Roll, pitch and heading of ``R_nb``; or of them what is known without it, shape (K, 3), rad."""
    v_n: FloatArray
    """Velocity in n, shape (K, 3), m/s."""
    cov_p_n: FloatArray
    """Covariance of ``p_n``, shape (K, 3, 3), m^2."""
    cov_rph: FloatArray
    """Covariance of roll, pitch and heading, shape (K, 3, 3), rad^2."""
    origin: Origin | None = None
    """Where n touches the ellipsoid, if that is known."""
    frame: str = "NED world, FRD body"
    """Of the file, in words."""
    assumed: bool = False
    """Nobody stated the frame."""
    caveats: tuple[str, ...] = ()
    """What else was assumed in reading it, in words."""

    @classmethod
    def scalars(cls) -> tuple[str, ...]:
        return ("origin", "frame", "assumed", "caveats")


def trajectory_of(
    t_ns: TimeArray,
    p_n: FloatArray,
    R_nb: FloatArray | None = None,
    rph: FloatArray | None = None,
    v_n: FloatArray | None = None,
    cov_p_n: FloatArray | None = None,
    cov_rph: FloatArray | None = None,
    origin: Origin | None = None,
) -> Trajectory:
    """A trajectory of what is known: NaN for the rest."""
    unknown = np.full((len(t_ns), 3, 3), np.nan)
    if R_nb is None:
        R_nb = unknown
    known = known_rows(R_nb.reshape(-1, 9))
    angles = unknown[:, 0] if rph is None else rph
    return Trajectory(
        t_ns=t_ns,
        p_n=p_n,
        R_nb=R_nb,
        rph=np.where(known[:, None], rph_from_matrix(R_nb), angles),
        v_n=unknown[:, 0] if v_n is None else v_n,
        cov_p_n=unknown if cov_p_n is None else cov_p_n,
        cov_rph=unknown if cov_rph is None else cov_rph,
        origin=origin,
    )


def trajectory_of_places(reference: Reference, origin: Origin) -> Trajectory:
    """Places on the ellipsoid, and angles against the local vertical and true north, in n of ``origin``."""
    deep = np.isfinite(reference.height)
    # without a height the horizontal position is still known: put the point on the surface and forget its down
    p_n = ned_from_geodetic(origin, reference.lat, reference.lon, np.where(deep, reference.height, 0.0))
    p_n[~deep, 2] = np.nan
    R = R_n_local(origin, reference.lat, reference.lon)
    return trajectory_of(
        reference.t_ns,
        p_n,
        R_nb=R @ matrix_from_rph(reference.rph),
        rph=_turned(reference.rph, R),
        v_n=np.einsum("kij,kj->ki", R, reference.v_n),
        origin=origin,
    )


def trajectory_of_solution(solution: Solution) -> Trajectory:
    """A solution as a trajectory in its own n."""
    read = people(solution)
    return trajectory_of(
        solution.t_ns,
        solution.p_n,
        R_nb=solution.R_nb,
        v_n=solution.v_n,
        cov_p_n=read.cov_p_n,
        cov_rph=read.cov_rph,
        origin=solution.origin,
    )


def seen_from(trajectory: Trajectory, origin: Origin) -> Trajectory:
    """The same trajectory in the n of another origin; as it is where its own origin is not known."""
    if trajectory.origin is None or trajectory.origin == origin:
        return trajectory
    deep = np.isfinite(trajectory.p_n[:, 2])
    flat = np.column_stack([trajectory.p_n[:, :2], np.where(deep, trajectory.p_n[:, 2], 0.0)])
    p_n = ned_from_geodetic(origin, *geodetic_from_ned(trajectory.origin, flat))
    p_n[~deep, 2] = np.nan
    R = R_n_local(origin, trajectory.origin.lat, trajectory.origin.lon)
    return replace(
        trajectory_of(
            trajectory.t_ns,
            p_n,
            R_nb=R @ trajectory.R_nb,
            rph=_turned(trajectory.rph, R),
            v_n=trajectory.v_n @ R.T,
            cov_p_n=congruence(R, trajectory.cov_p_n),
            cov_rph=trajectory.cov_rph,
            origin=origin,
        ),
        frame=trajectory.frame,
        assumed=trajectory.assumed,
        caveats=trajectory.caveats,
    )


def _turned(rph: FloatArray, R: FloatArray) -> FloatArray:
    """Angles of other axes against those that R, shape (..., 3, 3), turns them to: the meridians' convergence."""
    turned = rph.copy()
    turned[:, 2] += np.nan_to_num(np.arctan2(R[..., 1, 0], R[..., 0, 0]), nan=0.0)
    return turned
