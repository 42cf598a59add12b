"""Clocks: stretched stamps, the offset of every sensor against the IMU, and a dive put on one clock.

A DVL offset of one second costs metres in turns, and logs seldom say it. The offsets are found from the motion alone:

* DVL: R_ib v - int(f) dt is slow (initial velocity, gravity, biases) when both are of the same instant;
* depth: depth minus the specific force integrated twice is slow;
* fixes: position minus the DVL's (or the IMU's) own displacement is slow;
* heading: heading minus the gyro's own heading is slow;
* sun and attitude reference: directions fixed in space stay fixed when turned by the gyro.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from uwgraph.dive.clock_fit import ClockOffset, fit_clock
from uwgraph.dive.clock_models import COMPARISONS
from uwgraph.dive.inertial_track import InertialTrack, inertial_track
from uwgraph.dive.model import Dive
from uwgraph.dive.reference_point import ReferencePoint, depth_is_copied, reference_point
from uwgraph.errors import DataError
from uwgraph.types import FloatArray, Stream

S = TypeVar("S", bound=Stream)

MAX_OFFSET_S = 3.0
MAX_SIGMA_S = 0.1
MIN_SAMPLES = 100
"""Shorter streams are not looked at for stretched stamps: 25 samples at 24 Hz would pass for 25 Hz."""
SIGNIFICANT = 5.0
"""An offset is applied when it is this many sigmas from zero."""


@dataclass(frozen=True)
class StretchReport:
    """Stamps made as ``linspace(start, end, n)`` with both ends included, where the end belongs to sample n + 1."""

    stated_period_s: float
    true_period_s: float
    n: int

    @property
    def ppm(self) -> float:
        """By how much the stamps run too fast."""
        return (self.stated_period_s / self.true_period_s - 1.0) * 1e6

    @property
    def drift_s(self) -> float:
        """Error of the last stamp: one true period."""
        return (self.n - 1) * (self.stated_period_s - self.true_period_s)


def unstretch(t_s: FloatArray) -> tuple[FloatArray, StretchReport | None]:
    """Undo stamps that were written as ``linspace(0, T, n)``, endpoint included.

    Such stamps are uniform to rounding, and T/n (or n/T) is a number of one or two digits while T/(n-1) needs more. An
    honest uniform clock has the round spacing itself, an honest jittered one is not uniform: both come back as they
    are, with None. A stream cut after it was stamped is not recognised; :func:`clock_offset` then shows the rate.
    """
    t = np.asarray(t_s, dtype=np.float64) - t_s[:1]
    n = len(t)
    if n < MIN_SAMPLES or t[-1] <= 0:
        return t_s, None
    stated, true = t[-1] / (n - 1), t[-1] / n
    rounding = float(np.max(np.abs(t - stated * np.arange(n)))) + 1e-9
    tolerance = 2 * rounding / n
    digits = _digits(true, tolerance)
    if rounding > 5e-3 * stated or digits > 2 or _digits(stated, tolerance) <= digits:
        return t_s, None
    period = min(_rounded(true, digits), key=lambda candidate: abs(candidate - true))
    return t_s[0] + period * np.arange(n), StretchReport(float(stated), period, n)


def unstretch_stream(stream: S) -> tuple[S, StretchReport | None]:
    """:func:`unstretch` for a stream; its first stamp stays."""
    fixed, report = unstretch(stream.t_s)
    if report is None:
        return stream, None
    return replace(stream, t_ns=stream.t_ns[:1] + np.rint(fixed * 1e9).astype(np.int64)), report


def _rounded(period: float, digits: int) -> tuple[float, float]:
    """The nearest period, and that of the nearest rate, of so many significant digits."""
    return float(f"{period:.{digits - 1}e}"), 1.0 / float(f"{1.0 / period:.{digits - 1}e}")


def _digits(period: float, tolerance: float) -> int:
    """Significant digits that the period, or its rate, needs: few for what people choose."""
    return next((d for d in range(1, 9) if min(abs(p - period) for p in _rounded(period, d)) <= tolerance), 9)


def clock_offset(
    dive: Dive, sensor: str, *, max_offset_s: float = MAX_OFFSET_S, track: InertialTrack | None = None
) -> ClockOffset:
    """Offset and rate of a sensor's clock against the IMU's, from the motion.

    Parameters
    ----------
    sensor : ``dvl``, ``depth``, ``fixes``, ``heading``, ``sun`` or ``reference`` (its attitude only).
    max_offset_s : offsets are sought within +- this.
    track : the IMU's track, when it is already at hand.

    Returns
    -------
    ClockOffset
        What must be added to the stamps *as logged* (it replaces ``rig.*.time_offset_s``); NaN when the motion is too
        quiet to tell. For fixes the DVL's present offset in the rig is believed.

    Raises
    ------
    DataError
        When the dive has no IMU, or not that sensor.
    """
    stream: Stream | None = getattr(dive, sensor, None)
    if dive.imu is None or stream is None or len(stream) == 0:
        missing = "imu" if dive.imu is None else sensor
        raise DataError(f"the dive has no {missing} stream", where=missing, remedy="a clock offset needs both streams")
    comparison = COMPARISONS[sensor](dive, track or inertial_track(dive.imu, dive.rig.imu))
    return fit_clock(sensor, comparison, max_offset_s, MAX_SIGMA_S)


@dataclass(frozen=True)
class ClockReport:
    """What :func:`align_clocks` found and did."""

    stretched: Mapping[str, StretchReport] = field(default_factory=dict)
    """Streams whose stamps were unstretched."""
    offsets: tuple[ClockOffset, ...] = ()
    """One for every sensor that was tried, observable or not."""
    point: ReferencePoint | None = None
    """Where on the vehicle the reference is."""
    notes: tuple[str, ...] = ()
    """What was done, in words."""


def align_clocks(dive: Dive, *, max_offset_s: float = MAX_OFFSET_S) -> tuple[Dive, ClockReport]:
    """Put a dive on one clock: the IMU's.

    Stretched stamps are rewritten; every offset that the motion shows goes into the rig (``time_offset_s``), and the
    point of the vehicle that the reference is of into ``rig.reference.translation_m``. Sensors are compared with the
    IMU only. The reference is used to learn its own clock and point, which only judge a solution; a depth stream that
    is a copy of the reference's is of the same point, and that lever arm is all that leaks.
    """
    dive, stretched = _unstretched(dive)
    notes = [f"{name}: stamps were stretched by {r.ppm:.0f} ppm ({r.drift_s:.3f} s)" for name, r in stretched.items()]
    if dive.imu is None:
        return dive, ClockReport(stretched, (), None, (*notes, "no IMU, no common clock"))
    track = inertial_track(dive.imu, dive.rig.imu)
    offsets: list[ClockOffset] = []
    for sensor in COMPARISONS:
        if getattr(dive, sensor) is None:
            continue
        found = clock_offset(dive, sensor, max_offset_s=max_offset_s, track=track)
        offsets.append(found)
        if not found.observable:
            notes.append(f"{sensor}: clock offset {found.how}")
        elif abs(found.offset_s) > SIGNIFICANT * found.sigma_s:
            dive = with_mounting(dive, sensor, time_offset_s=round(found.offset_s, 6))
            notes.append(f"{sensor}: time_offset_s = {found.offset_s:.3f} +- {found.sigma_s:.3f} from {found.how}")
    point = reference_point(dive, track)
    if point is not None:
        place = tuple(round(float(x), 3) for x in point.l_b)
        found_by = "from its velocity against the DVL's in turns"
        for sensor in ("reference", "depth") if depth_is_copied(dive) else ("reference",):
            dive = with_mounting(dive, sensor, translation_m=place)
            notes.append(f"{sensor}: translation_m = {place} {found_by}")
    return dive, ClockReport(stretched, tuple(offsets), point, tuple(notes))


def with_mounting(dive: Dive, sensor: str, **update: object) -> Dive:
    """The dive with some settings of one sensor in its rig replaced."""
    part = getattr(dive.rig, sensor)
    changed = type(part).model_validate({**part.model_dump(), **update})
    return replace(dive, rig=dive.rig.model_copy(update={sensor: changed}))


def _unstretched(dive: Dive) -> tuple[Dive, dict[str, StretchReport]]:
    fixed: dict[str, Stream] = {}
    reports: dict[str, StretchReport] = {}
    for name, stream in dive.streams():
        repaired, report = unstretch_stream(stream)
        if report is not None:
            fixed[name], reports[name] = repaired, report
    return replace(dive, **fixed), reports  # type: ignore[arg-type]
