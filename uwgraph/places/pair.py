"""Two views, one motion: by places where two cameras see enough of them, else by a plane and what stands out of it."""

from __future__ import annotations

import numpy as np

from uwgraph.places.aids import Aids
from uwgraph.places.matching import match
from uwgraph.places.motion import CONTRADICTION, TURNS_OTHERWISE, Motion, failed
from uwgraph.places.rivals import rival
from uwgraph.places.stereo import stereo_motion
from uwgraph.places.twoview import PairSettings, two_view_motion
from uwgraph.places.view import View


def pair_motion(a: View, b: View, aids: Aids | None = None, settings: PairSettings | None = None) -> Motion:
    """The motion of the body from view a to view b; not accepted, with the reason, where there is none to be sure of.

    Parameters
    ----------
    a, b : View
        The earlier and the later image of one camera; with places where there is a second one (:mod:`stereo`).
    aids : Aids, optional
        What else is known of the pair.
    settings : PairSettings, optional
        When two images count as showing the same thing.
    """
    aids, settings = aids or Aids(), settings or PairSettings()
    matches = match(a, b)
    motion = failed("no places")
    if a.points is not None and b.points is not None:
        placed = np.isfinite(a.points[matches.a, 0]) & np.isfinite(b.points[matches.b, 0])
        motion = stereo_motion(a, b, matches.select(placed), aids, settings.min_inliers)
        matches = matches.select(placed) if motion.accepted else matches
    if not motion.accepted:
        motion = two_view_motion(a, b, matches, aids, settings)
    if not motion.accepted or motion.geometry is None:
        return motion
    if np.abs(aids.of_rotation(motion.geometry.R)).max(initial=0.0) > CONTRADICTION:
        return motion.refused(TURNS_OTHERWISE)
    others = rival(a, b, matches, np.isin(matches.a, motion.seen_a))
    if others:
        return motion.refused(f"ambiguous: {others} points agree with another motion, {motion.inliers} with this one")
    return motion
