"""Whether the filter or a sighting is wrong: the places that were recognised lately vote.

Every place has one vote, however often it was seen: one that looks like another place would win by staying in view. It
is against the filter if most of its last sightings did not fit, and two at least: one good sighting in a hundred is
beyond the gate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from uwgraph.types import FloatArray

VOTERS = 8
SIGHTINGS = 4
"""Of one place, that make its vote."""
AGREEING = 3
"""Places that have to imply the same position before a filter believes that it is lost."""


@dataclass(frozen=True, eq=False)
class Vote:
    """Of one place."""

    off: FloatArray
    """How far the vehicle is from where its last sighting puts it [m], shape (3,)."""
    fits: tuple[bool, ...] = ()
    """Whether its last sightings fitted."""

    @property
    def against(self) -> bool:
        misfits = self.fits.count(False)
        return misfits >= 2 and 2 * misfits > len(self.fits)


@dataclass(frozen=True, eq=False)
class Votes:
    """Of the places recognised lately, by label, the latest last."""

    cast: Mapping[int, Vote] = field(default_factory=dict)

    def after(self, label: int, fits: bool, off: FloatArray) -> Votes:
        """With one more sighting."""
        before = self.cast.get(label, Vote(off))
        others = [(other, vote) for other, vote in self.cast.items() if other != label]
        vote = Vote(off, (*before.fits, fits)[-SIGHTINGS:])
        return Votes(dict([*others, (label, vote)][-VOTERS:]))

    def trusts(self, label: int) -> bool:
        """Whether a place fitted at least once lately: then it is itself, and not another that looks like it."""
        return any(self.cast[label].fits)

    @property
    def doubted(self) -> bool:
        """Whether most places speak against the filter."""
        against = sum(vote.against for vote in self.cast.values())
        return 2 * against > max(len(self.cast), VOTERS // 2)

    def agree(self, off: FloatArray, radius_m: float) -> bool:
        """Whether enough of those that speak against it put the vehicle where this displacement does."""
        near = [v for v in self.cast.values() if v.against and np.linalg.norm(v.off - off) <= radius_m]
        return len(near) >= AGREEING
