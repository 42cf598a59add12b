"""Clock of every sensor against the IMU's, from the motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uwgraph.dive.checks.finding import Finding, Subject
from uwgraph.dive.clock_models import COMPARISONS
from uwgraph.dive.timing import clock_offset

OFFSET_S = 0.02
SIGMAS = 5.0
RATE_PPM = 300.0


def check_clocks(subject: Subject) -> Iterator[Finding]:
    """Offsets that the rig does not know, and clocks that run at another rate."""
    dive, track = subject.dive, subject.track
    if track is None:
        return
    for sensor in COMPARISONS:
        stream = getattr(dive, sensor)
        if stream is None or len(stream) == 0:
            continue
        found = clock_offset(dive, sensor, track=track)
        if not found.observable:
            yield Finding("info", sensor, "clock", f"offset against the IMU {found.how}")
            continue
        known = getattr(dive.rig, sensor).time_offset_s
        off = found.offset_s - known
        limit = max(OFFSET_S, SIGMAS * found.sigma_s)
        if abs(off) > limit:
            message = f"{off:+.3f} +- {found.sigma_s:.3f} s against the IMU ({found.how})"
            remedy = f"set rig.{sensor}.time_offset_s to {found.offset_s:.3f}"
            yield Finding("warning", sensor, "clock", message, remedy, off, limit)
        else:
            message = f"{off:+.3f} +- {found.sigma_s:.3f} s against the IMU, the rig's offset applied"
            yield Finding("ok", sensor, "clock", message, value=off, limit=limit)
        limit = max(RATE_PPM, SIGMAS * found.rate_sigma_ppm)
        if np.isfinite(found.rate_ppm) and abs(found.rate_ppm) > limit:
            message = f"gains {found.rate_ppm:+.0f} +- {found.rate_sigma_ppm:.0f} ppm on the IMU's clock"
            remedy = "the stamps are stretched or of another clock: rewrite them before the dive is used"
            yield Finding("warning", sensor, "clock rate", message, remedy, found.rate_ppm, limit)
