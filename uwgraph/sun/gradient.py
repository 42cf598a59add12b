"""The sun from the gradient of the light: one image in, one observation out.

The plain form holds for a sky whose light depends on the angle from the sun alone, the ring form for one that depends
on the zenith angle too. Which is used is decided by the spectrum of the plain one and by its agreement with the other.
Either gives the start for the additive fit, its own integral, which needs no derivative.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.model import check_size
from uwgraph.camera.sensor import Sensor
from uwgraph.sun.gradient_additive import AdditiveResult, Sky, additive_sun, jackknife, moved, refit
from uwgraph.sun.gradient_field import GradientField, SkyLight, gradient_field, sky_light
from uwgraph.sun.gradient_plain import PlainResult, plain_sun
from uwgraph.sun.gradient_ring import RingResult, ring_sun
from uwgraph.sun.information import FLOOR, block_numbers, rank2
from uwgraph.sun.observation import (
    GOOD,
    SunFlag,
    SunObservation,
    azimuth_in_level,
    level_axes,
    no_sun,
    tilted,
    zenith_angle,
)
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

Form = Literal["plain", "ring"]
LEAST_CELLS = 150
"""Fewer binned pixels of clear sky say nothing about a sun."""
TILT_STEP = np.radians(0.5)
SECTORS = 6


@dataclass(frozen=True)
class GradientSettings:
    """How an image is reduced, and when its sun must not be used; angles in rad."""

    cells: int = 4096
    """The image is binned to about this many pixels."""
    blur: float = 1.2
    """Standard deviation of the Gaussian before differentiation, binned pixels."""
    optical_depth: float = 0.0
    """Attenuation k times depth z of the water above, for the plain form; the ring form finds it."""
    blocks: int = 12
    """Along the longer side; pixels of a block err together."""
    plain_quality: float = 1e-3
    """The plain form is used where its smallest eigenvalue is at most this of the second: 0.5 on a CIE clear sky."""
    plain_apart: float = np.radians(1.0)
    """And where the ring form is no farther from it."""
    waves: float = 1.5
    """Factor on the covariance under water: neighbouring blocks see the same waves."""
    wave_sigma: float = np.radians(0.3)
    """By how much waves longer than the view move the sun, 1-sigma: for 3 m/s of wind; 1.5 degrees at 6 m/s."""
    water_zenith: float = np.radians(3.5)
    """1-sigma of the height under water, where scattering shifts the light: towards the zenith with depth."""
    near_zenith: float = np.radians(8.0)
    """Least zenith angle of the sun."""
    coverage: float = 0.35
    """Least share of the azimuth circle that must show clear sky."""
    overexposed: float = 0.5
    """Most share of the sky in view that may be overexposed."""
    contrast: float = 0.06
    """Least standard deviation of ln L that the sun must account for beyond the zenith angle."""
    explained: float = 0.985
    """Least share of the light's variance beyond the zenith angle that the sun must account for."""
    agreeing: float = 0.75
    """Least mean robust weight of the pixels that the masks left."""
    rivalry: float = 1.25
    """Least objective of the second best direction over that of the best."""
    zenith: float = np.radians(8.0)
    """Most difference between the zenith angles found and known, beyond three sigmas."""
    azimuth_sigma: float = np.radians(1.5)
    """Most 1-sigma of the azimuth."""


@dataclass(frozen=True, eq=False)
class GradientEstimate:
    """The observation, and all that led to it (None where it did not come so far)."""

    observation: SunObservation
    light: SkyLight
    form: Form | None = None
    field: GradientField | None = None
    plain: PlainResult | None = None
    ring: RingResult | None = None
    fit: AdditiveResult | None = None


def estimate(
    image: NDArray[Any], view: View, sensor: Sensor | None = None, settings: GradientSettings | None = None
) -> GradientEstimate:
    """Find the sun in one image of the sky, (H, W), linear in the light, or (H, W, 3) of which green is used.

    Green has most of a colour sensor's pixels, and is less overexposed about the sun than blue. A mean of T images is
    one image with a sensor of T times the gain. A power law in place of linearity (gamma) does not move the sun, only
    the noise.

    Raises
    ------
    DataError
        When the image is not of the camera's size.
    """
    settings = settings or GradientSettings()
    gray = image[:, :, 1] if image.ndim == 3 else image
    check_size(view.camera, gray)
    sensor = sensor or Sensor.of(gray)
    factor = max(1, round(float(np.sqrt(gray.size / settings.cells))))
    light = sky_light(gray, view, sensor, factor, settings.optical_depth)
    flags = _light_flags(light, view, settings)
    if flags:
        return GradientEstimate(no_sun("gradient", flags, view.up_b, view.t_ns), light)
    field = gradient_field(light, settings.blur)
    if len(field.a) < LEAST_CELLS:
        return GradientEstimate(no_sun("gradient", SunFlag.SMALL_WINDOW, view.up_b, view.t_ns), light)
    plain = plain_sun(field, view.up_b)
    ring = ring_sun(field, view.up_b, view.sun_zenith)
    form: Form = "plain" if _plain_holds(plain, ring, settings) else "ring"
    start = plain.s if form == "plain" else ring.s
    sky = _sky(light, view.up_b, settings.blocks)
    free = additive_sun(sky, start, rings=form == "ring")
    fit, cov = free, free.cov
    if view.sun_zenith is not None:
        start = moved(start, view.up_b, np.array([view.sun_zenith - zenith_angle(start, view.up_b), 0.0]))
        fit = additive_sun(sky, start, rings=form == "ring", free_zenith=False)
        # the height that was imposed is no news: its variance stays what the image alone would give
        cov = np.diag([free.cov[0, 0], fit.cov[1, 1]])
    if view.in_water:
        cov = settings.waves * cov + np.diag([settings.water_zenith, settings.wave_sigma]) ** 2
    cov = cov + FLOOR**2 * np.eye(2)
    cov += _sector_covariance(sky, fit, view, form)
    cov += _tilt_covariance(sky, light, fit, view, form)
    flags = _flags(free, fit, ring, form, cov, sky, view, settings)
    observation = _observation(fit, ring, cov, flags, light, view)
    return GradientEstimate(observation, light, form, field, plain, ring, fit)


