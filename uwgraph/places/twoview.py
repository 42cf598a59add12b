"""The motion between two images of one camera: a plane and what stands out of it, with scale and covariance."""

from __future__ import annotations

from typing import Annotated, Final

import cv2
import numpy as np
from pydantic import Field

from uwgraph.dive.rig import Positive, Settings
from uwgraph.places.aids import STEEPEST, Aids
from uwgraph.places.matching import Matches
from uwgraph.places.motion import (
    CONTRADICTION,
    NOT_WHERE_SOUNDED,
    Motion,
    failed,
    motion_in_body,
    rotation_vector,
)
from uwgraph.places.plane import (
    Geometry,
    epipolar,
    floor_of,
    inverse_depths,
    pixels_off_plane,
    planes_of,
)
from uwgraph.places.refine import INDEPENDENT
from uwgraph.places.solve import Solved, is_floor, solve
from uwgraph.places.view import View
from uwgraph.types import BoolArray, FloatArray

CONFIDENCE: Final = 0.9999
ITERATIONS: Final = 5000
GATE: Final = 3.0
"""Points further off than this many sigma do not agree."""
STEEP: Final = 15.0
"""What it costs (chi-square) to say that a plane is a wall; only to choose between the two planes of one homography."""
OFF_PLANE: Final = 4.0
"""What a point costs (chi-square) that has a depth of its own."""
OUTLIER: Final = 12.0
"""What a match costs at most."""
CHANCE: Final = 0.1
"""Fewer points off the plane than this part of those on it are taken as wrong: an epipolar line is met by chance."""
AS_WELL: Final = 6.0
"""Two motions explain the images equally well when their costs (chi-square of independent points) differ by less."""

ONE_TURN: Final = float(np.radians(2.0))
ONE_WAY: Final = 0.05
"""Motions no further apart than this, rad and parts of the distance of the floor, are one with a larger covariance."""
ALONG: Final = 0.1
"""Directions no further apart than this, rad, are one."""
DIFFERENT: Final = 22.5
"""Chi-square of six degrees of freedom, 99.9 %."""


class PairSettings(Settings):
    """When two images count as showing the same thing."""

    min_inliers: Annotated[int, Field(ge=8, le=10_000)] = 20
    """Fewer points that agree are no motion."""
    min_share: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.4
    """Of the distinct matches at least this part must agree: some lie on any epipolar lines by chance."""
    threshold_px: Positive = 1.5
    """How far off points may be while the motion is searched, pixels."""
    noise_px: Positive = 0.7
    """What features are usually off by; only to choose between models."""


def two_view_motion(a: View, b: View, matches: Matches, aids: Aids, settings: PairSettings | None = None) -> Motion:
    """The motion of the body from one view to the other, from matched features.

    Distinct matches find it (MAGSAC++, both planes of a homography and the essential matrix), all mutual ones near it
    refine it, and the best explanation wins, if it is clearly better.
    """
    settings = settings or PairSettings()
    if matches.distinct.sum() < settings.min_inliers:
        return failed(f"too few matches: {matches.distinct.sum()}")
    va, vb = a.select(matches.a), b.select(matches.b)
    starts = first_guesses(va.select(matches.distinct), vb.select(matches.distinct), aids, settings)
    found = [made for g in starts if (made := _refined(g, va, vb, aids, settings)) is not None]
    found = [(solved, agree) for solved, agree in found if agree[matches.distinct].mean() >= settings.min_share]
    if not found:
        return failed("too few points agree with one motion")
    best, costs = _ranked([solved for solved, _ in found], va, vb, aids, settings)
    solved, agree = found[best]
    rivals = [k for k, cost in enumerate(costs) if k != best and cost < costs[best] + AS_WELL]
    doubts = [_between(solved, found[k][0]) for k in rivals]
    cov = solved.cov[:6, :6] + sum((np.outer(d, d) for d in doubts), np.zeros((6, 6)))
    motion = _motion(solved, cov, agree, va, vb, matches)
    if any(_apart(d, solved) for d in doubts):
        return motion.refused("two motions explain the images as well")
    if solved.off_soundings > CONTRADICTION:
        return motion.refused(NOT_WHERE_SOUNDED)
    return motion


