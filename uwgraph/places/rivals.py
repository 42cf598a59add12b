"""Whether another motion explains the matches of two images as well: tiles and ripples shifted by one period."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from uwgraph.places.matching import Matches
from uwgraph.places.view import View
from uwgraph.types import BoolArray

SHARE: Final = 0.5
"""A rival needs this part of the points that the motion explains."""
FEWEST: Final = 10
"""Fewer points agree by chance."""
REACH_PX: Final = 3.0


def rival(a: View, b: View, matches: Matches, agreeing: BoolArray) -> int:
    """How many matches that do not agree with the motion agree with another one; 0 when that is no rival.

    A shift of a flat pattern by its period is a homography. The count is held against that of the motion, for all
    mutual matches and for the distinct ones apart.
    """
    strongest = 0
    for group in (np.ones(len(matches), np.bool_), matches.distinct):
        rest = np.flatnonzero(group & ~agreeing)
        if len(rest) < FEWEST:
            continue
        uv_a, uv_b = a.features.uv[matches.a[rest]], b.features.uv[matches.b[rest]]
        cv2.setRNGSeed(0)
        _, mask = cv2.findHomography(uv_a, uv_b, cv2.USAC_MAGSAC, REACH_PX, None, 2000, 0.999)
        count = 0 if mask is None else int(mask.sum())
        if count >= max(FEWEST, SHARE * (group & agreeing).sum()):
            strongest = max(strongest, count)
    return strongest
