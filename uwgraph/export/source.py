"""What is exported, from a result or from a dive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from uwgraph.dive.model import Dive
from uwgraph.errors import DataError
from uwgraph.export.track import Track, track_of_reference
from uwgraph.types import Fixes

StreamName = Literal["reference", "fixes"]


@dataclass(frozen=True, eq=False)
class Source:
    """What is exported: any of the three may be missing."""

    name: str
    """For titles: the folder that it came from."""
    track: Track | None = None
    fixes: Fixes | None = None
    """On the dive's clock; drawn as points on maps, without a track the points alone."""
    dive: Dive | None = None
    """Its sensors go into MCAP, its IMU into a folder of EuRoC."""


def source_of_dive(dive: Dive, name: str, stream: StreamName | None = "reference") -> Source:
    """One positioned stream of a dive, or (None) the whole dive with whatever it has.

    Raises
    ------
    DataError
        When the dive does not have the stream.
    """
    offset = dive.rig.fixes.time_offset_ns
    fixes = replace(dive.fixes, t_ns=dive.fixes.t_ns + offset) if dive.fixes is not None else None
    if stream == "fixes":
        if fixes is None:
            raise DataError("the dive has no fixes", where=name, remedy="export its reference, or smooth it")
        return Source(name, fixes=fixes)
    reference = dive.reference
    nowhere = reference is None or len(reference) < 2 or not np.isfinite(reference.lat).any()
    track = None if stream is None and nowhere else track_of_reference(dive)
    return Source(name, track, fixes, dive)
