"""Two cameras side by side: places of features, and the motion between two such sets of places."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np

from uwgraph.errors import ConfigError
from uwgraph.places.aids import Aids
from uwgraph.places.matching import Matches, match
from uwgraph.places.motion import Motion, failed, motion_in_body, rotation_vector
from uwgraph.places.plane import Geometry, epipolar
from uwgraph.places.refine import Fit, refine
from uwgraph.places.view import View, blocks
from uwgraph.types import FloatArray

OFF_LINE: Final = 2.0
"""Matches between left and right are not further from the epipolar line than this, pixels."""
RELATIVE: Final = 0.1
"""Points whose distance a pixel changes by more than this part are too far to be placed."""
TRIALS: Final = 500
GATE: Final = 16.3
"""Chi-square of three degrees of freedom, 99.9 %."""
NOISE_PX: Final = 0.7
"""What features are off by while the motion is searched, pixels."""


def of_one_moment(views: Iterable[View]) -> View:
    """The view of one camera, or that of the left one of two, with places."""
    first, *others = views
    return with_points(first, *others) if others else first


def with_points(left: View, right: View) -> View:
    """The left view with the places of those features that the right one shows as well.

    Raises
    ------
    ConfigError
        When both cameras are at the same place.
    """
    base = right.camera.l_b - left.camera.l_b
    if np.linalg.norm(base) < 1e-3:
        raise ConfigError(
            "the two cameras are at the same place",
            where="translation_m",
            remedy="give translation_m in both camera files: where each sits in the vehicle",
        )
    points, cov = np.full((len(left), 3), np.nan), np.full((len(left), 3, 3), np.nan)
    matches = match(left, right)
    a, b = left.select(matches.a), right.select(matches.b)
    if len(matches):
        placed, placed_cov = triangulated(a, b, base)
        off = np.abs(epipolar(Geometry(np.eye(3), base), a, b)[0])
        depth = np.linalg.norm(placed, axis=1)
        good = (off < OFF_LINE) & (np.sqrt(np.trace(placed_cov, axis1=1, axis2=2)) < RELATIVE * depth)
        good &= (placed * a.rays).sum(axis=1) > 0.0
        points[matches.a[good]], cov[matches.a[good]] = placed[good], placed_cov[good]
    return replace(left, points=points, points_cov=cov)


def triangulated(a: View, b: View, base: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the rays of a, and those of b that start at ``base`` (3,), meet (N, 3), and the covariance (N, 3, 3).

    Least squares of the angles, twice, from the middle of the shortest line between the rays; for errors of one pixel.
    """
    cos = (a.rays * b.rays).sum(axis=1)
    along_a, along_b = a.rays @ base, b.rays @ base
    det = np.maximum(1.0 - cos * cos, 1e-12)
    s, t = (along_a - cos * along_b) / det, (cos * along_a - along_b) / det
    X = 0.5 * (s[:, None] * a.rays + t[:, None] * b.rays + base)
    for _ in range(2):
        information, g = np.zeros((len(X), 3, 3)), np.zeros((len(X), 3))
        for view, seen in ((a, X), (b, X - base)):
            depth = np.maximum(np.linalg.norm(seen, axis=1), 1e-9)
            e = np.einsum("nij,nj->ni", view.to_pixels, seen / depth[:, None] - view.rays)
            J = view.to_pixels / depth[:, None, None]
            information += np.swapaxes(J, 1, 2) @ J
            g += np.einsum("nij,ni->nj", J, e)
        cov = np.asarray(np.linalg.pinv(information, hermitian=True), dtype=np.float64)
        X = X - np.einsum("nij,nj->ni", cov, g)
    return np.asarray(X), cov


