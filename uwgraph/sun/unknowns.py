"""What polarization does not know of the light's way, found beside the sun: kappa and the light scattered twice.

Both bend the pattern, and a pattern seen in part is bent into a wrong azimuth. They are estimated with the direction
by Gauss-Newton on the same robust residuals, and so the direction's covariance has their share.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from uwgraph.sun.eigen import Evectors, Fit, Robust, evenly, from_azimuth, jacobian, refine, residuals, solve
from uwgraph.sun.evector import Skylight, Unknowns
from uwgraph.sun.observation import azimuth_in_level
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

KAPPAS: Final = np.geomspace(1.0, 16.0, 15)
_FIRST: Final = Unknowns(log_kappa=float(np.log(1.3)))
_GRID_PIXELS: Final = 700
_LAST_TWICE: Final = 1e-3  # of the order of 0.01 deg in the direction, and so the next
_LAST_LOG_KAPPA: Final = 0.03


@dataclass(frozen=True)
class Prior:
    """1-sigma of the unknowns before the image."""

    log_kappa: float = float("inf")
    twice: float = 0.03

    def sigma(self, in_water: bool) -> FloatArray:
        """Of the unknowns that there are, shape (K,)."""
        return np.array([self.log_kappa, self.twice] if in_water else [self.twice])


def derivatives(light: Skylight, sky: Evectors, s_b: FloatArray, at: Unknowns, in_water: bool) -> FloatArray:
    """Derivative of the residuals by the unknowns, shape (N, K): log kappa (under water only) and twice."""
    turned = np.einsum("ni,i->n", np.cross(sky.a_b, sky.e_b), s_b)  # how e.s changes as e turns
    by_angle = light.derivatives(at, s_b) * np.where(turned < 0.0, -1.0, 1.0)[:, None]
    return by_angle if in_water else by_angle[:, 1:]


def improved(light: Skylight, sky: Evectors, fit: Fit, at: Unknowns, prior: Prior, in_water: bool) -> Unknowns:
    """One step of Gauss and Newton."""
    J = jacobian(sky, fit, derivatives(light, sky, fit.s_b, at, in_water))
    weight = fit.trust / fit.variance
    known = 1.0 / prior.sigma(in_water) ** 2
    values = np.array([at.log_kappa, at.twice] if in_water else [at.twice])
    H = (J.T * weight) @ J + np.diag(np.concatenate([np.zeros(2), known]))
    g = J.T @ (weight * fit.residual) + np.concatenate([np.zeros(2), known * values])
    values = values - np.linalg.lstsq(H, g)[0][2:]
    log_kappa = float(np.clip(values[0], 0.0, np.log(KAPPAS[-1]))) if in_water else 0.0
    return Unknowns(log_kappa, float(np.clip(values[-1], -0.1, 0.2)))


def settled(
    light: Skylight, fit: Fit, at: Unknowns, view: View, robust: Robust, prior: Prior, steps: int
) -> tuple[Evectors, Fit, Unknowns]:
    """Sky, direction and unknowns from a start near by, after ``steps`` steps or when they no longer matter."""
    sky = light.evectors(at)
    fit = refine(sky, fit.s_b, view.up_b, robust, fit.excess)
    for _ in range(steps):
        before, at = at, improved(light, sky, fit, at, prior, view.in_water)
        sky = light.evectors(at)
        fit = refine(sky, fit.s_b, view.up_b, robust, fit.excess)
        if abs(at.twice - before.twice) < _LAST_TWICE and abs(at.log_kappa - before.log_kappa) < _LAST_LOG_KAPPA:
            break
    return sky, fit, at


def depolarization(light: Skylight, view: View, robust: Robust) -> Unknowns:
    """kappa with the least bounded residual on a grid; with the sun's height of the almanac where it is known."""
    light = light.select(evenly(len(light.sin2), _GRID_PIXELS))
    s_b = solve(light.evectors(_FIRST), view.up_b, view.sun_zenith, robust).fit.s_b
    costs = np.empty(len(KAPPAS))
    for k, kappa in enumerate(KAPPAS):
        sky = light.evectors(Unknowns(float(np.log(kappa))))
        s_k = refine(sky, s_b, view.up_b, robust, rounds=3).s_b
        if view.sun_zenith is not None:
            s_k = from_azimuth(float(azimuth_in_level(s_k, view.up_b)), view.sun_zenith, view.up_b)
        square = np.minimum(residuals(sky, s_k) ** 2, np.sin(np.radians(6.0)) ** 2)
        costs[k] = (square / (sky.sigma**2 + np.radians(1.0) ** 2)).sum()
    return Unknowns(float(np.log(KAPPAS[int(np.argmin(costs))])))