def first_guesses(a: View, b: View, aids: Aids, settings: PairSettings) -> list[Geometry]:
    """Motions that explain the matches (rows of a and b): those of a homography, and that of an essential matrix."""
    K = np.diag([2.0 / (a.pixel + b.pixel)] * 2 + [1.0])  # OpenCV's estimators expect pixels
    xa, xb = a.image_plane * K[0, 0], b.image_plane * K[0, 0]
    cv2.setRNGSeed(0)
    H, _ = cv2.findHomography(xa, xb, cv2.USAC_MAGSAC, settings.threshold_px, None, ITERATIONS, CONFIDENCE)
    cv2.setRNGSeed(0)
    E, mask = cv2.findEssentialMat(xa, xb, K, cv2.USAC_MAGSAC, CONFIDENCE, settings.threshold_px, ITERATIONS)
    planar = [] if H is None else planes_of(np.linalg.inv(K) @ H @ K, a, b.camera.R_bs)
    general = []
    if E is not None and E.shape == (3, 3):
        _, R_ba, t, _ = cv2.recoverPose(E, xa, xb, K, mask=mask)
        R_s = np.asarray(R_ba).T
        general = [Geometry(a.camera.R_bs @ R_s @ b.camera.R_bs.T, -a.camera.R_bs @ R_s @ t.ravel())]
    flattest = aids.flattest(a.rays, a.camera.l_b)
    walls = [g for g in planar + general if not is_floor(g.plane, aids.floor, flattest)]
    floors = [_floor_beside(g, a, b, aids, flattest, settings.threshold_px) for g in walls]
    return planar + general + [g for g in floors if g is not None]


def _floor_beside(g: Geometry, a: View, b: View, aids: Aids, flattest: float, threshold: float) -> Geometry | None:
    """The same motion with a floor in the place of a wall, on matches that the wall does not explain."""
    rest = slice(None) if g.plane is None else pixels_off_plane(g, a, b) > threshold
    floor = floor_of(g, a.select(rest), b.select(rest), aids.floor, flattest, threshold)
    return None if floor is None else Geometry(g.R, g.c, floor)


def _refined(g: Geometry, a: View, b: View, aids: Aids, settings: PairSettings) -> tuple[Solved, BoolArray] | None:
    """Solved on the matches that agree, and again on those that agree then; None where they are too few."""
    solved, agree = None, np.zeros(len(a), np.bool_)
    reach = 2.0 * settings.threshold_px
    for _ in range(2):
        on_plane, agree = agreeing(g, a, b, reach)
        if agree.sum() < settings.min_inliers:
            return None
        solved = solve(g, a.select(agree), b.select(agree), on_plane[agree], aids)
        g, reach = solved.geometry, GATE * solved.sigma
    _, agree = agreeing(g, a, b, reach)
    return None if solved is None or agree.sum() < settings.min_inliers else (solved, agree)


def agreeing(g: Geometry, a: View, b: View, reach: float) -> tuple[BoolArray, BoolArray]:
    """Which matches lie on the plane within ``reach`` pixels, and which on it or before or behind it."""
    on_plane = np.zeros(len(a), np.bool_)
    if g.plane is not None:
        on_plane = pixels_off_plane(g, a, b) < reach
    rho, pixels = inverse_depths(g, a, b)
    parallax = rho * pixels
    told_apart = (parallax > 2.0 * reach) if g.plane is None else (np.median(parallax) > 2.0 * reach) & (rho > 0.0)
    off_plane = (np.abs(epipolar(g, a, b)[0]) < reach) & told_apart & ~on_plane
    if off_plane.sum() < CHANCE * on_plane.sum():
        return on_plane, on_plane
    return on_plane, on_plane | off_plane


