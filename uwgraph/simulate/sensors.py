"""From a motion to the streams of the aiding sensors: one settings class and one function each.

A ``...Model`` holds the rig's own entry (mounting, clock, stated noise) and what else the simulation needs. The noise
drawn is the noise the rig states, so the estimator is told the truth. Stamps are early by the rig's ``time_offset_s``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.dive.rig import DepthRig, DvlRig, Finite, FixesRig, HeadingRig, NonNegative, Positive, Settings, SunRig
from uwgraph.errors import DataError
from uwgraph.frames import R_n_local, geodetic_from_ned, rph_from_matrix, wrap_pi
from uwgraph.simulate.noise import Noise
from uwgraph.simulate.trajectory import Motion
from uwgraph.sun.ephemeris import sun_axes, sun_azimuth_elevation
from uwgraph.time import from_seconds, isoformat
from uwgraph.types import BoolArray, Depth, Dvl, Fixes, FloatArray, Heading, Sun


class DvlModel(Settings):
    """A Doppler log."""

    rig: DvlRig = DvlRig(translation_m=(0.4, 0.0, 0.15))
    rate_hz: Positive = 5.0
    outlier_fraction: NonNegative = 0.0
    """Share of pings, still called valid, that are wrong."""
    outlier_sigma: NonNegative = 1.0
    """m/s per axis, what is added to them."""
    losses_per_hour: NonNegative = 0.0
    """How often the bottom is lost at random, for 10 s on average."""
    lost_s: tuple[tuple[Finite, Finite], ...] = ()
    """Intervals (start, end) in seconds from the start in which the bottom is lost for sure."""


class DepthModel(Settings):
    """A depth sensor."""

    rig: DepthRig = DepthRig(translation_m=(-0.2, 0.0, -0.1))
    rate_hz: Positive = 5.0


class GnssModel(Settings):
    """A satellite receiver, which hears nothing below the surface."""

    rig: FixesRig = FixesRig(translation_m=(-0.6, 0.0, -0.6), sigma=2.0)
    rate_hz: Positive = 1.0


class HeadingModel(Settings):
    """Anything that tells the true heading: a compass, or the sun."""

    rig: HeadingRig = HeadingRig()
    rate_hz: Positive = 1.0


class SunModel(Settings):
    """A sensor of the sun's direction."""

    rig: SunRig = SunRig()
    rate_hz: Positive = 1.0
    azimuth_sigma_deg: Positive = 0.5
    """1-sigma of the azimuth, and so of the heading that it gives."""
    elevation_sigma_deg: Positive = 0.5
    min_elevation_deg: Finite = 5.0
    """Nothing is seen while the sun is lower."""


@dataclass(frozen=True, eq=False)
class DvlErrors:
    """What is drawn once for a dive."""

    scale: float
    """Error of the rig's scale: true velocity is ``rig.scale * (1 + scale)`` times the measured one."""
    misalignment: FloatArray
    """Rotation vector, shape (3,), rad: the true mounting is R_bs Exp(misalignment)."""

    @classmethod
    def draw(cls, rig: DvlRig, noise: Noise) -> DvlErrors:
        """Errors of the size that the rig states."""
        return cls(
            scale=float(noise.normal(rig.scale_sigma, (1,))[0]),
            misalignment=noise.normal(float(np.radians(rig.misalignment_sigma_deg)), (3,)),
        )


def measure_dvl(motion: Motion, model: DvlModel, errors: DvlErrors, noise: Noise) -> Dvl:
    """Velocity of the instrument over the bottom, R_sb (R_nb^T v_n + w_nb_b x l_b); zero where the bottom is lost."""
    t = _times(motion, model.rate_hz)
    v_b = np.einsum("nji,nj->ni", motion.attitude(t), motion.velocity(t))
    v_b += np.cross(motion.angular_rate(t), model.rig.l_b)
    R_bs = model.rig.R_bs @ Rotation.from_rotvec(errors.misalignment).as_matrix()
    v_s = v_b @ R_bs / (model.rig.scale * (1.0 + errors.scale)) + noise.normal(model.rig.sigma, (len(t), 3))
    wrong = noise.rng.random(len(t)) < model.outlier_fraction
    v_s[wrong] += model.outlier_sigma * noise.rng.standard_normal((int(wrong.sum()), 3))
    valid = _bottom_lock(t, model, noise)
    v_s[~valid] = 0.0
    return Dvl(
        _stamps(motion, t, model.rig.time_offset_ns),
        v_s=v_s,
        cov_s=np.tile(model.rig.sigma**2 * np.eye(3), (len(t), 1, 1)),
        valid=valid,
    )


def measure_depth(motion: Motion, model: DepthModel, noise: Noise) -> Depth:
    """Depth of the sensor along its local vertical."""
    t = _times(motion, model.rate_hz)
    _, _, height = geodetic_from_ned(motion.origin, _place(motion, t, model.rig.l_b))
    return Depth(
        _stamps(motion, t, model.rig.time_offset_ns),
        depth=-height + noise.normal(model.rig.sigma, (len(t),)),
        sigma=np.full(len(t), model.rig.sigma),
    )


