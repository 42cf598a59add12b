"""Stamps of every stream: order, rate, gaps, jitter, stretched clocks, and the time they share with the IMU."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uwgraph.dive.checks.finding import Finding
from uwgraph.dive.model import Dive
from uwgraph.dive.timing import unstretch_stream
from uwgraph.dive.validate import SHARED_STAMPS
from uwgraph.types import FloatArray, Stream

MAX_IMU_GAP_S = 1.0
"""Nothing carries the attitude across a longer gap."""
GAP_PERIODS = 5.0
IRREGULAR = ("fixes", "sun", "gravity", "odometry", "closures")
"""Streams that come when they can."""
JITTER = 0.2
OVERLAP = 0.9


def check_stamps(dive: Dive) -> Iterator[Finding]:
    """Every stream's clock by itself."""
    for name, stream in dive.streams():
        if len(stream) < 2:
            yield Finding("warning", name, "rate", f"{len(stream)} samples", "leave the stream out", len(stream), 2)
            continue
        step_s = np.diff(stream.t_ns) * 1e-9
        period = float(np.median(step_s))
        if wrong := list(_order(name, step_s)):
            yield from wrong
            continue
        yield Finding("info", name, "rate", f"{len(stream)} samples at {1 / period:.4g} Hz", value=1 / period)
        yield from _gaps(dive, name, step_s, period)
        yield from _jitter(name, step_s, period)
        yield from _stretch(name, stream)
        yield from _overlap(dive, name, stream)


def _order(name: str, step_s: FloatArray) -> Iterator[Finding]:
    backward, repeated = int((step_s < 0).sum()), int((step_s == 0).sum())
    if backward:
        row = int(np.argmax(step_s < 0)) + 1
        yield Finding(
            "error",
            name,
            "order",
            f"time runs backward {backward} times, first after row {row}",
            "sort the rows if they were only shuffled; cut the recording where the clock was set",
            backward,
            0,
        )
    if repeated and name not in SHARED_STAMPS:
        row = int(np.argmax(step_s == 0)) + 1
        yield Finding(
            "error",
            name,
            "order",
            f"{repeated} stamps repeat, first row {row}",
            "remove the repeated rows",
            repeated,
            0,
        )


def _gaps(dive: Dive, name: str, step_s: FloatArray, period: float) -> Iterator[Finding]:
    longest, row = float(step_s.max()), int(step_s.argmax()) + 1
    if name in IRREGULAR:
        yield Finding("info", name, "gaps", f"longest pause {longest:.4g} s, after row {row}", value=longest)
        return
    limit = GAP_PERIODS * period
    if name == "dvl":
        limit = max(limit, dive.rig.dvl.max_gap_s)
    if name == "imu" and longest > MAX_IMU_GAP_S:
        remedy = "cut the recording into two dives there: nothing carries the attitude across"
        yield Finding(
            "error", name, "gaps", f"no sample for {longest:.4g} s after row {row}", remedy, longest, MAX_IMU_GAP_S
        )
    elif longest > limit:
        count = int((step_s > limit).sum())
        message = f"{count} gaps longer than {limit:.3g} s, the longest {longest:.4g} s after row {row}"
        yield Finding("warning", name, "gaps", message, "look for lost samples in the log", longest, limit)
    else:
        yield Finding("ok", name, "gaps", f"longest step {longest:.4g} s", value=longest, limit=limit)


def _jitter(name: str, step_s: FloatArray, period: float) -> Iterator[Finding]:
    if name in IRREGULAR or period <= 0:
        return
    jitter = float(1.4826 * np.median(np.abs(step_s - period)) / period)
    if jitter > JITTER:
        remedy = "stamp samples when they are taken, not when they arrive; or smooth the stamps"
        yield Finding("warning", name, "jitter", f"steps scatter by {jitter:.0%} of the period", remedy, jitter, JITTER)
    else:
        yield Finding("ok", name, "jitter", f"steps scatter by {jitter:.2%} of the period", value=jitter, limit=JITTER)


def _stretch(name: str, stream: Stream) -> Iterator[Finding]:
    _, report = unstretch_stream(stream)
    if report is None:
        yield Finding("ok", name, "stretch", "stamps are not stretched")
        return
    message = (
        f"stamps are linspace with both ends: {report.stated_period_s:.8g} s apart for {report.true_period_s:g} s, "
        f"{report.ppm:.0f} ppm fast, {report.drift_s:.3g} s at the end"
    )
    remedy = "uwgraph.dive.timing.align_clocks (import does it) rewrites them"
    yield Finding("warning", name, "stretch", message, remedy, report.ppm, 0)


def _overlap(dive: Dive, name: str, stream: Stream) -> Iterator[Finding]:
    imu = dive.imu
    if name == "imu" or imu is None or len(imu) < 2:
        return
    inside = float(np.mean((stream.t_ns >= imu.t_ns[0]) & (stream.t_ns <= imu.t_ns[-1])))
    if inside == 0:
        remedy = "are both clocks UTC? check time zones, leap seconds (GPS time) and the start of the recording"
        yield Finding("error", name, "overlap", "no sample lies within the IMU's recording", remedy, inside, OVERLAP)
    elif inside < OVERLAP:
        message = f"{inside:.0%} of the samples lie within the IMU's recording"
        yield Finding("warning", name, "overlap", message, "the rest cannot be used", inside, OVERLAP)
    else:
        yield Finding("ok", name, "overlap", f"{inside:.0%} within the IMU's recording", value=inside, limit=OVERLAP)
