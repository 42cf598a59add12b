"""The sun from a polarization image: in air, or through the surface from under water.

In air every pixel's e-vector is orthogonal to the sun. Under water the e-vectors are carried through the surface
first; the water's own depolarization is one unknown, kappa, chosen so that the sky fits the model best, with the
sun's height from the almanac where it is known. kappa is then estimated beside the direction, so that the height that
chose it is not counted as measured.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from uwgraph.errors import DataError
from uwgraph.sun.eigen import Evectors, Robust, Solution, covariance, evenly, refine, solve
from uwgraph.sun.evector import IndexArray, Light, Unknowns, light_of, skylight
from uwgraph.sun.information import block_numbers
from uwgraph.sun.observation import GOOD, SunFlag, SunObservation, level_axes, no_sun, tilted
from uwgraph.sun.stokes import StokesImage
from uwgraph.sun.unknowns import Prior, depolarization, derivatives, settled
from uwgraph.sun.verdict import Gates, SkyError, observation
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

_HOPELESS: Final = SunFlag.DARK | SunFlag.SATURATED | SunFlag.UNPOLARIZED | SunFlag.SMALL_WINDOW
_TILT: Final = np.radians(0.5)


@dataclass(frozen=True)
class Settings:
    """Settings of :func:`estimate`; angles in rad."""

    max_zenith_air: float = np.radians(85.0)
    """Sky farther from the zenith is not used."""
    max_zenith_water: float = np.radians(75.0)
    """The same under water (angle above the surface): near the window's edge the surface magnifies every error."""
    dop_error: float = 0.002
    """Error of the degree of polarization from the sensor itself (gains, crosstalk), 1-sigma."""
    least_dop: float = 0.02
    """Degree of polarization that a tenth of the sky in view must exceed."""
    least_significance: float = 3.0
    """Polarized part over its noise, below which a pixel's angle is at random rather than noisy."""
    least_share: float = 0.05
    """Share of the pixels in view whose polarization must stand out of the noise."""
    least_pixels: int = 100
    """Pixels that must see the sky."""
    uniform: float = 0.03
    """Spread of ln intensity below which light without polarization is called uniform."""
    redundancy: float = 0.2
    """Most that the four channels may contradict each other, over the polarized part: their order is wrong else."""
    blocks_air: int = 12
    """Blocks along the longer side of the image; e-vectors within a block may err together."""
    blocks_water: int = 6
    """The same under water, where a wave is wide."""
    search: int = 3000
    """Pixels that vote, and start the search for the direction and the unknowns; the last steps take all."""
    wave_inflation: float = 2.5
    """Factor on the covariance under water: waves err together beyond a block."""
    prior: Prior = field(default_factory=Prior)
    sky_error: SkyError = field(default_factory=lambda: SkyError(along=np.radians(0.3), across=np.radians(0.1)))
    veil_error: float = np.radians(2.5)
    """1-sigma of the sun's height for each unit of ln kappa that the water took of the polarization."""
    robust: Robust = field(default_factory=Robust)
    gates: Gates = field(default_factory=Gates)


@dataclass(frozen=True, eq=False)
class PolarizationEstimate:
    """An observation and what it came from; arrays have one row for each pixel in use."""

    observation: SunObservation
    image: StokesImage
    pixels: IndexArray
    """Flat indices into the image, shape (N,)."""
    sky: Evectors | None
    """Directions and e-vectors in the sky; None where no pixel was of use."""
    solution: Solution | None
    unknowns: Unknowns = Unknowns()  # noqa: RUF009  (frozen)
    """What was found beside the sun."""


def estimate(image: StokesImage, view: View, settings: Settings | None = None) -> PolarizationEstimate:
    """The sun's direction from a Stokes image; ``view`` is that of the camera as it is, before binning.

    Raises
    ------
    DataError
        The image is not of the camera's size.
    """
    settings = settings or Settings()
    view = view.binned(image.factor)
    if image.I.shape[::-1] != view.camera.size:
        raise DataError(
            f"the image has {image.I.shape[::-1]} pixels and the camera {view.camera.size} (width, height, binned)",
            where="camera file",
            remedy="give the camera file that belongs to this image",
        )
    pixels, share, flags = _screened(image, view, settings)
    if flags & _HOPELESS:
        return PolarizationEstimate(no_sun("polarization", flags, view.up_b, view.t_ns), image, pixels, None, None)
    blocks = settings.blocks_water if view.in_water else settings.blocks_air
    light = light_of(image, view, pixels, block_numbers(image.I.shape, pixels, blocks), settings.dop_error)
    sky, solution, cov, unknowns = _solved(light, view, settings)
    found = observation(
        solution,
        cov,
        view.up_b,
        sun_zenith=view.sun_zenith,
        tilt_sigma=view.tilt_sigma,
        t_ns=view.t_ns,
        flags=flags,
        share=share,
        sky_error=_sky_error(unknowns, settings),
        gates=settings.gates,
    )
    return PolarizationEstimate(found, image, pixels, sky, solution, unknowns)


