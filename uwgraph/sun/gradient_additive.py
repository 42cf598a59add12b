"""The integral of the ring form: ln L = F(angle from the sun) + H(zenith angle) + the lens, F and H smooth.

Nothing is blurred or differentiated: every pixel counts with its own noise, and masks leave no rims. F and H are cubic
splines, linear given the sun; the sun's two numbers follow by Gauss-Newton with the splines eliminated (variable
projection: Golub & Pereyra 1973, Kaufman 1975), reweighted against clouds and waves. Without H it is the plain form.
The lens darkens towards its rim by two more terms: on a tilted camera no function of the zenith angle takes them up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from uwgraph.sun.information import block_sandwich
from uwgraph.types import FloatArray

F_PIECES, H_PIECES = 10, 7
WARP = 0.6
"""F's knots are even in gamma ** WARP: denser near the sun, where the sky is steep."""
RIDGE = 1e-7
ITERATIONS, REWEIGHTED = 8, 4
"""At most so many steps, the first few of which choose the weights anew: for ever, they would creep."""
ENOUGH = np.radians(0.005)
"""A step at which to stop."""
LONGEST = np.radians(6.0)
"""No step goes farther."""
L1_ROUNDS = 3
CUTOFF = 5.0
"""Standard deviations at which the redescending weight (Geman & McClure) is a quarter."""
LENS = 50.0 / np.array([0.3, 0.15]) ** 2
"""Prior of the lens's darkening at the rim: 0.3 and 0.15 in ln L; 50 neighbours on a rough sea count as one pixel."""
TABLE: Final = 8192


@dataclass(frozen=True, eq=False)
class Sky:
    """Pixels of clear sky."""

    a: FloatArray
    """Directions in b, shape (N, 3)."""
    y: FloatArray
    """ln of the radiance, shape (N,)."""
    variance: FloatArray
    """Its variance from the sensor's noise, shape (N,)."""
    block: NDArray[np.intp]
    """Number of the block of neighbours that err together, shape (N,)."""
    up: FloatArray
    """Zenith in b, shape (3,)."""
    off_axis2: FloatArray
    """Square of the distance from the optical axis, 1 at the farthest, shape (N,)."""


@dataclass(frozen=True, eq=False)
class AdditiveResult:
    """The sun by the additive form."""

    s: FloatArray
    """Unit vector to the sun, in b, shape (3,)."""
    E: FloatArray
    """Tangents at ``s`` as columns: of growing zenith angle and of growing azimuth, shape (3, 2)."""
    cov: FloatArray
    """Block sandwich covariance along ``E``, rad^2, shape (2, 2)."""
    explained: float
    """Of the light's variance that the zenith angle cannot explain, the share that the sun does."""
    contrast: float
    """Standard deviation of that part of ln L, in which the sun alone shows."""
    texture: float
    """Standard deviation of the residual of ln L beyond the sensor's noise."""
    residual: FloatArray
    """Shape (N,)."""
    weight: FloatArray
    """Robust weight, shape (N,)."""
    grows: bool
    """Whether the light grows towards ``s``."""
    converged: bool


@dataclass(frozen=True, eq=False)
class _Fit:
    """Splines fitted with the sun held, and what the residual says about moving it."""

    residual: FloatArray
    sun_part: FloatArray
    """F of every pixel."""
    slope: FloatArray
    """F' of every pixel."""
    J: FloatArray
    """Derivative of the model along the tangents of s, the splines eliminated, shape (N, 2)."""
    w: FloatArray
    """Weight of every pixel."""

    @property
    def score(self) -> FloatArray:
        return self.J * (self.w * self.residual)[:, None]

    @property
    def hessian(self) -> FloatArray:
        H = (self.J * self.w[:, None]).T @ self.J
        return np.asarray(H + (1e-9 * np.trace(H) + 1e-9) * np.eye(2))  # a sky without slope has none


def additive_sun(sky: Sky, start: FloatArray, *, rings: bool = True, free_zenith: bool = True) -> AdditiveResult:
    """Refine the sun from ``start`` (3,); without ``rings`` H is left out, without ``free_zenith`` the height stays."""
    H = _beside_the_sun(sky, rings)
    s, step = start, np.inf
    texture2, trust = _reweighted(_least_absolute(sky, H, s), sky.variance)
    for turn in range(ITERATIONS):
        fit = _fit(sky, H, s, trust / (sky.variance + texture2))
        move = _step(fit, free_zenith)
        step = float(np.linalg.norm(move))
        if step < ENOUGH:
            break
        move *= min(1.0, LONGEST / step)
        s = moved(s, sky.up, move)
        if turn < REWEIGHTED:
            texture2, trust = _reweighted(fit.residual - fit.J @ move, sky.variance)
    own = _beyond(fit.sun_part, _beside_the_sun(sky, rings=True), trust)
    signal, left = ((trust * x**2).sum() for x in (own, fit.residual))
    return AdditiveResult(
        s=s,
        E=tangents(s, sky.up),
        cov=_covariance(fit, sky, F_PIECES + 5 + H.shape[1]),
        explained=float(signal / (signal + left)),
        contrast=float(np.sqrt(signal / trust.sum())),
        texture=float(np.sqrt(texture2)),
        residual=fit.residual,
        weight=trust,
        grows=bool((trust * fit.slope).sum() < 0.0),
        converged=step < 20.0 * ENOUGH,
    )