def stereo_motion(a: View, b: View, matches: Matches, aids: Aids, min_inliers: int) -> Motion:
    """The motion of the body between two views with places, from matched features that all have places.

    The places are brought together by R and c, each pair weighted by its own covariance (Matthies & Shafer, IEEE J.
    Robotics Automation 3, 1987).
    """
    va, vb = a.select(matches.a), b.select(matches.b)
    if matches.distinct.sum() < min_inliers:
        return failed(f"too few places in common: {matches.distinct.sum()}")
    g, sigma = _first_guess(va.select(matches.distinct), vb.select(matches.distinct)), NOISE_PX
    for _ in range(2):
        agree = _squares(g, va, vb) < GATE * sigma**2
        if agree.sum() < min_inliers:
            return failed(f"too few places agree with one motion: {agree.sum()}")
        fit = _refined(g, va.select(agree), vb.select(agree), aids)
        g, sigma = fit.geometry, max(fit.sigma, 0.5 * NOISE_PX)
    p, cov = motion_in_body(g, fit.cov, a.camera.l_b, metric=True)
    moved = float(np.median(np.linalg.norm(vb.features.uv[agree] - va.features.uv[agree], axis=1)))
    seen = matches.a[agree], matches.b[agree]
    return Motion(p, rotation_vector(g.R), cov, True, "stereo", *seen, g, moved, moved, True)


def _places(view: View) -> tuple[FloatArray, FloatArray]:
    assert view.points is not None
    assert view.points_cov is not None
    return view.points, view.points_cov


def _first_guess(a: View, b: View) -> Geometry:
    """The motion through three pairs of places with which most others agree."""
    (X_a, cov_a), (X_b, cov_b) = _places(a), _places(b)
    picks = np.random.default_rng(0).integers(0, len(X_a), (TRIALS, 3))
    R, c = _aligned(X_a[picks], X_b[picks])
    off = X_a[None] - X_b[None] @ np.swapaxes(R, 1, 2) - c[:, None]
    spread = np.trace(cov_a + cov_b, axis1=1, axis2=2)
    cost = np.minimum((off * off).sum(axis=2) / (NOISE_PX**2 * spread), 9.0).sum(axis=1)
    best = int(np.argmin(cost))
    return Geometry(R[best], c[best])


def _aligned(X_a: FloatArray, X_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R (T, 3, 3) and c (T, 3) with X_a = R X_b + c for sets of places (T, K, 3) (Kabsch)."""
    mean_a, mean_b = X_a.mean(axis=1), X_b.mean(axis=1)
    spread = np.swapaxes(X_b - mean_b[:, None], 1, 2) @ (X_a - mean_a[:, None])
    U, _, Vt = np.linalg.svd(spread)
    turn = np.ones((len(U), 3))
    turn[:, 2] = np.sign(np.linalg.det(U @ Vt))
    R = np.swapaxes(Vt, 1, 2) @ (turn[:, :, None] * np.swapaxes(U, 1, 2))
    return R, mean_a - (R @ mean_b[..., None])[..., 0]


def _whitener(g: Geometry, a: View, b: View) -> FloatArray:
    """What makes the differences of places (N, 3) have covariance one for errors of one pixel, shape (N, 3, 3)."""
    values, vectors = np.linalg.eigh(_places(a)[1] + g.R @ _places(b)[1] @ g.R.T)
    return np.asarray(np.swapaxes(vectors, 1, 2) / np.sqrt(np.maximum(values, 1e-18))[:, :, None])


def _squares(g: Geometry, a: View, b: View) -> FloatArray:
    """Squared whitened difference of every pair of places, shape (N,)."""
    off = _places(a)[0] - _places(b)[0] @ g.R.T - g.c
    return np.asarray((np.einsum("nij,nj->ni", _whitener(g, a, b), off) ** 2).sum(axis=1))


def _refined(g: Geometry, a: View, b: View, aids: Aids) -> Fit:
    X_a, X_b, W = _places(a)[0], _places(b)[0], _whitener(g, a, b)

    def points(at: Geometry) -> tuple[FloatArray, FloatArray]:
        r = np.einsum("nij,nj->ni", W, X_a - X_b @ at.R.T - at.c)
        return r, np.concatenate([W @ at.R @ np.cross(np.eye(3), X_b[:, None, :]), -W], axis=2)

    def known(at: Geometry) -> FloatArray:
        return np.concatenate([aids.of_rotation(at.R), aids.of_length(at.R, at.c, a.camera.l_b)])

    return refine(g, points, np.full(len(X_a), 3), known, blocks(a.features.uv))
