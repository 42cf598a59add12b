"""What a check says, and what it is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from uwgraph.dive.inertial_track import InertialTrack
from uwgraph.dive.model import Dive

Level = Literal["error", "warning", "info", "ok"]


@dataclass(frozen=True)
class Finding:
    """One result of one check on one stream."""

    level: Level
    """error: not usable as it is; warning: usable, but the result suffers; info: good to know; ok: nothing wrong."""
    stream: str
    check: str
    message: str
    remedy: str = ""
    value: float = np.nan
    """The figure that was judged; NaN where there is none."""
    limit: float = np.nan
    """What it was judged against."""


@dataclass(frozen=True, eq=False)
class Subject:
    """The dive under test and the IMU's track, which is None when the IMU cannot be integrated."""

    dive: Dive
    track: InertialTrack | None