def _covariance(fit: _Fit, sky: Sky, parameters: int) -> FloatArray:
    """Block sandwich; the splines took as many degrees of freedom from the blocks as they have coefficients."""
    blocks = int(sky.block.max()) + 1
    return block_sandwich(fit.score, sky.block, fit.hessian) * (blocks / max(blocks - parameters, 0.25 * blocks))


def refit(sky: Sky, result: AdditiveResult, *, rings: bool, free_zenith: bool) -> FloatArray:
    """The sun after one more step with the weights of ``result``, for another vertical or other directions."""
    H = _beside_the_sun(sky, rings)
    fit = _fit(sky, H, result.s, result.weight / (sky.variance + result.texture**2))
    return moved(result.s, sky.up, _step(fit, free_zenith))


def jackknife(
    sky: Sky, result: AdditiveResult, groups: NDArray[np.intp], *, rings: bool, free_zenith: bool
) -> FloatArray:
    """Covariance (2, 2) along ``result.E`` [rad^2] from leaving out one of ``groups`` (N,) at a time (Tukey 1958).

    What is wrong with the model is wrong over much of the sky: parts of it then point to different suns. The splines
    are fitted anew each time; the normal equations of the groups add up, and so no pixel is touched again.
    """
    w = result.weight / (sky.variance + result.texture**2)
    B, _, J = _linearised(sky, _beside_the_sun(sky, rings), result.s, w)
    D = np.concatenate([J if free_zenith else J[:, 1:], B, sky.y[:, None]], axis=1)
    parts = np.array([(D[k] * w[k, None]).T @ D[k] for k in (groups == g for g in np.unique(groups))])
    moves = np.zeros((len(parts), 2))
    for move, left in zip(moves, parts.sum(axis=0) - parts, strict=True):
        normal, right = _regular(left[:-1, :-1]), left[:-1, -1]
        move[0 if free_zenith else 1 :] = np.linalg.solve(normal, right)[: 2 if free_zenith else 1]
    moves -= moves.mean(axis=0)
    return np.asarray((len(moves) - 1) / len(moves) * moves.T @ moves)


def _beyond(part: FloatArray, basis: FloatArray, weight: FloatArray) -> FloatArray:
    """What of ``part`` the columns of ``basis`` cannot explain."""
    return part - basis @ _solve(basis, basis * weight[:, None], part)[0]


def _fit(sky: Sky, H: FloatArray, s: FloatArray, w: FloatArray) -> _Fit:
    """Weighted least squares of the splines, and score and curvature of s with them eliminated."""
    B, fitted, J = _linearised(sky, H, s, w)
    weighted = B * w[:, None]
    J = J - B @ (fitted.inverse @ (weighted.T @ J))
    n_f = _table(F_PIECES)[0].shape[1]
    return _Fit(sky.y - B @ fitted.c, B[:, :n_f] @ fitted.c[:n_f], fitted.slope, J, w)


@dataclass(frozen=True, eq=False)
class _Splines:
    """Coefficients, the inverse of their normal matrix, and F' of every pixel."""

    c: FloatArray
    inverse: FloatArray
    slope: FloatArray


def _linearised(sky: Sky, H: FloatArray, s: FloatArray, w: FloatArray) -> tuple[FloatArray, _Splines, FloatArray]:
    """Columns of the splines, their fit, and the derivative (N, 2) of the model along the tangents of s."""
    gamma = _angle(sky.a, s)
    rows, dx = _sun_rows(gamma)
    values, slopes = _table(F_PIECES)
    B = np.concatenate([values[rows], H], axis=1)
    c, inverse = _solve(B, B * w[:, None], sky.y)
    slope = (slopes @ c[: values.shape[1]])[rows] * dx
    J = (sky.a @ tangents(s, sky.up)) * (-slope / np.maximum(np.sin(gamma), 1e-3))[:, None]
    return B, _Splines(c, inverse, slope), J


