"""Places seen again and visual odometry as a camera would have told them, derived from the truth.

False closures are of the two kinds that hurt: single wrong matches anywhere, and groups that agree with each other, as
when one corner of a structure is taken for another, or a texture that repeats for its neighbour.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation

from uwgraph.dive.rig import Positive, Settings, VisualRig
from uwgraph.errors import DataError
from uwgraph.simulate.noise import Noise
from uwgraph.simulate.trajectory import Motion
from uwgraph.time import from_seconds
from uwgraph.types import FloatArray, RelativePoses

Share = Annotated[float, Field(ge=0, le=1)]
IndexArray = NDArray[np.intp]

TRUE: Final = "simulated"
RANDOM: Final = "simulated, false: any other place"
CORNER: Final = "simulated, false: one stretch of the way taken for another"
SHIFTED: Final = "simulated, false: a texture that repeats, shifted by a constant"


class RelativePoseNoise(Settings):
    """How well a camera tells a relative pose."""

    rig: VisualRig = VisualRig()
    sigma: Positive = 0.1
    """m per axis."""
    sigma_deg: Positive = 0.5
    """Per axis."""


class ClosureModel(RelativePoseNoise):
    """A camera that recognises places."""

    period_s: Positive = 10.0
    """One look for known places every so often."""
    reach_m: Positive = 3.0
    """A place is seen again within this distance,"""
    reach_deg: Positive = 30.0
    """and this turn,"""
    apart_s: Positive = 60.0
    """and not sooner than after this time."""
    false_share: Share = 0.0
    """Share of the closures that are false."""
    grouped_share: Share = 0.5
    """Share of the false ones that come in groups which agree with each other."""
    group: Annotated[int, Field(ge=2)] = 6
    """Closures in such a group, one look after the other."""
    shift_m: tuple[Positive, Positive] = (1.0, 30.0)
    """Least and greatest horizontal distance at which textures repeat (log-uniform)."""


class OdometryModel(RelativePoseNoise):
    """A camera that tells its motion from image to image."""

    period_s: Positive = 0.5
    sigma: Positive = 0.01
    sigma_deg: Positive = 0.1


@dataclass(frozen=True, eq=False)
class _Claims:
    """What is claimed: two moments each, the pose of one seen from the other, and what it is."""

    before: FloatArray
    after: FloatArray
    R: FloatArray
    p: FloatArray
    what: NDArray[np.str_]


def measure_odometry(motion: Motion, model: OdometryModel, noise: Noise) -> RelativePoses:
    """The motion from each image to the next."""
    count = int(np.floor(motion.duration_s / model.period_s + 1e-9)) + 1
    t: FloatArray = np.arange(count, dtype=np.float64) * model.period_s
    R, p = _between(motion, t[:-1], t[1:])
    return _stream(motion, _Claims(t[:-1], t[1:], R, p, np.full(len(p), TRUE)), model, noise)


def measure_closures(motion: Motion, model: ClosureModel, noise: Noise) -> RelativePoses:
    """Places seen again, some of them falsely; ``reason`` tells which.

    Raises
    ------
    DataError
        When the motion comes back to no place.
    """
    before, after = _revisits(motion, model, noise.rng)
    if not len(after):
        raise DataError(
            f"the way never comes back within {model.reach_m:g} m and {model.reach_deg:g} deg of itself",
            where="reference",
            remedy="fly a patrol, or widen reach_m and reach_deg",
        )
    R, p = _between(motion, before, after)
    claims = _Claims(before.copy(), after, R.copy(), p.copy(), np.full(len(after), TRUE, dtype=f"U{len(SHIFTED)}"))
    _falsify(motion, model, claims, noise.rng)
    return _stream(motion, claims, model, noise)


def _revisits(motion: Motion, model: ClosureModel, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Pairs of times at one place: of every look, the nearest moment of a former pass drawn at random."""
    now = np.arange(model.apart_s, motion.duration_s, model.period_s)
    step = 0.2 * model.reach_m / max(_speed(motion), 1e-3)
    then = np.arange(0.0, motion.duration_s, min(step, model.period_s))
    p_then, R_then = motion.position(then), motion.attitude(then)
    cosine = np.cos(np.radians(model.reach_deg))
    before: list[float] = []
    after: list[float] = []
    for t, p, R in zip(now, motion.position(now), motion.attitude(now), strict=True):
        distance = np.linalg.norm(p_then - p, axis=1)
        turn = 0.5 * (np.einsum("nij,ij->n", R_then, R) - 1.0)
        near = np.flatnonzero((then < t - model.apart_s) & (distance < model.reach_m) & (turn > cosine))
        if len(near):
            passes = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
            chosen = passes[int(rng.integers(len(passes)))]
            before.append(float(then[chosen[np.argmin(distance[chosen])]]))
            after.append(float(t))
    return np.array(before, dtype=np.float64), np.array(after, dtype=np.float64)