def measure_fixes(motion: Motion, model: GnssModel, noise: Noise) -> Fixes:
    """Position of the antenna while it is above the water."""
    t = _times(motion, model.rate_hz)
    t = t[geodetic_from_ned(motion.origin, _place(motion, t, model.rig.l_b))[2] > 0.0]
    p_n = _place(motion, t, model.rig.l_b) + noise.normal(model.rig.sigma, (len(t), 3))
    lat, lon, height = geodetic_from_ned(motion.origin, p_n)
    return Fixes(
        _stamps(motion, t, model.rig.time_offset_ns),
        lat=lat,
        lon=lon,
        height=height,
        cov_n=np.tile(model.rig.sigma**2 * np.eye(3), (len(t), 1, 1)),
        source=np.full(len(t), "gnss"),
    )


def measure_heading(motion: Motion, model: HeadingModel, noise: Noise) -> Heading:
    """True heading against the local meridian."""
    t = _times(motion, model.rate_hz)
    sigma = float(np.radians(model.rig.sigma_deg))
    heading = rph_from_matrix(_R_lb(motion, t))[:, 2]
    return Heading(
        _stamps(motion, t, model.rig.time_offset_ns),
        heading=wrap_pi(heading + noise.normal(sigma, (len(t),))),
        sigma=np.full(len(t), sigma),
        reference="true",
    )


def measure_sun(motion: Motion, model: SunModel, noise: Noise) -> Sun:
    """Direction of the apparent sun in the body, with noise along azimuth and elevation.

    Raises
    ------
    DataError
        When the sun is never high enough during the motion.
    """
    t = _times(motion, model.rate_hz)
    t_ns = from_seconds(t, motion.start_ns)
    lat, lon, _ = geodetic_from_ned(motion.origin, motion.position(t))
    azimuth, elevation = sun_azimuth_elevation(t_ns, lat, lon)
    up = elevation > np.radians(model.min_elevation_deg)
    if not up.any():
        raise DataError(
            f"the sun is below {model.min_elevation_deg:g} deg all the time; it stands at "
            f"{np.degrees(elevation[0]):.1f} deg at {isoformat(int(t_ns[0]))}",
            where="sun",
            remedy="start by day, or leave the sun out",
        )
    t, azimuth, elevation = t[up], azimuth[up], elevation[up]
    sigma = np.radians([model.azimuth_sigma_deg, model.elevation_sigma_deg])
    tilted = elevation + noise.normal(sigma[1], (len(t),))
    turned = azimuth + noise.normal(sigma[0], (len(t),)) * np.cos(elevation) / np.cos(tilted)
    s_l, across_l, upward_l = sun_axes(turned, tilted)
    R_bl = np.swapaxes(_R_lb(motion, t), -1, -2)
    s_b, across, upward = (np.einsum("nij,nj->ni", R_bl, axis) for axis in (s_l, across_l, upward_l))
    var_across, var_upward = (sigma[0] * np.cos(elevation)) ** 2, np.full(len(t), sigma[1] ** 2)
    aa = np.einsum("ni,nj->nij", across, across)
    uu = np.einsum("ni,nj->nij", upward, upward)
    return Sun(
        _stamps(motion, t, model.rig.time_offset_ns),
        information_b=aa / var_across[:, None, None] + uu / var_upward[:, None, None],
        s_b=s_b,
        cov_b=aa * var_across[:, None, None] + uu * var_upward[:, None, None],
        method=np.full(len(t), "simulated"),
        quality=np.ones(len(t)),
        flags=np.zeros(len(t), dtype=np.int64),
    )


def _times(motion: Motion, rate_hz: float) -> FloatArray:
    return np.arange(int(np.floor(motion.duration_s * rate_hz + 1e-9)) + 1) / rate_hz


def _stamps(motion: Motion, t: FloatArray, offset_ns: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return from_seconds(t, motion.start_ns) - offset_ns


def _place(motion: Motion, t: FloatArray, l_b: FloatArray) -> FloatArray:
    """Position of a sensor at lever arm l_b, in n."""
    return motion.position(t) + motion.attitude(t) @ l_b


def _R_lb(motion: Motion, t: FloatArray) -> FloatArray:
    """Rotation body to local NED at the vehicle."""
    lat, lon, _ = geodetic_from_ned(motion.origin, motion.position(t))
    R: FloatArray = np.swapaxes(R_n_local(motion.origin, lat, lon), -1, -2) @ motion.attitude(t)
    return R


def _bottom_lock(t: FloatArray, model: DvlModel, noise: Noise) -> BoolArray:
    """Where the bottom is seen: random losses begin as a Poisson process and last 10 s on average."""
    count = int(noise.rng.poisson(model.losses_per_hour * (t[-1] - t[0]) / 3600.0))
    start = noise.rng.uniform(t[0], t[-1], count)
    lost = [*model.lost_s, *zip(start, start + noise.rng.exponential(10.0, count), strict=True)]
    valid = np.ones(len(t), dtype=np.bool_)
    for begin, end in lost:
        valid &= (t < begin) | (t >= end)
    return valid
