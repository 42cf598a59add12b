"""The vehicle's poses at the stamps of images and soundings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.export.track import Track
from uwgraph.graph import resample
from uwgraph.types import BoolArray, FloatArray, Solution, TimeArray


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of the body in n."""

    R_nb: FloatArray
    """Shape (N, 3, 3)."""
    p_n: FloatArray
    """Shape (N, 3), m."""

    def select(self, index: BoolArray | slice) -> Poses:
        """The poses that a mask or a slice picks."""
        return Poses(self.R_nb[index], self.p_n[index])


def poses_at(dive: Dive, track: Track, t_ns: TimeArray) -> tuple[Poses, BoolArray]:
    """The poses at those stamps that lie within the track, and which these are, shape (N,).

    Between the track's poses the dive's IMU turns the attitude and a cubic bends the way.

    Raises
    ------
    DataError
        When the track has fewer than two poses, or the dive no IMU.
    """
    posed = track.select(track.posed)
    if len(posed) < 2:
        raise DataError("the track has fewer than two poses", where=track.name, remedy="smooth the dive")
    within = (t_ns >= posed.t_ns[0]) & (t_ns <= posed.t_ns[-1])
    at = resample(dive, _solution(posed), t_ns[within])
    return Poses(at.R_nb, at.p_n), within


def _solution(track: Track) -> Solution:
    """The states that a track knows; what is left of a bias is spread over the steps between the poses anyway."""
    count = len(track)
    moving = np.gradient(track.p_n, track.t_s, axis=0)
    return Solution(
        origin=track.origin,
        t_ns=track.t_ns,
        R_nb=track.R_nb,
        p_n=track.p_n,
        v_n=np.where(np.isfinite(track.v_n), track.v_n, moving),
        bias_gyro=np.nan_to_num(track.bias_gyro),
        bias_accel=np.nan_to_num(track.bias_accel),
        cov_pose=np.full((count, 6, 6), np.nan),
        cov_v=np.full((count, 3, 3), np.nan),
        cov_bias=np.full((count, 6, 6), np.nan),
    )
