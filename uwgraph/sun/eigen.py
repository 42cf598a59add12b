"""The direction that is orthogonal to many e-vectors: a robust smallest eigenvector, started where the vote says.

Singly scattered light is polarized normal to the plane of its direction a and the sun s: e.s = 0. The sun is the
smallest eigenvector of the weighted sum of e e^T. Each residual is an angle, r = e.s / sin(gamma), gamma the angle
between a and s; Geman and McClure's weight (1987) takes the outliers out. Noise adds r^2 (I - a a^T) to each e e^T and
would pull s towards the part of the sky in view; it is subtracted pixel by pixel, which leaves a score that is odd in
r, hence no bias for any symmetric noise.

It knows nothing of images: any list of directions and e-vectors will do (photodiode compasses, pixel lists).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.sun.information import Spectrum, block_sandwich
from uwgraph.sun.observation import level_axes, zenith_angle
from uwgraph.sun.vote import Vote, vote
from uwgraph.types import BoolArray, FloatArray

_NEAR_SUN: Final = np.sin(np.radians(3.0)) ** 2  # nearer the sun an e-vector's angle says nothing
_FEW: Final = 20
_VOTERS: Final = 4000  # enough for a histogram
_JUDGES: Final = 1500  # enough to tell candidates apart
_LEAST_PEAK: Final = 0.1  # of the highest, for a peak of the vote to be looked into
_FIRST_EXCESS: Final = np.radians(1.0)
_STEP: Final = np.radians(1e-4)  # the reweighting has converged


@dataclass(frozen=True, eq=False)
class Evectors:
    """Directions in the sky and how the light from there is polarized."""

    a_b: FloatArray
    """Unit directions in the body, shape (N, 3)."""
    e_b: FloatArray
    """Unit e-vectors in the body, normal to ``a_b``, shape (N, 3); the sign is free."""
    sigma: FloatArray
    """1-sigma of the e-vector's angle about ``a_b``, rad, shape (N,), greater than 0."""
    block: NDArray[np.intp]
    """Number of the block whose e-vectors may err together, shape (N,), counted from 0."""

    def __len__(self) -> int:
        return len(self.sigma)

    def thinned(self, count: int) -> Evectors:
        """About ``count`` of them, evenly."""
        return self.select(evenly(len(self), count))

    def select(self, index: NDArray[np.intp] | BoolArray) -> Evectors:
        """Those that an index array or a mask picks."""
        return Evectors(self.a_b[index], self.e_b[index], self.sigma[index], self.block[index])


@dataclass(frozen=True)
class Robust:
    """Scales of the robust estimate; angles in rad."""

    least_scale: float = np.radians(2.0)
    """Least scale c of Geman and McClure's weight 1 / (1 + r^2 / c^2)^2."""
    sigmas: float = 4.0
    """c in units of the residuals' standard deviation, where that is more."""
    most_excess: float = np.radians(4.0)
    """Largest departure of sky from model that is taken for noise."""
    vote_smoothing: float = np.radians(2.0)
    """Kernel of the vote's histogram."""
    rival_apart: float = np.radians(10.0)
    """Axes nearer to each other than this are one."""
    zenith_tolerance: float = np.radians(5.0)
    """Candidates farther than this from the almanac's zenith angle come after all others."""
    off_height: float = 0.1
    """What the support of such a candidate counts as a rival."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A direction and how the e-vectors stand to it."""

    s_b: FloatArray
    """Unit vector to the sun, above the horizon, shape (3,)."""
    E: FloatArray
    """Two unit tangents at ``s_b``, as columns, shape (3, 2)."""
    residual: FloatArray
    """Sine of the angle of each e-vector against the model, shape (N,)."""
    variance: FloatArray
    """Variance of the residuals, stated noise plus excess, rad^2, shape (N,)."""
    trust: FloatArray
    """Geman and McClure's weight, 0 to 1, shape (N,)."""
    scale2: FloatArray
    """c^2 of that weight, rad^2, shape (N,)."""
    excess: float
    """Departure of the sky from the model beyond the stated noise, 1-sigma, rad."""

    @property
    def support(self) -> float:
        """Share of the e-vectors that agree, 0 to 1."""
        return float(np.average(self.trust, weights=1.0 / self.variance))

    @property
    def chance(self) -> float:
        """The support that e-vectors of random angle would give: the mean of the weight over all angles, c / 2."""
        return float(np.average(np.sqrt(self.scale2) / 2.0, weights=1.0 / self.variance))


@dataclass(frozen=True, eq=False)
class Solution:
    """The sun's direction from e-vectors, with what competes with it."""

    fit: Fit
    vote: Vote | None
    """Of some thousand e-vectors; None where the sun's zenith angle was not given."""
    rival_b: FloatArray | None
    """The next best direction, shape (3,), where there is one."""
    rivalry: float
    """Support of the rival over that of the winner, both above chance, a rival off the almanac's height discounted."""