def _motion(solved: Solved, cov: FloatArray, agree: BoolArray, a: View, b: View, matches: Matches) -> Motion:
    g = solved.geometry
    p, cov = motion_in_body(g, cov, a.camera.l_b, solved.metric)
    rho, pixels = inverse_depths(g, a.select(agree), b.select(agree))
    on_plane = 0 if g.plane is None else int((pixels_off_plane(g, a, b) < GATE * solved.sigma)[agree].sum())
    reason = f"{'plane' if on_plane > 0.8 * agree.sum() else 'relief'}{'' if solved.metric else ', no scale'}"
    parallax = float(np.median(np.abs(rho * pixels)))
    flow = float(np.median(np.linalg.norm(b.features.uv[agree] - a.features.uv[agree], axis=1)))
    seen = matches.a[agree], matches.b[agree]
    return Motion(p, rotation_vector(g.R), cov, True, reason, *seen, g, parallax, flow, solved.metric)


def _cost(solved: Solved, a: View, b: View, aids: Aids, settings: PairSettings, wall: Geometry | None = None) -> float:
    """Chi-square of the matches, on the plane, on a wall or, dearer by a free depth, off them, and of the aids."""
    g, noise = solved.geometry, settings.noise_px
    fit = (epipolar(g, a, b)[0] / noise) ** 2 + OFF_PLANE
    for seen in (g, wall):
        if seen is not None and seen.plane is not None:
            fit = np.minimum(fit, (pixels_off_plane(seen, a, b) / noise) ** 2)
    steep = 0.0 if g.plane is None or is_floor(g.plane, aids.floor, STEEPEST) else STEEP
    independent = min(1.0, INDEPENDENT / len(a))
    return float(independent * np.minimum(fit, OUTLIER).sum() + solved.aid_cost + steep)


def _ranked(found: list[Solved], a: View, b: View, aids: Aids, settings: PairSettings) -> tuple[int, list[float]]:
    """Which motion is best, and the costs of all.

    Where it has no scale but the same motion with another plane has, that one is: which plane holds more matches, a
    wall or the floor, does not matter to the motion. Then the floor is to explain what the wall does not.
    """
    costs = [_cost(solved, a, b, aids, settings) for solved in found]
    best = int(np.argmin(costs))
    twins = [k for k, other in enumerate(found) if other.metric and _same_way(found[best], other)]
    if found[best].metric or not twins:
        return best, costs
    costs = [_cost(solved, a, b, aids, settings, found[best].geometry) for solved in found]
    return min(twins, key=costs.__getitem__), costs


def _same_way(one: Solved, other: Solved) -> bool:
    """Whether two motions turn alike and go in the same direction."""
    doubt = _between(one, other)
    return bool(np.linalg.norm(doubt[:3]) < ONE_TURN and np.linalg.norm(doubt[3:]) < ALONG * _length(one))


def _length(solved: Solved) -> float:
    return max(float(np.linalg.norm(solved.geometry.c)), 1e-12)


def _between(one: Solved, other: Solved) -> FloatArray:
    """From one motion to another: rotation and way of the camera, of equal length if either has no scale, (6,)."""
    turn = rotation_vector(one.geometry.R.T @ other.geometry.R)
    same_unit = 1.0 if one.metric and other.metric else _length(one) / _length(other)
    return np.concatenate([turn, same_unit * other.geometry.c - one.geometry.c])


def _apart(doubt: FloatArray, solved: Solved) -> bool:
    """Whether two motions are too far apart, and further than their noise, for one covariance to hold both."""
    g = solved.geometry
    reach = 1.0 / float(np.linalg.norm(g.plane)) if g.plane is not None else float(np.linalg.norm(g.c))
    small = np.linalg.norm(doubt[:3]) < ONE_TURN and np.linalg.norm(doubt[3:]) < ONE_WAY * reach
    noise = doubt @ np.linalg.pinv(solved.cov[:6, :6], hermitian=True) @ doubt
    return not small and bool(noise > DIFFERENT)
