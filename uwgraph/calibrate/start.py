"""Where calibration starts: the common rig, and each dive's clocks as its motion shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from uwgraph.calibrate.parameters import Parameter, with_values
from uwgraph.dive import Dive
from uwgraph.dive.clock_fit import ClockOffset
from uwgraph.dive.clock_models import COMPARISONS
from uwgraph.dive.inertial_track import inertial_track
from uwgraph.dive.rig import Rig
from uwgraph.dive.rigfile import apply_rig
from uwgraph.dive.timing import clock_offset, with_mounting

BY_CORRELATION: Final = ("dvl", "depth")
"""Sensors as fine as the smoothed motion itself. In a motion too quiet for the correlation, the noise of the motion
may pass for motion in the graph too: a straight hour then tells a clock offset, and a wrong one."""


def started(dive: Dive, base: Rig, parameters: Sequence[Parameter]) -> tuple[Dive, Mapping[str, ClockOffset]]:
    """The dive with the common rig's numbers, and the clock offsets that are free found by correlation.

    Noise, and whatever is not calibrated, stays as the dive's own rig has it. A motion too quiet for the correlation
    leaves the dive's own offset. The DVL comes first, since fixes are compared with it.
    """
    common = [p for p in parameters if not p.of_a_clock]
    dive = apply_rig(dive, with_values(dive.rig, common, [p.value(base) for p in common]), keep_clocks=True)
    clocks = [s for s in COMPARISONS if any(p.sensor == s and p.of_a_clock for p in parameters)]
    if dive.imu is None or not clocks:
        return dive, {}
    track = inertial_track(dive.imu, dive.rig.imu)
    found: dict[str, ClockOffset] = {}
    for sensor in clocks:
        stream = getattr(dive, sensor)
        if stream is None or not len(stream):
            continue
        found[sensor] = clock_offset(dive, sensor, track=track)
        if found[sensor].observable:
            dive = with_mounting(dive, sensor, time_offset_s=round(found[sensor].offset_s, 6))
    return dive, found


def quiet_clocks(parameters: Sequence[Parameter], correlations: Mapping[str, ClockOffset]) -> list[int]:
    """Clock parameters that correlation does not find, of sensors :data:`BY_CORRELATION`."""
    quiet = [sensor for sensor in BY_CORRELATION if sensor in correlations and not correlations[sensor].observable]
    return [i for i, p in enumerate(parameters) if p.of_a_clock and p.sensor in quiet]