def solve(sky: Evectors, up_b: FloatArray, sun_zenith: float | None = None, robust: Robust | None = None) -> Solution:
    """The sun's direction in three dimensions.

    Parameters
    ----------
    sky : Evectors
        At least three.
    up_b : shape (3,)
        Zenith in the body: for the sign, and for the vote.
    sun_zenith : float, optional
        The sun's zenith angle from the almanac [rad]. It starts the search by the vote on azimuth, and tells rivals
        apart; the winner's own zenith angle is free. Without it the search is over all directions.
    """
    robust = robust or Robust()
    few = sky.thinned(_JUDGES)
    starts, ballot = _starts(sky.thinned(_VOTERS), up_b, sun_zenith, robust)
    fits = _distinct([refine(few, s, up_b, robust) for s in starts], robust)
    unexplained = few.select(fits[0].trust < 0.25)
    if len(unexplained) > max(_FEW, 0.05 * len(few)):  # what the best leaves over may have a sun of its own
        others = [refine(unexplained, s, up_b, robust).s_b for s in _starts(unexplained, up_b, sun_zenith, robust)[0]]
        fits = _distinct(fits + [refine(few, s, up_b, robust, rounds=1) for s in others], robust)
    standing = [
        _above_chance(f) * (1.0 if _at_height(f, up_b, sun_zenith, robust) else robust.off_height) for f in fits
    ]
    first, *rest = np.argsort(standing)[::-1]
    fit = fits[first]
    if len(few) < len(sky):
        fit = refine(sky, fit.s_b, up_b, robust, fit.excess)
    return Solution(
        fit=fit,
        vote=ballot,
        rival_b=fits[rest[0]].s_b if rest else None,
        rivalry=standing[rest[0]] / standing[first] if rest else 0.0,
    )


def _starts(
    sky: Evectors, up_b: FloatArray, sun_zenith: float | None, robust: Robust
) -> tuple[list[FloatArray], Vote | None]:
    """Directions to start from, by the vote where the sun's height is known; and the vote."""
    if sun_zenith is None:
        return _search(sky, up_b), None
    ballot = vote(sky.a_b, sky.e_b, np.hypot(sky.sigma, _FIRST_EXCESS), up_b, sun_zenith, robust.vote_smoothing)
    peaks = ballot.modes[ballot.heights > _LEAST_PEAK * ballot.heights[:1]]
    return [from_azimuth(A, sun_zenith, up_b) for A in peaks] or _search(sky, up_b), ballot


def refine(
    sky: Evectors, s_b: FloatArray, up_b: FloatArray, robust: Robust, excess: float | None = None, rounds: int = 12
) -> Fit:
    """The smallest eigenvector by reweighting, from a start ``s_b`` (3,); ``excess`` is estimated where not given."""
    departure = _FIRST_EXCESS if excess is None else excess
    for _ in range(rounds):
        residual, sin2 = residuals(sky, s_b), _sin2(sky, s_b)
        variance = sky.sigma**2 + departure**2
        scale2 = np.maximum(robust.least_scale**2, robust.sigmas**2 * variance)
        square = residual**2
        trust = 1.0 / (1.0 + square / scale2) ** 2
        weight = trust / (variance * sin2)
        noise = weight * square
        M = (sky.e_b.T * weight) @ sky.e_b + (sky.a_b.T * noise) @ sky.a_b - noise.sum() * np.eye(3)
        spectrum = Spectrum.of(M)
        step2 = 1.0 - (spectrum.s @ s_b) ** 2
        s_b = spectrum.s
        if step2 < _STEP**2:
            break
        if excess is None:
            departure = _excess(residual, sky.sigma, variance, scale2, robust)
    upright = -1.0 if s_b @ up_b < 0.0 else 1.0
    return Fit(upright * s_b, spectrum.E, upright * residual, variance, trust, scale2, departure)


def covariance(
    sky: Evectors, fit: Fit, nuisance: FloatArray | None = None, prior_sigma: FloatArray | None = None
) -> FloatArray:
    """Covariance (2, 2) [rad^2] of the direction along ``fit.E``, infinite where nothing fixes it.

    K further unknowns are estimated beside it.

    Parameters
    ----------
    nuisance : shape (N, K), optional
        Derivative of the residuals by further unknowns.
    prior_sigma : shape (K,), optional
        How well they were known beforehand; infinite for not at all.
    """
    J = jacobian(sky, fit, nuisance)
    H = curvature(J, fit)
    scores = J * (fit.trust / fit.variance * fit.residual)[:, None]
    blocks = np.unique(sky.block, return_inverse=True)[1]
    if prior_sigma is not None:
        known = np.diag(np.concatenate([np.zeros(2), 1.0 / prior_sigma]))
        H = H + known**2
        scores, blocks = np.vstack([scores, known]), np.concatenate([blocks, blocks.max() + 1 + np.arange(len(known))])
    if np.linalg.eigvalsh(H)[0] <= 0.0:
        return np.full((2, 2), np.inf)
    count, free = int(blocks.max()) + 1, len(H)
    if count <= free + 1:
        return np.full((2, 2), np.inf)
    if count < _FEW and count == len(scores):  # independent, but too few for their scatter to tell
        square = np.average(fit.residual**2 / fit.variance, weights=fit.trust)
        return np.asarray(np.linalg.inv(H)[:2, :2] * max(1.0, float(square)), dtype=np.float64)
    return block_sandwich(scores, blocks, H)[:2, :2] * (count / (count - free))