def _least_absolute(sky: Sky, H: FloatArray, s: FloatArray) -> FloatArray:
    """Residual of the splines in the L1 norm, which lets no occluder that escaped the mask pull them, s held."""
    B = np.concatenate([_table(F_PIECES)[0][_sun_rows(_angle(sky.a, s))[0]], H], axis=1)
    residual, w = sky.y, np.ones(len(sky.y))
    for _ in range(L1_ROUNDS):
        residual = sky.y - B @ _solve(B, B * w[:, None], sky.y)[0]
        size = np.abs(residual)
        w = 1.0 / (size + 0.1 * np.median(size) + 1e-9)
    return np.asarray(residual)


def _solve(B: FloatArray, weighted: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of least squares, and the inverse of the normal matrix; the last two columns are the lens's."""
    normal = _regular(B.T @ weighted)
    inverse: FloatArray = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    c: FloatArray = inverse @ (weighted.T @ y)
    return c, inverse


def _regular(normal: FloatArray) -> FloatArray:
    """A normal matrix, the lens's two columns last, with a hair's ridge and the lens's prior."""
    normal = normal + RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
    normal[[-2, -1], [-2, -1]] += LENS
    return normal


def _step(fit: _Fit, free_zenith: bool) -> FloatArray:
    g, hessian = fit.score.sum(axis=0), fit.hessian
    return np.linalg.solve(hessian, g) if free_zenith else np.array([0.0, g[1] / hessian[1, 1]])


def _reweighted(residual: FloatArray, variance: FloatArray) -> tuple[float, FloatArray]:
    """Variance of the sky's own texture, and the redescending weight of every pixel."""
    scale2 = (1.4826 * float(np.median(np.abs(residual)))) ** 2
    texture2 = max(scale2 - float(np.median(variance)), 0.0)
    return texture2, 1.0 / (1.0 + residual**2 / (CUTOFF**2 * (variance + texture2))) ** 2


def tangents(s: FloatArray, up: FloatArray) -> FloatArray:
    """Unit tangents at s of growing zenith angle and of growing (clockwise) azimuth, as columns, shape (3, 2)."""
    clockwise = np.cross(s, up)
    clockwise = clockwise / max(float(np.linalg.norm(clockwise)), 1e-9)
    return np.stack([np.cross(s, clockwise), clockwise], axis=1)


def moved(s: FloatArray, up: FloatArray, d: FloatArray) -> FloatArray:
    """The direction at d [rad] along the tangents of s: first downwards, then round the vertical."""
    zenith = np.clip(np.arccos(np.clip(s @ up, -1.0, 1.0)) + d[0], 1e-3, np.pi / 2.0)
    clockwise = tangents(s, up)[:, 1]
    turn = d[1] / max(float(np.sin(zenith)), 0.05)
    horizontal = np.cos(turn) * np.cross(up, clockwise) + np.sin(turn) * clockwise
    return np.asarray(np.cos(zenith) * up + np.sin(zenith) * horizontal)


def _angle(a: FloatArray, s: FloatArray) -> FloatArray:
    return np.asarray(np.arccos(np.clip(a @ s, -1.0, 1.0)))


def _beside_the_sun(sky: Sky, rings: bool) -> FloatArray:
    """Columns of the terms that do not know the sun: the zenith angle's, if any, and the lens's."""
    lens = np.stack([sky.off_axis2, sky.off_axis2**2], axis=1)
    return np.concatenate([_zenith_splines(sky), lens], axis=1) if rings else lens


def _zenith_splines(sky: Sky) -> FloatArray:
    zenith = _angle(sky.a, sky.up)
    low, high = float(zenith.min()), float(zenith.max())
    return _table(H_PIECES)[0][((zenith - low) / max(high - low, 1e-9) * TABLE + 0.5).astype(np.intp)]


def _sun_rows(gamma: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Rows of F's table, and the derivative of the table's argument by gamma."""
    warped = np.maximum(gamma, 1e-3) ** WARP
    low, high = float(warped.min()), float(warped.max())
    scale = 1.0 / max(high - low, 1e-9)
    rows = ((warped - low) * scale * TABLE + 0.5).astype(np.intp)
    return rows, WARP * scale * warped / np.maximum(gamma, 1e-3)


@lru_cache(maxsize=4)
def _table(pieces: int) -> tuple[FloatArray, FloatArray]:
    """Cubic B-splines on [0, 1] and their slopes at TABLE + 1 places."""
    x = np.linspace(0.0, 1.0, TABLE + 1)
    knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, pieces + 1), [1.0] * 3])
    splines = BSpline(knots, np.eye(pieces + 3), 3)
    return np.asarray(splines(x)), np.asarray(splines.derivative()(x))
