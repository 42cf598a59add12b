"""The dive in memory: an origin, a rig and typed streams, any of which may be missing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from uwgraph.dive.rig import Rig
from uwgraph.types import (
    Altitude,
    Depth,
    Dvl,
    Fixes,
    Gravity,
    Heading,
    Images,
    Imu,
    Origin,
    Reference,
    RelativePoses,
    Stream,
    Sun,
)

STREAM_TYPES: Mapping[str, type[Stream]] = {
    "imu": Imu,
    "dvl": Dvl,
    "depth": Depth,
    "fixes": Fixes,
    "heading": Heading,
    "sun": Sun,
    "gravity": Gravity,
    "altitude": Altitude,
    "odometry": RelativePoses,
    "closures": RelativePoses,
    "reference": Reference,
}


@dataclass(frozen=True, eq=False)
class Dive:
    """One dive.

    Stamps are as logged; the rig's ``time_offset_s`` have not been applied (:func:`uwgraph.graph.prepare` does it).
    """

    origin: Origin
    rig: Rig = field(default_factory=Rig)
    imu: Imu | None = None
    dvl: Dvl | None = None
    depth: Depth | None = None
    fixes: Fixes | None = None
    heading: Heading | None = None
    sun: Sun | None = None
    gravity: Gravity | None = None
    altitude: Altitude | None = None
    odometry: RelativePoses | None = None
    """Visual odometry: from one image to the next."""
    closures: RelativePoses | None = None
    """Places seen again."""
    reference: Reference | None = None
    images: Mapping[str, Images] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Where the data came from and what was done to it: plain YAML values."""

    def streams(self) -> Iterator[tuple[str, Stream]]:
        """Name and content of every stream that is there (images apart)."""
        for name in STREAM_TYPES:
            stream = getattr(self, name)
            if stream is not None:
                yield name, stream