def jacobian(sky: Evectors, fit: Fit, nuisance: FloatArray | None = None) -> FloatArray:
    """Derivative of the residuals by the direction along ``fit.E`` and by the nuisance, shape (N, 2 + K).

    It is taken at the model's e-vectors: the noise of those measured would correlate it with the residuals.
    """
    across = np.cross(sky.a_b, fit.s_b)
    across *= np.where(np.einsum("ni,ni->n", across, sky.e_b) < 0.0, -1.0, 1.0)[:, None]
    J = (across @ fit.E) / _sin2(sky, fit.s_b)[:, None]
    return J if nuisance is None else np.hstack([J, nuisance])


def curvature(J: FloatArray, fit: Fit) -> FloatArray:
    """Half the second derivative of the robust objective."""
    x2 = fit.residual**2 / fit.scale2
    bend = fit.trust * (1.0 - 3.0 * x2) / (1.0 + x2)  # derivative of the weighted residual: outliers bend it down
    H: FloatArray = (J.T * (bend / fit.variance)) @ J
    return H


def from_azimuth(azimuth: float, zenith: float, up_b: FloatArray) -> FloatArray:
    """Unit vector (3,) in the body of an azimuth clockwise from the bow and a zenith angle [rad]."""
    level = np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
    s_b: FloatArray = level_axes(up_b).T @ level
    return s_b


def evenly(total: int, count: int) -> NDArray[np.intp]:
    """At most ``count`` indices below ``total``; their steps are no whole number, so that no column is favoured."""
    return np.linspace(0, total - 1, min(count, total)).astype(np.intp)


def residuals(sky: Evectors, s_b: FloatArray) -> FloatArray:
    """Sines, shape (N,), of the e-vectors' angles against what a sun at ``s_b`` (3,) makes of them."""
    return np.asarray((sky.e_b @ s_b) / np.sqrt(_sin2(sky, s_b)))


def _sin2(sky: Evectors, s_b: FloatArray) -> FloatArray:
    """sin^2 of the angle from the sun."""
    return np.asarray(np.maximum(1.0 - (sky.a_b @ s_b) ** 2, _NEAR_SUN))


def _excess(residual: FloatArray, sigma: FloatArray, variance: FloatArray, scale2: FloatArray, robust: Robust) -> float:
    """1-sigma of the residuals beyond the stated noise, from those within c, less a background as between c and 2 c."""
    x2 = residual**2 / scale2
    q = 1.0 / variance
    inner, outer = q * (x2 < 1.0), q * ((x2 >= 1.0) & (x2 < 4.0))
    background = outer.sum()
    count = inner.sum() - background
    if count <= 0.0:
        return robust.most_excess
    sigma2 = sigma**2
    square = inner @ (residual**2 - sigma2) - background * (q @ (scale2 / 3.0 - sigma2)) / q.sum()
    return float(np.sqrt(np.clip(square / count, 0.0, robust.most_excess**2)))


def _above_chance(fit: Fit) -> float:
    return max(fit.support - fit.chance, 1e-6)


def _at_height(fit: Fit, up_b: FloatArray, sun_zenith: float | None, robust: Robust) -> bool:
    if sun_zenith is None:
        return True
    return abs(zenith_angle(fit.s_b, up_b) - sun_zenith) < robust.zenith_tolerance


def _distinct(fits: list[Fit], robust: Robust) -> list[Fit]:
    """One fit for each axis."""
    kept: list[Fit] = []
    for fit in sorted(fits, key=_above_chance, reverse=True):
        if all(abs(fit.s_b @ k.s_b) < np.cos(robust.rival_apart) for k in kept):
            kept.append(fit)
    return kept


def _search(sky: Evectors, up_b: FloatArray, count: int = 4) -> list[FloatArray]:
    """The best axes of a grid over the upper hemisphere, by a residual that is bounded at 10 deg."""
    few = sky.thinned(600)
    k = np.arange(1500) + 0.5
    height, turn = k / len(k), np.pi * (1.0 + np.sqrt(5.0)) * k  # Fibonacci's spiral
    level = np.stack([np.sqrt(1.0 - height**2) * np.cos(turn), np.sqrt(1.0 - height**2) * np.sin(turn), height])
    axes = level_axes(up_b).T @ level
    sin2 = np.maximum(1.0 - (few.a_b @ axes) ** 2, _NEAR_SUN)
    square = np.minimum((few.e_b @ axes) ** 2 / sin2, np.sin(np.radians(10.0)) ** 2)
    cost = (square / (few.sigma**2 + _FIRST_EXCESS**2)[:, None]).sum(axis=0)
    found: list[FloatArray] = []
    for j in np.argsort(cost):
        if all(abs(axes[:, j] @ f) < np.cos(np.radians(20.0)) for f in found):
            found.append(axes[:, j])
        if len(found) == count:
            break
    return found
