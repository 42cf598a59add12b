"""From a direction found by polarization to an observation: covariance, quality, and every doubt there is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uwgraph.sun.eigen import Solution
from uwgraph.sun.information import FLOOR, rank2
from uwgraph.sun.observation import GOOD, SunFlag, SunObservation, zenith_angle
from uwgraph.types import FloatArray

_FULL_SUPPORT: Final = 0.9  # of Gaussian noise alone


@dataclass(frozen=True)
class SkyError:
    """How far the pole of the real sky's polarization is from the sun, 1-sigma, rad.

    Light scattered more than once moves it along the sun's vertical (neutral points), hardly across it, since the sky
    is symmetric about the solar meridian.
    """

    along: float = np.radians(1.0)
    across: float = np.radians(0.1)


@dataclass(frozen=True)
class Gates:
    """When a direction must not be used; angles in rad."""

    near_zenith: float = np.radians(5.0)
    """Least zenith angle of the sun."""
    rivalry: float = 0.1
    """Most support of a second direction, over that of the first, above chance."""
    support: float = 2.0
    """Least support in units of what e-vectors of random angle give."""
    excess: float = np.radians(3.5)
    """Most departure of the sky from the model, 1-sigma."""
    zenith: float = np.radians(3.0)
    """Most difference of the zenith angles found and known, beyond three sigmas of both."""
    azimuth_sigma: float = np.radians(5.0)
    """Most 1-sigma of the azimuth."""
    mirror_sigmas: float = 4.0
    """By how many sigmas the sun must be found above the horizon: its pattern is the same from the opposite side."""


def observation(
    solution: Solution,
    cov: FloatArray,
    up_b: FloatArray,
    *,
    sun_zenith: float | None = None,
    tilt_sigma: float = 0.0,
    t_ns: int = 0,
    flags: SunFlag = GOOD,
    share: float = 1.0,
    sky_error: SkyError | None = None,
    gates: Gates | None = None,
) -> SunObservation:
    """The observation of a solution.

    Parameters
    ----------
    cov : shape (2, 2)
        Covariance along ``solution.fit.E``, rad^2, before the floor of the calibration.
    sun_zenith, tilt_sigma
        The almanac's zenith angle and the 1-sigma of roll and of pitch, rad.
    flags
        Doubts from before.
    share : float
        Share of the sky in view that was used, 0 to 1, for the quality.
    sky_error
        Covariance that no image knows of.
    """
    gates, sky_error = gates or Gates(), sky_error or SkyError()
    fit = solution.fit
    zenith = zenith_angle(fit.s_b, up_b)
    steepest = fit.E.T @ up_b / max(np.sin(zenith), 1e-9)
    certain = bool(np.isfinite(cov).all())
    agreement = _agreement(solution)
    cov = cov / agreement if certain else np.eye(2) * np.pi**2  # what hides the sky is no noise, and may pull
    cov = cov + (sky_error.along**2 - sky_error.across**2) * np.outer(steepest, steepest)
    cov = cov + (sky_error.across**2 + FLOOR**2) * np.eye(2)
    information, cov_b = rank2(fit.E, cov)
    zenith_sigma = float(np.hypot(np.sqrt(steepest @ cov @ steepest), tilt_sigma))
    known = zenith if sun_zenith is None else sun_zenith

    rival = None
    if _mirrored(zenith, known, zenith_sigma, gates):
        rival = -fit.s_b
    elif solution.rivalry > gates.rivalry:
        rival = solution.rival_b
    doubts = {
        SunFlag.AMBIGUOUS: rival is not None,
        SunFlag.NEAR_ZENITH: zenith < gates.near_zenith,
        SunFlag.NIGHT: known > np.pi / 2.0,
        SunFlag.MISFIT: fit.support < gates.support * fit.chance or fit.excess > gates.excess,
        SunFlag.ZENITH_DISAGREES: abs(zenith - known) > gates.zenith + 3.0 * zenith_sigma,
        SunFlag.UNCERTAIN: not certain,
    }
    flags |= SunFlag.of(doubts)
    found = SunObservation(
        t_ns, fit.s_b, information, cov_b, "polarization", _quality(solution, share), flags, up_b, rival
    )
    if found.azimuth_sigma < gates.azimuth_sigma:
        return found
    return replace(found, flags=flags | SunFlag.UNCERTAIN)


def _mirrored(zenith: float, known: float, sigma: float, gates: Gates) -> bool:
    """Whether s and -s, whose patterns are the same, cannot be told apart by which is above the horizon.

    Twice the logarithm of their likelihoods' ratio is 4 h_found h_known / sigma^2, h the heights above the horizon.
    """
    return 4.0 * (np.pi / 2.0 - zenith) * abs(np.pi / 2.0 - known) < (gates.mirror_sigmas * sigma) ** 2


def _agreement(solution: Solution) -> float:
    """Support above chance: 1 where the whole sky in view agrees."""
    fit = solution.fit
    return float(np.clip((fit.support - fit.chance) / (_FULL_SUPPORT - fit.chance), 0.01, 1.0))


def _quality(solution: Solution, share: float) -> float:
    """Agreement, closeness to the model and share of the view, each 1 for a perfect sky."""
    closeness = 1.0 / (1.0 + (solution.fit.excess / np.radians(2.0)) ** 2)
    return float(_agreement(solution) * closeness * np.sqrt(np.clip(share, 0.0, 1.0)))
