"""Relative poses between keyframes: from the moments when a camera saw them to the nearest keyframes.

Over less than half a keyframe period the track is good: its gyro turns, its velocity moves, and what that leaves
unsure goes into the covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from factors.noise import gaussian, robust
from uwgraph.graph.keyframes import inside, nearest_keyframe
from uwgraph.graph.prepare import UNMEASURED, Prepared
from uwgraph.graph.se3 import Poses, moved
from uwgraph.graph.track import Track
from uwgraph.types import FloatArray, RelativePoses, TimeArray

IndexArray = NDArray[np.intp]

UNAIDED_SPEED_SIGMA = 0.2
"""m/s, how well the track knows its velocity where there is no DVL."""


@dataclass(frozen=True, eq=False)
class BetweenKeyframes:
    """Poses of keyframe j seen from keyframe i, i < j."""

    i: IndexArray
    """Shape (M,)."""
    j: IndexArray
    """Shape (M,)."""
    T: Poses
    cov: FloatArray
    """Covariance in the tangent at T, shape (M, 6, 6)."""
    sample: IndexArray
    """Which sample of the stream each comes from (the last one, where several were joined), shape (M,)."""

    def __len__(self) -> int:
        return len(self.i)

    def select(self, index: Any) -> BetweenKeyframes:
        """Those that a mask or an index array picks."""
        return BetweenKeyframes(self.i[index], self.j[index], self.T[index], self.cov[index], self.sample[index])

    def factors(self, loss: gtsam.noiseModel.mEstimator.Base | None = None) -> list[gtsam.NonlinearFactor]:
        """Native factors."""
        S = sqrt_information(self.cov)
        return [
            gtsam.BetweenFactorPose3(X(i), X(j), gtsam.Pose3(gtsam.Rot3(R), p), robust(gaussian(s), loss))
            for i, j, R, p, s in zip(self.i.tolist(), self.j.tolist(), self.T.R, self.T.p, S, strict=True)
        ]


def sqrt_information(cov: FloatArray) -> FloatArray:
    """S with S^T S the information, exactly zero along what was not measured, shape (M, 6, 6)."""
    variance, Q = np.linalg.eigh(cov)
    scale = np.where(variance < UNMEASURED, 1.0 / np.sqrt(variance), 0.0)
    S: FloatArray = scale[:, :, None] * np.swapaxes(Q, 1, 2)
    return S


def closures_at_keyframes(stream: RelativePoses, keyframes: TimeArray, track: Track) -> BetweenKeyframes:
    """Every closure between the keyframes nearest to its two moments; without those that both have nearest."""
    sample = np.flatnonzero(inside(keyframes, stream.from_ns) & inside(keyframes, stream.t_ns))
    between = _at_keyframes(stream.select(sample), keyframes, track)
    between = BetweenKeyframes(between.i, between.j, between.T, between.cov, sample)
    return between.select(between.i < between.j)


def odometry_at_keyframes(stream: RelativePoses, keyframes: TimeArray, track: Track) -> BetweenKeyframes:
    """Visual odometry between keyframes: finer steps are joined, from the moment nearest to a keyframe to the next."""
    stream = stream.select(inside(keyframes, stream.from_ns) & inside(keyframes, stream.t_ns))
    stream = stream.select(np.argsort(stream.from_ns, kind="stable"))
    parts = [_joined(stream.select(chain), keyframes) for chain in _chains(stream)]
    joined = _concatenated([part for part in parts if len(part)], stream)
    between = _at_keyframes(joined, keyframes, track)
    return between.select(between.i < between.j)


def _at_keyframes(stream: RelativePoses, keyframes: TimeArray, track: Track) -> BetweenKeyframes:
    """T_ij = T_ia T_ab T_bj, with a and b the moments and i and j their keyframes."""
    i, j = nearest_keyframe(keyframes, stream.from_ns), nearest_keyframe(keyframes, stream.t_ns)
    a, b = _poses(track, stream.from_ns), _poses(track, stream.t_ns)
    T_ia, T_bj = _poses(track, keyframes[i]).to(a), b.to(_poses(track, keyframes[j]))
    T_aj = Poses.measured(stream) @ T_bj
    cov = (
        moved(_way_covariance(track.prepared, keyframes[i] - stream.from_ns), T_aj.inverse().adjoint())
        + moved(stream.cov, T_bj.inverse().adjoint())
        + _way_covariance(track.prepared, keyframes[j] - stream.t_ns)
    )
    return BetweenKeyframes(i, j, T_ia @ T_aj, cov, np.arange(len(stream)))


def _poses(track: Track, t_ns: TimeArray) -> Poses:
    return Poses(track.rotation_at(t_ns), track.position_at(t_ns))


def _way_covariance(prepared: Prepared, dt_ns: TimeArray) -> FloatArray:
    """Covariance of the track's own motion over short times, shape (M, 6, 6)."""
    rig = prepared.dive.rig
    dt = np.abs(dt_ns) * 1e-9
    speed = UNAIDED_SPEED_SIGMA if prepared.dvl is None else rig.dvl.sigma
    turn, way = rig.imu.gyro_noise_density**2 * dt, (speed * dt) ** 2
    cov: FloatArray = np.repeat(np.stack([turn, way], axis=-1), 3, axis=-1)[:, :, None] * np.eye(6)
    return cov


def _chains(stream: RelativePoses) -> list[IndexArray]:
    """Samples that follow each other without a gap, each beginning where the one before it ends."""
    breaks = np.flatnonzero(stream.from_ns[1:] != stream.t_ns[:-1]) + 1
    return np.split(np.arange(len(stream)), breaks)


def _joined(chain: RelativePoses, keyframes: TimeArray) -> RelativePoses:
    """The steps of a chain joined between its moments that are nearest to a keyframe, one moment a keyframe."""
    moments = np.append(chain.from_ns, chain.t_ns[-1:])
    k = nearest_keyframe(keyframes, moments)
    far = np.abs(moments - keyframes[k])
    order = np.lexsort((far, k))
    _, first = np.unique(k[order], return_index=True)
    chosen = np.sort(order[first])
    return _concatenated([_compose(chain.select(slice(a, b))) for a, b in pairwise(chosen.tolist())], chain)


def _compose(steps: RelativePoses) -> RelativePoses:
    """Steps that follow each other as one."""
    if len(steps) == 1:
        return steps
    each = Poses.measured(steps)
    T, cov = each[:1], steps.cov[:1]
    for n in range(1, len(steps)):
        T = T @ each[n : n + 1]
        cov = moved(cov, each[n : n + 1].inverse().adjoint()) + steps.cov[n : n + 1]
    last = steps.select(slice(len(steps) - 1, None))
    rotvec = T.log()[:, :3]
    return RelativePoses(
        last.t_ns, steps.from_ns[:1], T.p, rotvec, cov, last.accepted, last.reason, steps.inliers.min(keepdims=True)
    )


def _concatenated(parts: Sequence[RelativePoses], like: RelativePoses) -> RelativePoses:
    """The parts as one stream."""
    if not parts:
        return like.select(slice(0, 0))
    return RelativePoses(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(like)})