def _sky_error(unknowns: Unknowns, settings: Settings) -> SkyError:
    """Light scattered in the water has its own pattern about the refracted sun, and lifts or sinks the pole."""
    along = np.hypot(settings.sky_error.along, settings.veil_error * unknowns.log_kappa)
    return replace(settings.sky_error, along=float(along))


def _screened(image: StokesImage, view: View, settings: Settings) -> tuple[IndexArray, float, SunFlag]:
    """Flat indices of the pixels of use, their share of the sky in view, and doubts."""
    limit = settings.max_zenith_water if view.in_water else settings.max_zenith_air
    in_sky = view.sky_rays() @ view.up_b > np.cos(limit)
    seen = int(in_sky.sum())
    if seen < max(settings.least_pixels, 0.02 * in_sky.size):
        return np.flatnonzero(in_sky), 0.0, SunFlag.SMALL_WINDOW
    saturated, dark = image.saturated.ravel() & in_sky, image.dark.ravel() & in_sky
    pixels = np.flatnonzero(in_sky & ~saturated & ~dark)
    share = len(pixels) / seen
    if share < 0.5 and max(saturated.sum(), dark.sum()) > 0.45 * seen:
        return pixels, share, SunFlag.SATURATED if saturated.sum() > dark.sum() else SunFlag.DARK
    if len(pixels) < settings.least_pixels:
        return pixels, share, SunFlag.SMALL_WINDOW
    I, Q, U, sigma = (x.ravel()[pixels] for x in (image.I, image.Q, image.U, image.sigma))  # noqa: E741
    degree, noise = np.hypot(Q, U) / I, np.hypot(sigma / I, settings.dop_error)
    polarized = degree > settings.least_significance * noise
    if polarized.mean() < settings.least_share or np.quantile(degree, 0.9) < settings.least_dop:
        uniform = SunFlag.UNIFORM if np.std(np.log(I)) < settings.uniform else GOOD
        return pixels, share, SunFlag.UNPOLARIZED | uniform
    doubts = SunFlag.MISFIT if image.redundancy > settings.redundancy else GOOD
    return pixels[polarized], share * float(polarized.mean()), doubts


def _solved(light: Light, view: View, settings: Settings) -> tuple[Evectors, Solution, FloatArray, Unknowns]:
    """The sky, the solution in it, its covariance, and the unknowns found beside it."""
    above, robust, prior = skylight(light, view.up_b, view.n), settings.robust, settings.prior
    few = evenly(len(light.I), settings.search)
    thin = above.select(few)
    unknowns = depolarization(thin, view, robust) if view.in_water else Unknowns()
    solution = solve(thin.evectors(unknowns), view.up_b, view.sun_zenith, robust)
    _, fit, unknowns = settled(thin, solution.fit, unknowns, view, robust, prior, steps=4)
    excess = refine(thin.evectors(unknowns), fit.s_b, view.up_b, robust).excess
    sky, fit, unknowns = settled(above, replace(fit, excess=excess), unknowns, view, robust, prior, steps=4)
    nuisance = derivatives(above, sky, fit.s_b, unknowns, view.in_water)
    cov = covariance(sky, fit, nuisance, prior.sigma(view.in_water))
    if view.in_water:
        by_tilt = fit.E.T @ _tilt_effect(light.select(few), view, fit.s_b, unknowns, robust)
        cov = settings.wave_inflation * cov + view.tilt_sigma**2 * by_tilt @ by_tilt.T
    return sky, replace(solution, fit=fit), cov, unknowns


def _tilt_effect(light: Light, view: View, s_b: FloatArray, unknowns: Unknowns, robust: Robust) -> FloatArray:
    """Derivative (3, 2) of the direction by a tilt of the assumed vertical about two horizontal axes.

    The rays are bent about the assumed vertical, and the direction in the body moves with it.
    """
    if view.tilt_sigma == 0.0:
        return np.zeros((3, 2))
    columns = []
    for axis in level_axes(view.up_b)[:2]:
        there, back = (
            refine(_tilted(light, view, sign * _TILT * axis, unknowns), s_b, view.up_b, robust).s_b
            for sign in (1.0, -1.0)
        )
        columns.append((there - back) / (2.0 * _TILT))
    return np.stack(columns, axis=1)


def _tilted(light: Light, view: View, tilt: FloatArray, unknowns: Unknowns) -> Evectors:
    return skylight(light, tilted(view.up_b, tilt), view.n).evectors(unknowns)
