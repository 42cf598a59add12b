"""A dive's solution judged where its reference speaks.

A reference of 1 Hz says little about the attitude between its samples: where the turn rate steps by 8 deg/s, an
interpolation is off by 2 deg. The IMU knows the way between keyframes far better. So the solution is asked at the
reference's own stamps, and the reference is left as it is.

In turns the attitude errors are only as good as the reference's clock: 8 deg/s make 0.16 deg of 20 ms. Where import
fitted that clock to the gyro, and where the reference integrated the same gyro, they tell how well two solutions
agree, not how far either is from the truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uwgraph.dive.body_reference import body_reference
from uwgraph.dive.model import Dive
from uwgraph.evaluate.align import Alignment
from uwgraph.evaluate.metrics import metrics
from uwgraph.types import Reference, Solution, TimeArray


@dataclass(frozen=True, eq=False)
class Judged:
    """What :func:`judge` found."""

    solution: Solution
    """At the stamps it was judged at: the reference's nearest the keyframes."""
    reference: Reference | None
    """On the dive's clock and of the body origin; None where the dive has none."""
    metrics: dict[str, Any]
    """What ``metrics.json`` holds."""


def judge(dive: Dive, solution: Solution, alignment: Alignment = "none") -> Judged:
    """Compare a solution with the reference of its dive; without one only the 1-sigma are told."""
    reference = body_reference(dive)
    if reference is not None:
        from uwgraph.graph import resample  # loads gtsam, which who only exports or imports can do without

        solution = resample(dive, solution, judging_stamps(solution.t_ns, reference.t_ns))
    return Judged(solution, reference, metrics(solution, reference, alignment))


def judging_stamps(keyframes: TimeArray, samples: TimeArray) -> TimeArray:
    """For every keyframe the nearest sample within the solution, each sample once; itself where none is near.

    Near is within one median period of the samples: a keyframe before, after or in a gap of the reference keeps its
    stamp, and counts as not matched.
    """
    inside = samples[(samples >= keyframes[0]) & (samples <= keyframes[-1])]
    if len(inside) < 2:
        return keyframes
    after = np.clip(np.searchsorted(inside, keyframes), 1, len(inside) - 1)
    before_is_nearer = keyframes - inside[after - 1] <= inside[after] - keyframes
    nearest = np.where(before_is_nearer, inside[after - 1], inside[after])
    near = np.abs(nearest - keyframes) <= np.median(np.diff(inside))
    stamps: TimeArray = np.unique(np.where(near, nearest, keyframes))
    return stamps