def _speed(motion: Motion) -> float:
    t = np.linspace(0.0, motion.duration_s, 200)
    return float(np.median(np.linalg.norm(motion.velocity(t), axis=1)))


def _falsify(motion: Motion, model: ClosureModel, claims: _Claims, rng: np.random.Generator) -> None:
    """Replace a share of the true claims by false ones, in place."""
    N = len(claims.after)
    wanted = round(model.false_share * N)
    grouped = round(model.grouped_share * wanted)
    kinds = (_one_for_another, _shifted)
    made = 0
    while made < grouped:
        size = min(model.group, grouped - made)
        true = np.flatnonzero(claims.what == TRUE)
        start = int(rng.integers(max(len(true) - size, 0) + 1))
        group = true[start : start + size]
        kinds[int(rng.integers(2))](motion, model, claims, group, rng)
        made += len(group)
    for n in rng.choice(np.flatnonzero(claims.what == TRUE), wanted - made, replace=False):
        claims.before[n] = _elsewhere(motion, model, float(claims.after[n]), rng)
        claims.what[n] = RANDOM


def _elsewhere(motion: Motion, model: ClosureModel, after: float, rng: np.random.Generator) -> float:
    """An earlier moment at another place."""
    t = np.linspace(0.0, max(after - model.apart_s, 0.0), 500)
    apart = np.linalg.norm(motion.position(t) - motion.position(np.array([after])), axis=1)
    other = t[apart > 2.0 * model.reach_m]
    return float(rng.choice(other)) if len(other) else 0.0


def _one_for_another(
    motion: Motion, model: ClosureModel, claims: _Claims, group: IndexArray, rng: np.random.Generator
) -> None:
    """The stretch over the group's moments is taken for one elsewhere: X_i^-1 D X_j with one D for all."""
    after = claims.after[group]
    claims.before[group] = _elsewhere(motion, model, float(after[0]), rng) + after - after[0]
    first = group[0]
    R_i, p_i = motion.attitude(claims.before[group]), motion.position(claims.before[group])
    R_j, p_j = motion.attitude(after), motion.position(after)
    R_D = R_i[0] @ claims.R[first] @ R_j[0].T
    p_D = p_i[0] + R_i[0] @ claims.p[first] - R_D @ p_j[0]
    claims.R[group] = np.swapaxes(R_i, 1, 2) @ R_D @ R_j
    claims.p[group] = np.einsum("nji,nj->ni", R_i, p_j @ R_D.T + p_D - p_i)
    claims.what[group] = CORNER


def _shifted(motion: Motion, model: ClosureModel, claims: _Claims, group: IndexArray, rng: np.random.Generator) -> None:
    """The place is right but for a horizontal shift in n, the same for all."""
    length, course = np.exp(rng.uniform(*np.log(model.shift_m))), rng.uniform(0.0, 2.0 * np.pi)
    shift = length * np.array([np.cos(course), np.sin(course), 0.0])
    claims.p[group] += np.einsum("nji,j->ni", motion.attitude(claims.before[group]), shift)
    claims.what[group] = SHIFTED


def _between(motion: Motion, before: FloatArray, after: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pose of the body at ``after`` seen from the body at ``before``."""
    R_t = np.swapaxes(motion.attitude(before), 1, 2)
    p = (R_t @ (motion.position(after) - motion.position(before))[:, :, None])[..., 0]
    return R_t @ motion.attitude(after), p


def _stream(motion: Motion, claims: _Claims, model: RelativePoseNoise, noise: Noise) -> RelativePoses:
    """The claims with noise, T Exp(d), in the order of their later moments."""
    N = len(claims.after)
    sigmas = np.repeat([np.radians(model.sigma_deg), model.sigma], 3)
    d = noise.normal(1.0, (N, 6)) * sigmas
    p = claims.p + (claims.R @ d[:, 3:, None])[..., 0]
    rotvec = (Rotation.from_matrix(claims.R) * Rotation.from_rotvec(d[:, :3])).as_rotvec()
    offset = model.rig.time_offset_ns
    return RelativePoses(
        from_seconds(claims.after, motion.start_ns) - offset,
        from_ns=from_seconds(claims.before, motion.start_ns) - offset,
        p=p,
        rotvec=rotvec,
        cov=np.tile(np.diag(sigmas**2), (N, 1, 1)),
        accepted=np.ones(N, dtype=np.bool_),
        reason=claims.what.astype(str),
        inliers=np.full(N, 100, dtype=np.int64),
    )
