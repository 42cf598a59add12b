"""The sun from angles of polarization in the water at several directions of view.

The Mueller-Stokes chain of :mod:`uwgraph.sun.scattering` is fitted in the sun's azimuth and zenith angle, in L1, L2,
Huber or soft L1, with or without the correction of :mod:`uwgraph.sun.residual_model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.errors import DataError
from uwgraph.sun.information import FLOOR, rank2
from uwgraph.sun.m_estimate import Estimate, Loss, grouped_cov, m_estimate, robust_cost, robust_scale
from uwgraph.sun.observation import SunFlag, SunObservation, level_axes, tilted
from uwgraph.sun.residual_model import ResidualModel
from uwgraph.sun.scattering import scattered_aop, sun_from_sine, wrap_half
from uwgraph.sun.surface import to_air, to_water
from uwgraph.sun.sweep import Sweep
from uwgraph.types import FloatArray

DAY_NS: Final = 86_400 * 10**9
SECTORS: Final = 8
"""Of the horizon, within which residuals are taken to err together."""
LOWEST: Final = np.radians(0.2)
"""Elevation of the sun that no fit goes below, rad."""
APART: Final = np.radians(8.0)
"""Two suns nearer than this are one mode."""
AMBIGUOUS_BELOW: Final = 4.5
"""Difference of the costs (half a chi-square) that tells two modes apart: three sigmas."""
LEAST_DOLP: Final = 0.03
NEAR_ZENITH: Final = np.radians(3.0)
MISFIT_ABOVE: Final = np.radians(12.0)
"""Scatter of the residuals of a sweep that does not follow the model, rad."""
UNCERTAIN_ABOVE: Final = np.radians(10.0)
"""1-sigma of the azimuth, and half that of the zenith, of a sun that is of no use, rad."""


@dataclass(frozen=True, eq=False)
class ScatteringFit:
    """The sun of one sweep, and what the fit left."""

    observation: SunObservation
    sweep: Sweep
    residuals: FloatArray
    """AoP measured less AoP of the model, rad, shape (N,)."""
    scatter: float
    """Robust 1-sigma of the residuals, rad."""
    estimate: Estimate[FloatArray]


def fit_sun(
    sweep: Sweep,
    *,
    loss: Loss = "huber",
    residual_model: ResidualModel | None = None,
    sun_zenith: float | None = None,
    max_dolp: float = 1.0,
    model_error: float = 0.1,
) -> ScatteringFit:
    """The sun's direction and covariance from a sweep of the horizon.

    Parameters
    ----------
    sun_zenith : float, optional
        Zenith angle of the apparent sun by the almanac, rad: it checks the result and takes no part in it.
    max_dolp : float
        See :func:`uwgraph.sun.scattering.scattered_stokes`.
    model_error : float
        1-sigma of the share by which skylight and multiple scattering change tan(AoP) of the whole sweep. It widens the
        zenith angle, unless ``residual_model`` has learnt how well suns are found at that height.

    Raises
    ------
    DataError
        When the sweep has fewer than three views, or values that are not finite.
    """
    _check(sweep)
    model = _Model(sweep, max_dolp, residual_model)
    found = model.fit(model.start(loss), loss)
    if residual_model is not None:  # the correction's own spread is known only where the sun is
        model = model.widened(found.x)
        found = model.fit(found.x, loss)
    best, other = model.modes(found, loss)
    zenith = float(np.arccos(best.x[2]))
    beyond = residual_model.sun_sigma(zenith) if residual_model is not None else None
    if beyond is None:
        beyond = np.array([0.0, model_error * _stretch(zenith, sweep.n)])
    cov = grouped_cov(best, model.sector) + FLOOR**2 * np.eye(2)
    cov += np.diag(np.maximum(beyond**2 - np.diag(cov), 0.0))
    residuals = best.residuals[:, 0] * model.sigma
    scatter = float(np.median(np.abs(residuals))) * 1.4826
    observation = _observation(sweep, best.x, cov, other, scatter, sun_zenith)
    return ScatteringFit(observation, sweep, residuals, scatter, best)


def learn_residuals(
    sweeps: Sequence[Sweep], suns: Sequence[tuple[float, float]], loss: Loss = "huber", max_dolp: float = 1.0
) -> ResidualModel:
    """The residual model of sweeps at known positions, and how well it does on days that it was not learnt on.

    ``suns`` has one (azimuth clockwise from the bow of the levelled body, zenith angle) [rad] of the apparent sun for
    each sweep.
    """
    day = np.array([sweep.t_ns // DAY_NS for sweep in sweeps])
    days = np.unique(day)
    group = day if len(days) > 2 else np.arange(len(sweeps))
    model = _learn(sweeps, suns, group, max_dolp)
    fitted, errors = [], []
    for one in days if len(days) > 2 else ():
        known = list(zip(sweeps, suns, day, strict=True))
        rest = [(sweep, sun) for sweep, sun, d in known if d != one]
        without = _learn([sweep for sweep, _ in rest], [sun for _, sun in rest], group[day != one], max_dolp)
        for sweep, sun in [(sweep, sun) for sweep, sun, d in known if d == one]:
            fit = fit_sun(sweep, loss=loss, residual_model=without, max_dolp=max_dolp)
            if fit.observation.ok:
                fitted.append(float(np.arccos(fit.estimate.x[2])))
                errors.append(np.asarray(_tangent(fit.estimate.x).T @ _sun(*sun)))
    return replace(model, fitted_zenith=np.array(fitted), sun_errors=np.array(errors).reshape(-1, 2))


def _learn(
    sweeps: Sequence[Sweep], suns: Sequence[tuple[float, float]], group: NDArray[np.intp], max_dolp: float
) -> ResidualModel:
    relative, zenith, residuals = [], [], []
    for sweep, (sun_azimuth, sun_zenith) in zip(sweeps, suns, strict=True):
        aop = scattered_aop(sun_azimuth, sun_zenith, sweep.azimuth, sweep.elevation, sweep.n, max_dolp)
        relative.append(sun_azimuth - sweep.azimuth)
        zenith.append(np.full(len(sweep), sun_zenith))
        residuals.append(wrap_half(sweep.aop - aop))
    of_view = np.repeat(group, [len(sweep) for sweep in sweeps])
    return ResidualModel.learn(np.concatenate(relative), np.concatenate(zenith), np.concatenate(residuals), of_view)


class _Model:
    """Whitened residuals of a sweep as a function of the sun (bow, starboard, up)."""

    def __init__(self, sweep: Sweep, max_dolp: float, correction: ResidualModel | None) -> None:
        self.sweep, self.max_dolp, self.correction = sweep, max_dolp, correction
        self.sigma = sweep.sigma
        self.sector: NDArray[np.intp] = np.asarray(
            np.floor(sweep.azimuth % (2.0 * np.pi) / (2.0 * np.pi) * SECTORS), dtype=np.intp
        )

    def residuals(self, suns: Sequence[FloatArray]) -> FloatArray:
        s = np.array(suns)
        azimuth, zenith = np.arctan2(s[:, 1], s[:, 0])[:, None], np.arccos(np.clip(s[:, 2], -1.0, 1.0))[:, None]
        views = self.sweep
        aop = scattered_aop(azimuth, zenith, views.azimuth, views.elevation, views.n, self.max_dolp)
        if self.correction is not None:
            aop = aop + self.correction.predict(azimuth - views.azimuth, zenith)[0]
        r: FloatArray = (wrap_half(views.aop - aop) / self.sigma)[..., None]
        return r

    def widened(self, sun: FloatArray) -> _Model:
        """The same with sigmas that are not below the spread of what the correction was learnt from."""
        assert self.correction is not None
        wider = _Model(self.sweep, self.max_dolp, self.correction)
        relative = np.arctan2(sun[1], sun[0]) - self.sweep.azimuth
        _, spread = self.correction.predict(relative, np.arccos(np.clip(sun[2], -1.0, 1.0)))
        wider.sigma = np.maximum(self.sigma, spread)
        return wider

    def start(self, loss: Loss) -> FloatArray:
        """The best of the closed form and a coarse grid."""
        azimuth, zenith = sun_from_sine(self.sweep.azimuth, self.sweep.aop, 1.0 / self.sigma, self.sweep.n)
        return self._best([_sun(azimuth, zenith), *GRID], loss)

    def fit(self, start: FloatArray, loss: Loss) -> Estimate[FloatArray]:
        return m_estimate(self.residuals, _moved, start, 2, loss)

    def modes(self, found: Estimate[FloatArray], loss: Loss) -> tuple[Estimate[FloatArray], FloatArray | None]:
        """The best mode, and the second where it explains the sweep about as well.

        A low sun is refracted and polarizes much like a higher one, so modes are sought along the azimuth as well.
        """
        azimuth = float(np.arctan2(found.x[1], found.x[0]))
        column = [_sun(azimuth, zenith) for zenith in ZENITHS]
        cost = np.pad(self._costs(column, loss), 1, constant_values=np.inf)
        lowest = (cost[1:-1] < cost[:-2]) & (cost[1:-1] < cost[2:])
        starts = [s for s, low in zip(column, lowest, strict=True) if low and s @ found.x < np.cos(APART)]
        starts.append(self._best([s for s in GRID if s @ found.x < np.cos(np.radians(45.0))], loss))
        fits = [found, *(self.fit(start, loss) for start in starts)]
        scale = min(fit.scale for fit in fits)
        fits.sort(key=lambda fit: float(robust_cost(fit.residuals, scale, loss)))
        best = fits[0]
        for rival in fits[1:]:
            gap = robust_cost(rival.residuals, scale, loss) - robust_cost(best.residuals, scale, loss)
            if gap < AMBIGUOUS_BELOW and rival.x @ best.x < np.cos(APART):
                return best, rival.x
        return best, None

    def _best(self, suns: list[FloatArray], loss: Loss) -> FloatArray:
        return suns[int(np.argmin(self._costs(suns, loss)))]

    def _costs(self, suns: list[FloatArray], loss: Loss) -> FloatArray:
        r = self.residuals(suns)
        return robust_cost(r, min(robust_scale(each) for each in r), loss)


def _sun(azimuth: float, zenith: float) -> FloatArray:
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])


ZENITHS: Final = np.radians(np.arange(5.0, 90.0, 5.0))
GRID: Final = [
    _sun(azimuth, zenith) for zenith in np.radians([20.0, 45.0, 70.0]) for azimuth in np.radians(np.arange(0, 360, 30))
]


def _tangent(s: FloatArray) -> FloatArray:
    """Columns across (growing azimuth) and along (growing elevation) of a sun (bow, starboard, up)."""
    azimuth = np.arctan2(s[1], s[0])
    across = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([across, np.cross(s, across)], axis=1)


def _moved(s: FloatArray, d: FloatArray) -> FloatArray:
    s = s + _tangent(s) @ d
    s = s / np.linalg.norm(s)
    if s[2] < np.sin(LOWEST):
        return _sun(np.arctan2(s[1], s[0]), np.pi / 2.0 - LOWEST)
    return s


def _stretch(zenith: float, n: float) -> float:
    """Derivative of the zenith angle by ln tan(theta_r), sin(theta_r) = sin(zenith) / n."""
    sine = np.sin(zenith)
    return float(sine * (1.0 - (sine / n) ** 2) / np.cos(zenith))


def _observation(
    sweep: Sweep,
    sun: FloatArray,
    cov: FloatArray,
    other: FloatArray | None,
    scatter: float,
    sun_zenith: float | None,
) -> SunObservation:
    axes = level_axes(sweep.up_b)
    s_b, E_b = sun @ axes, axes.T @ _tangent(sun)
    cov = cov + _tilt_cov(sweep, s_b, E_b)
    information, cov_b = rank2(E_b, cov)
    seen = len(np.unique(np.floor(sweep.azimuth % (2.0 * np.pi) / np.radians(30.0)))) / 12.0
    return SunObservation(
        t_ns=sweep.t_ns,
        s_b=s_b,
        information_b=information,
        cov_b=cov_b,
        method="scattering",
        quality=float(seen / (1.0 + (scatter / MISFIT_ABOVE) ** 2)),
        flags=_flags(sweep, sun, cov, other, scatter, sun_zenith),
        up_b=sweep.up_b,
        other_b=None if other is None else other @ axes,
    )


def _flags(
    sweep: Sweep,
    sun: FloatArray,
    cov: FloatArray,
    other: FloatArray | None,
    scatter: float,
    sun_zenith: float | None,
) -> SunFlag:
    zenith = float(np.arccos(np.clip(sun[2], -1.0, 1.0)))
    across, along = np.sqrt(np.diag(cov))
    known = zenith if sun_zenith is None else sun_zenith
    night = known > np.pi / 2.0
    return SunFlag.of(
        {
            SunFlag.UNPOLARIZED: sweep.dolp is not None and bool(np.median(sweep.dolp) < LEAST_DOLP),
            SunFlag.NEAR_ZENITH: zenith < NEAR_ZENITH,
            SunFlag.AMBIGUOUS: other is not None,
            SunFlag.MISFIT: scatter > MISFIT_ABOVE,
            SunFlag.UNCERTAIN: not (across < UNCERTAIN_ABOVE * np.sin(zenith) and along < 2.0 * UNCERTAIN_ABOVE),
            SunFlag.NIGHT: night,
            SunFlag.ZENITH_DISAGREES: not night and abs(zenith - known) > np.radians(5.0) + 3.0 * along,
        }
    )


def _tilt_cov(sweep: Sweep, s_b: FloatArray, E_b: FloatArray) -> FloatArray:
    """What an uncertain vertical adds: the beam in the water is seen in the body, and unbent about the vertical."""
    beam = to_water(s_b[None], sweep.up_b, sweep.n)
    cov = np.zeros((2, 2))
    for axis in level_axes(sweep.up_b)[:2]:
        d = E_b.T @ (to_air(beam, tilted(sweep.up_b, 1e-3 * axis), sweep.n)[0] - s_b) / 1e-3
        cov += sweep.tilt_sigma**2 * np.outer(d, d)
    return cov


def _check(sweep: Sweep) -> None:
    if len(sweep) < 3:
        raise DataError(
            f"{len(sweep)} views are too few", where="sweep", remedy="give at least three directions of view"
        )
    for name in ("azimuth", "elevation", "aop", "sigma"):
        if not np.isfinite(getattr(sweep, name)).all():
            raise DataError("holds values that are not finite", where=f"sweep: {name}", remedy="leave those views out")
    if not (sweep.sigma > 0.0).all():
        raise DataError("holds sigmas that are not above 0", where="sweep: sigma", remedy="give the noise of each AoP")