def _plain_holds(plain: PlainResult, ring: RingResult, settings: GradientSettings) -> bool:
    near = bool(plain.s @ ring.s > np.cos(settings.plain_apart))
    return plain.signs_agree and near and plain.quality < settings.plain_quality


def _light_flags(light: SkyLight, view: View, settings: GradientSettings) -> SunFlag:
    """What can be said before any sun is looked for."""
    flags = GOOD
    if view.sun_zenith is not None and view.sun_zenith > np.pi / 2.0:
        flags |= SunFlag.NIGHT
    if light.sky.sum() < LEAST_CELLS:
        return flags | SunFlag.SMALL_WINDOW
    if light.overexposed > settings.overexposed:
        flags |= SunFlag.SATURATED
    elif np.quantile(light.noise_share[light.sky], 0.1) > 1.0:
        flags |= SunFlag.DARK
    elif light.good.sum() < LEAST_CELLS:
        flags |= SunFlag.SMALL_WINDOW
    return flags


def _flags(
    free: AdditiveResult,
    fit: AdditiveResult,
    ring: RingResult,
    form: Form,
    cov: FloatArray,
    sky: Sky,
    view: View,
    settings: GradientSettings,
) -> SunFlag:
    """Every doubt about the sun that was found."""
    zenith = zenith_angle(fit.s, view.up_b)
    known = zenith if view.sun_zenith is None else view.sun_zenith
    off = abs(zenith_angle(free.s, view.up_b) - known)
    sectors = np.histogram(azimuth_in_level(sky.a, view.up_b), bins=36, range=(-np.pi, np.pi))[0]
    doubts = {
        SunFlag.SMALL_WINDOW: float((sectors > 0).mean()) < settings.coverage,
        SunFlag.NEAR_ZENITH: zenith < settings.near_zenith,
        SunFlag.UNIFORM: fit.contrast < settings.contrast,
        SunFlag.MISFIT: fit.explained < settings.explained or fit.weight.mean() < settings.agreeing,
        SunFlag.AMBIGUOUS: ring.contrast < settings.rivalry,
        SunFlag.SIGN: not (fit.grows and (ring.grows or form == "plain")),
        SunFlag.ZENITH_DISAGREES: off > settings.zenith + 3.0 * np.sqrt(cov[0, 0]),
        SunFlag.UNCERTAIN: not fit.converged or not np.sqrt(cov[1, 1]) < settings.azimuth_sigma * np.sin(zenith),
    }
    return SunFlag.of(doubts)


def _sector_covariance(sky: Sky, fit: AdditiveResult, view: View, form: Form) -> FloatArray:
    """How far the sun moves as one sector of the sky after the other is left out."""
    sector = np.floor(azimuth_in_level(sky.a, view.up_b) / (2.0 * np.pi) * SECTORS).astype(np.intp)
    return jackknife(sky, fit, sector, rings=form == "ring", free_zenith=view.sun_zenith is None)


def _tilt_covariance(sky: Sky, light: SkyLight, fit: AdditiveResult, view: View, form: Form) -> FloatArray:
    """What a wrong vertical does to the sun along ``fit.E``: rays are bent, and rings laid, about it."""
    cov = np.zeros((2, 2))
    if view.tilt_sigma == 0.0:
        return cov
    known = view.sun_zenith is not None
    reference = refit(sky, fit, rings=form == "ring", free_zenith=not known)
    for axis in level_axes(view.up_b)[:2]:
        up = tilted(view.up_b, TILT_STEP * axis)
        there = replace(sky, a=light.directions(light.good, up), up=up)
        s = fit.s
        if view.sun_zenith is not None:
            s = moved(s, up, np.array([view.sun_zenith - zenith_angle(s, up), 0.0]))
        moved_s = refit(there, replace(fit, s=s), rings=form == "ring", free_zenith=not known)
        d = fit.E.T @ (moved_s - reference) * (view.tilt_sigma / TILT_STEP)
        cov += np.outer(d, d)
    return cov


def _sky(light: SkyLight, up_b: FloatArray, blocks: int) -> Sky:
    good = light.good
    number = np.unique(block_numbers(good.shape, np.flatnonzero(good), blocks), return_inverse=True)[1]
    axis = light.view.camera.R_bs[:, 2]
    w = light.view.body_rays()[0][good.ravel()]
    off_axis2 = 1.0 - w @ axis
    return Sky(
        light.directions(good, up_b),
        light.log_l[good],
        light.variance[good],
        number.astype(np.intp),
        up_b,
        off_axis2 / max(float(off_axis2.max()), 1e-9),
    )


def _observation(
    fit: AdditiveResult, ring: RingResult, cov: FloatArray, flags: SunFlag, light: SkyLight, view: View
) -> SunObservation:
    information, cov_b = rank2(fit.E, cov)
    other = ring.other if SunFlag.AMBIGUOUS in flags else None
    quality = fit.explained * float(light.good.sum() / light.sky.sum())
    return SunObservation(view.t_ns, fit.s, information, cov_b, "gradient", quality, flags, view.up_b, other)
