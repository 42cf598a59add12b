"""What a dive's other sensors say of any two of its images: rotation, soundings, distance, the vertical.

All of it goes into the graph by itself as well. So what an image pair takes from here is kept loose: it finds the
motion and its scale, and adds little to its certainty.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.inertial_track import InertialTrack, inertial_track
from uwgraph.dive.vertical import vertical
from uwgraph.places.aids import Known, soundings_of
from uwgraph.types import FloatArray, TimeArray

ROTATION_SIGMA: Final = float(np.radians(0.5))
"""rad, least 1-sigma of what is taken from the gyro: far above its noise, since the graph has it too."""
SHORTEST_S, LONGEST_S = 2.0, 60.0
"""The gyro tells the rotation between images not further apart than something between these, by its bias; the DVL the
distance up to the latter."""
LENGTH_SIGMA: Final = 0.05
"""1-sigma of a DVL's distance, parts of it: likewise far above its noise."""


def known_of(dive: Dive, t_ns: TimeArray) -> Known:
    """The aids of any pair among the images at ``t_ns`` (the camera's clock), as far as the dive has them."""
    offset = dive.rig.visual.time_offset_ns
    sounding = None
    if dive.altitude is not None:
        on_our_clock = soundings_of(dive.altitude, dive.rig.altitude)
        sounding = lambda t: on_our_clock(t + offset - dive.rig.altitude.time_offset_ns)  # noqa: E731
    if dive.imu is None:
        return Known(sounding=sounding)
    track = inertial_track(dive.imu, dive.rig.imu)
    start_ns = int(dive.imu.t_ns[0]) + dive.rig.imu.time_offset_ns

    def seconds(times: TimeArray) -> FloatArray:
        return (np.asarray(times) + offset - start_ns).astype(np.float64) * 1e-9

    bias = dive.rig.imu.gyro_bias_sigma
    reach_s = float(np.clip(ROTATION_SIGMA / bias, SHORTEST_S, LONGEST_S))
    return Known(
        rotation=_rotation(track, seconds, reach_s),
        sounding=sounding,
        length=_length(dive, track, seconds) if sounding is None else None,
        down=_down(dive, t_ns, offset),
        rotation_sigma=ROTATION_SIGMA + bias * reach_s,
    )


Seconds = Callable[[TimeArray], FloatArray]


def _rotation(track: InertialTrack, seconds: Seconds, reach_s: float) -> Callable[[int, int], FloatArray | None]:
    def rotation(from_ns: int, t_ns: int) -> FloatArray | None:
        if t_ns - from_ns > reach_s * 1e9:
            return None
        a, b = track.attitude(seconds(np.array([from_ns, t_ns])))
        return np.asarray((a.inv() * b).as_matrix())

    return rotation


def _length(dive: Dive, track: InertialTrack, seconds: Seconds) -> Callable[[int, int], tuple[float, float] | None]:
    """Distance between two moments, from the DVL's velocities turned by the gyro."""
    if dive.dvl is None or not dive.dvl.valid.any():
        return lambda from_ns, t_ns: None
    rig = dive.rig.dvl
    dvl = dive.dvl.select(dive.dvl.valid)
    t = seconds(dvl.t_ns + rig.time_offset_ns - dive.rig.visual.time_offset_ns)
    v_b = rig.scale * dvl.v_s @ rig.R_bs.T - np.cross(track.rate(t), rig.l_b)
    v_i = track.attitude(t).apply(v_b)
    steps = 0.5 * (v_i[1:] + v_i[:-1]) * np.diff(t)[:, None]
    way = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    def length(from_ns: int, t_ns: int) -> tuple[float, float] | None:
        a, b = seconds(np.array([from_ns, t_ns]))
        gaps = np.diff(t[max(np.searchsorted(t, a) - 1, 0) : np.searchsorted(t, b) + 1])
        if b - a > LONGEST_S or a < t[0] or b > t[-1] or gaps.max(initial=0.0) > rig.max_gap_s:
            return None
        gone = float(np.linalg.norm([np.interp(b, t, axis) - np.interp(a, t, axis) for axis in way.T]))
        return gone, LENGTH_SIGMA * gone + rig.sigma * (b - a)

    return length


def _down(dive: Dive, t_ns: TimeArray, offset: int) -> Callable[[int], FloatArray | None]:
    """The vertical at the images' moments."""
    inside = (t_ns + offset >= dive.imu.t_ns[0]) & (t_ns + offset <= dive.imu.t_ns[-1]) if dive.imu else t_ns < 0
    times = t_ns[inside]
    if not len(times):
        return lambda t: None
    down = dict(zip(times.tolist(), -vertical(dive, times + offset).up_b, strict=True))
    return lambda t: down.get(int(t))
