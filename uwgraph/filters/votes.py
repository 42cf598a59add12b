"""Whether the filter or a sighting is wrong: the places that were recognised lately vote.

Every place has one vote, however often it was seen: one that looks like another place would win by staying in view. It
is against the filter after two sightings in a row that did not fit, so that the one good sighting in a hundred beyond
the gate does not count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from uwgraph.types import FloatArray

VOTERS = 8
AGREEING = 3
"""Places that have to imply the same position before a filter believes that it is lost."""


@dataclass(frozen=True, eq=False)
class Vote:
    """Of one place."""

    off: FloatArray
    """How far the vehicle is from where its last sighting puts it [m], shape (3,)."""
    misfits: int = 0
    """Sightings in a row that did not fit."""

    @property
    def against(self) -> bool:
        return self.misfits >= 2


@dataclass(frozen=True, eq=False)
class Votes:
    """Of the places recognised lately, by label, the latest last."""

    cast: Mapping[int, Vote] = field(default_factory=dict)

    def after(self, label: int, fits: bool, off: FloatArray) -> Votes:
        """With one more sighting."""
        before = self.cast.get(label, Vote(off))
        others = [(other, vote) for other, vote in self.cast.items() if other != label]
        vote = Vote(off, 0 if fits else before.misfits + 1)
        return Votes(dict([*others, (label, vote)][-VOTERS:]))

    @property
    def doubted(self) -> bool:
        """Whether most places speak against the filter."""
        against = sum(vote.against for vote in self.cast.values())
        return 2 * against > max(len(self.cast), VOTERS // 2)

    def agree(self, off: FloatArray, radius_m: float) -> bool:
        """Whether enough of those that speak against it put the vehicle where this displacement does."""
        near = [v for v in self.cast.values() if v.against and np.linalg.norm(v.off - off) <= radius_m]
        return len(near) >= AGREEING
