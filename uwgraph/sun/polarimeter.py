"""A compass of units that each look at one direction of the sky through several polarizers onto photodiodes.

A unit's photodiodes k behind polarizers at angles beta_k count

    f_k = dark + g_k (I + Q cos 2 beta_k + U sin 2 beta_k),

which is solved for the intensity I and for Q and U by least squares: one e-vector a unit. The sun is found from them as
from the pixels of an image. A unit that is saturated (the sun shines in), whose photodiodes contradict each other, or
that sees no polarization has no say at that sample.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.errors import DataError
from uwgraph.sun.eigen import Robust, covariance, solve
from uwgraph.sun.evector import Light, Unknowns, skylight
from uwgraph.sun.observation import SunFlag, SunObservation, no_sun
from uwgraph.sun.verdict import Gates, SkyError, observation
from uwgraph.types import BoolArray, FloatArray, TimeArray

UP: Final = np.array([0.0, 0.0, -1.0])
"""Zenith in a level body."""

_LEAST_UNITS: Final = 3


@dataclass(frozen=True, eq=False)
class Polarimeter:
    """Calibration of U units with K photodiodes each."""

    R_bu: FloatArray
    """Rotation of each unit's frame to the body, shape (U, 3, 3): z looks out, polarizers count from x towards y."""
    angles: FloatArray
    """Polarizer angles beta, rad, shape (U, K)."""
    gains: FloatArray
    """Counts per light g of the photodiodes, relative within a unit, shape (U, K)."""
    good: BoolArray
    """Photodiodes in use, shape (U, K): none or at least three of a unit."""
    saturation: float
    """Counts from which on a photodiode is saturated."""
    error: FloatArray
    """Departure of counts from the model over the intensity (sky and unit together), 1-sigma, shape (U,)."""
    twice: float = 0.0
    """Light scattered twice, as the calibration's sky had it, see :class:`uwgraph.sun.evector.Unknowns`."""
    dark: float = 0.0
    """Counts of no light."""
    noise: float = 1.0
    """Noise of the counts at any light, 1-sigma."""

    @property
    def directions_b(self) -> FloatArray:
        """Where the units look, in the body, shape (U, 3)."""
        return self.R_bu[:, :, 2]

    @property
    def in_use(self) -> BoolArray:
        """Units in use, shape (U,)."""
        return np.asarray(self.good.any(axis=1))


@dataclass(frozen=True, eq=False)
class Readings:
    """What the units counted at N samples on a level body that turned."""

    t_ns: TimeArray
    """Stamps, shape (N,), int64 nanoseconds UTC."""
    counts: FloatArray
    """Shape (N, U, K)."""
    yaw: FloatArray
    """Clockwise seen from above, up to a constant, rad, shape (N,), unwrapped."""
    sun_azimuth: FloatArray
    """From the almanac, clockwise from north, rad, shape (N,)."""
    sun_zenith: FloatArray
    """Of the apparent sun, from the almanac, rad, shape (N,)."""

    @property
    def fresh(self) -> BoolArray:
        """Whether a unit's counts are new at a sample, shape (N, U): a slow bus repeats the last ones in between.

        Nobody knows how old the first ones are.
        """
        fresh = np.zeros(self.counts.shape[:2], dtype=np.bool_)
        fresh[1:] = (np.diff(self.counts, axis=0) != 0.0).any(axis=2)
        return fresh

    @property
    def read_yaw(self) -> FloatArray:
        """Yaw when the counts were read, shape (N, U).

        Of a unit whose counts mostly repeat, midway between the sample that has them first and the one before; of any
        other, that of the sample.
        """
        fresh = self.fresh
        between = np.concatenate([self.yaw[:1], (self.yaw[1:] + self.yaw[:-1]) / 2.0])
        first = np.maximum.accumulate(np.where(fresh, np.arange(len(self.yaw))[:, None], 0), axis=0)
        return np.where(fresh.mean(axis=0) < 0.5, between[first], self.yaw[:, None])

    @property
    def turned(self) -> FloatArray:
        """How far the body has turned since the counts were read, rad clockwise, shape (N, U)."""
        return self.yaw[:, None] - self.read_yaw


@dataclass(frozen=True)
class Settings:
    """Settings of :func:`observe`; angles in rad."""

    contradiction: float = 4.0
    """Most contradiction between a unit's photodiodes, in its sigmas."""
    significance: float = 4.0
    """Least polarization of a unit, in its sigmas."""
    sky_error: SkyError = field(default_factory=lambda: SkyError(along=np.radians(2.0), across=np.radians(0.3)))
    """Along the sun's vertical the sky of another day scatters twice more, or less, than the calibration's."""
    robust: Robust = field(default_factory=Robust)
    gates: Gates = field(default_factory=Gates)


