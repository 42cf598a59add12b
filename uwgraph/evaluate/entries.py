"""Several estimators on one dive, each judged by the same ruler."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from uwgraph.dive.model import Dive
from uwgraph.evaluate.judge import Judged
from uwgraph.types import Innovations


@dataclass(frozen=True, eq=False)
class Entry:
    """What one estimator made of a dive."""

    name: str
    """As on the command line: dr, eskf, rts, ukf, aukf, smooth."""
    title: str
    """In words."""
    judged: Judged
    """At the same stamps for every estimator of a contest; ``judged.metrics`` has runtime and memory too."""
    innovations: Innovations | None = None
    """None for estimators that have none."""


@dataclass(frozen=True, eq=False)
class Contest:
    """The estimators' entries on one dive."""

    dive: Dive
    title: str
    """Name of the dive."""
    entries: tuple[Entry, ...]
    """In the order asked for."""
    failed: Mapping[str, str] = field(default_factory=dict)
    """Estimators that gave no result, and why."""
