"""Whether two images that look alike show the same place: stricter than odometry, for nothing else vouches for them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from uwgraph.dive.rig import Positive
from uwgraph.places.aids import Aids, Known
from uwgraph.places.motion import CONTRADICTION, NOT_WHERE_SOUNDED, Motion, relative_poses
from uwgraph.places.pair import pair_motion
from uwgraph.places.twoview import PairSettings
from uwgraph.places.view import View
from uwgraph.types import FloatArray, RelativePoses

GRID: Final = 6
"""Cells of an image along either side."""


class VerifySettings(PairSettings):
    """When a place counts as seen again."""

    min_inliers: Annotated[int, Field(ge=8, le=10_000)] = 30
    """Fewer points that agree are no proof."""
    cells: Annotated[int, Field(ge=1, le=GRID * GRID)] = 8
    """Of a grid of 6 by 6 over the image so many must hold points that agree: not one fish, not the vehicle's frame."""
    max_rotation_deg: Positive = 3.0
    """Largest 1-sigma of the rotation about any axis."""
    max_position: Positive = 0.2
    """Largest 1-sigma of the translation, parts of the distance to the floor; for what is metric."""


def verify(a: View, b: View, aids: Aids | None = None, settings: VerifySettings | None = None) -> Motion:
    """The motion of the body from the earlier view to the later, accepted only where it can be relied on.

    Too few matches, another motion that explains them as well (tiles), points in one corner only, contradiction to
    soundings, vertical or gyro, and a motion that is hardly known are refused, with the reason in words.
    """
    aids, settings = aids or Aids(), settings or VerifySettings()
    motion = pair_motion(a, b, aids, settings)
    if not motion.accepted:
        return motion
    reason = (
        _narrow(motion, a, b, settings) or _contradiction(motion, aids, a.camera.l_b) or _uncertain(motion, settings)
    )
    return motion.refused(reason) if reason else motion


def verify_pairs(
    pairs: Iterable[tuple[View, View]], known: Known | None = None, settings: VerifySettings | None = None
) -> RelativePoses:
    """Candidates (earlier, later), each accepted or with the reason why not, as a stream in the order of the later."""
    known = known or Known()
    moments, motions = [], []
    for a, b in pairs:
        moments.append((a.t_ns, b.t_ns))
        motions.append(verify(a, b, known.aids(a.t_ns, b.t_ns), settings))
    return relative_poses(moments, motions)


def _narrow(motion: Motion, a: View, b: View, settings: VerifySettings) -> str | None:
    """Points that agree fill too little of either image."""
    for view, seen in ((a, motion.seen_a), (b, motion.seen_b)):
        cell = np.floor(view.features.uv[seen] / np.array(view.camera.size) * GRID).astype(np.intp)
        filled = len(np.unique(np.clip(cell, 0, GRID - 1), axis=0))
        if filled < settings.cells:
            return f"points agree in {filled} of {GRID * GRID} parts of the image only"
    return None


def _contradiction(motion: Motion, aids: Aids, l_b: FloatArray) -> str | None:
    """What else is known of the pair says no."""
    g = motion.geometry
    if g is None:
        return None
    if g.plane is None or not motion.metric:
        return None
    if np.linalg.norm(aids.of_slope(g.plane)) > CONTRADICTION:
        return "the floor would be too steep"
    if np.abs(aids.of_soundings(g.R, g.c, g.plane, l_b)).max(initial=0.0) > CONTRADICTION:
        return NOT_WHERE_SOUNDED
    return None


def _uncertain(motion: Motion, settings: VerifySettings) -> str | None:
    """The motion is hardly known."""
    turn = np.degrees(motion.rotation_sigma)
    if turn > settings.max_rotation_deg:
        return f"the rotation is known to {turn:.1f} deg only"
    plane = None if motion.geometry is None else motion.geometry.plane
    if not motion.metric or plane is None:
        return None
    reach = settings.max_position / float(np.linalg.norm(plane))
    return f"the position is known to {motion.position_sigma:.2g} m only" if motion.position_sigma > reach else None