@dataclass(frozen=True, eq=False)
class UnitStokes:
    """What each unit sees, about its own axes."""

    I: FloatArray  # noqa: E741  (the field's symbol)
    Q: FloatArray
    U: FloatArray
    sigma: FloatArray
    """1-sigma of Q and of U, shape (U,)."""
    contradiction: FloatArray
    """What the photodiodes leave unexplained, in sigmas, shape (U,); 0 for three, which cannot contradict."""

    @property
    def polarized(self) -> FloatArray:
        """Intensity of the polarized part, shape (U,)."""
        return np.hypot(self.Q, self.U)


def unit_stokes(polarimeter: Polarimeter, counts: FloatArray) -> UnitStokes:
    """Least squares over the good photodiodes of each unit; ``counts`` has shape (U, K)."""
    beta, good = polarimeter.angles, polarimeter.good
    design = np.stack([np.ones_like(beta), np.cos(2.0 * beta), np.sin(2.0 * beta)], axis=2) * good[:, :, None]
    light = np.where(good, (counts - polarimeter.dark) / polarimeter.gains, 0.0)
    inverse = np.linalg.pinv(design)
    I, Q, U = S = np.einsum("uik,uk->iu", inverse, light)  # noqa: E741
    left = np.sqrt(((light - np.einsum("uki,iu->uk", design, S)) ** 2).sum(axis=1))
    sigma = np.hypot(polarimeter.error * I, polarimeter.noise)
    spare = good.sum(axis=1) - 3
    contradiction = np.where(spare > 0, left / (sigma * np.sqrt(np.maximum(spare, 1))), 0.0)
    spread = np.sqrt((inverse[:, 1:] ** 2).sum(axis=(1, 2)) / 2.0)
    return UnitStokes(I, Q, U, sigma * spread, contradiction)


def observe(
    polarimeter: Polarimeter,
    counts: FloatArray,
    turned: FloatArray | float = 0.0,
    up_b: FloatArray = UP,
    *,
    sun_zenith: float | None = None,
    tilt_sigma: float = 0.0,
    t_ns: int = 0,
    settings: Settings | None = None,
) -> SunObservation:
    """The sun's direction in the body from one sample.

    Parameters
    ----------
    counts : shape (U, K)
        NaN for what was not read.
    turned : shape (U,), or scalar
        How far the body has turned since each unit was read, rad clockwise seen from above.
    up_b : shape (3,)
        Zenith in the body.
    sun_zenith, tilt_sigma
        The almanac's zenith angle of the apparent sun, which tells rivals apart, and the 1-sigma of roll and of pitch
        behind ``up_b``, rad.

    Raises
    ------
    DataError
        The counts are not of the polarimeter's shape.
    """
    settings = settings or Settings()
    if counts.shape != polarimeter.good.shape:
        raise DataError(
            f"the counts have shape {counts.shape} and the polarimeter {polarimeter.good.shape} (units, photodiodes)",
            where="counts",
            remedy="give the calibration of this very compass",
        )
    seen = unit_stokes(polarimeter, counts)
    units, doubt = _screened(polarimeter, counts, seen, settings)
    if len(units) < _LEAST_UNITS:
        return no_sun("polarization", doubt, up_b, t_ns)
    back = Rotation.from_rotvec(np.outer(np.broadcast_to(turned, len(counts))[units], up_b)).as_matrix()
    R = back @ polarimeter.R_bu[units]  # a place in the sky goes counter-clockwise as the body turns clockwise
    I, Q, U, sigma = (x[units] for x in (seen.I, seen.Q, seen.U, seen.sigma))  # noqa: E741
    light = Light(R[:, :, 2], R[:, :, 0], I, Q, U, sigma, np.arange(len(units)))
    sky = skylight(light, up_b, 1.0).evectors(Unknowns(twice=polarimeter.twice))
    solution = solve(sky, up_b, sun_zenith, settings.robust)
    return observation(
        solution,
        covariance(sky, solution.fit),
        up_b,
        sun_zenith=sun_zenith,
        tilt_sigma=tilt_sigma,
        t_ns=t_ns,
        share=len(units) / int(polarimeter.in_use.sum()),
        sky_error=settings.sky_error,
        gates=settings.gates,
    )


def _screened(
    polarimeter: Polarimeter, counts: FloatArray, seen: UnitStokes, settings: Settings
) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], SunFlag]:
    """Numbers of the units that have a say, and the commonest reason of the others not to."""
    left = polarimeter.in_use & np.isfinite(seen.I)
    reasons = {
        SunFlag.SATURATED: ((counts >= polarimeter.saturation) & polarimeter.good).any(axis=1),
        SunFlag.DARK: seen.I / polarimeter.noise < settings.significance,
        SunFlag.MISFIT: (seen.contradiction > settings.contradiction) | (seen.polarized > seen.I),
        SunFlag.UNPOLARIZED: seen.polarized < settings.significance * seen.sigma,
    }
    counted = {SunFlag.SMALL_WINDOW: 0}
    for flag, applies in reasons.items():
        counted[flag] = int((left & applies).sum())
        left = left & ~applies
    return np.flatnonzero(left), max(counted, key=lambda flag: counted[flag])
