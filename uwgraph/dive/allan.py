"""Allan variance of a still sensor, and the noise terms of IEEE Std 952-1997 (annex C) that explain it.

The terms are powers: quantisation ``Q^2``, white noise ``N^2``, bias instability ``B^2`` and rate random walk ``K^2``;
the Allan variance is a sum of each times a known function of the averaging time. Estimates at neighbouring averaging
times err together, so the terms are fitted by generalised least squares, with the covariance that the fitted terms
themselves give the estimates (Percival & Walden, Wavelet Methods for Time Series Analysis, 8.3: the Allan variance is
twice the Haar wavelet variance; Guerrier et al., JASA 108, 2013, for the fit).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve, toeplitz

from uwgraph.types import FloatArray

TERMS: Final = ("Q", "N", "B", "K")
LONGEST: Final = 8
"""The longest averaging time is this fraction of the record: beyond it there is next to nothing to average."""

_ITERATIONS: Final = 20
_PER_OCTAVE: Final = 24
_GRID: Final = 256


@dataclass(frozen=True, eq=False)
class AllanVariance:
    """Overlapping Allan variance of one signal at averaging times of 1, 2, 4, ... samples."""

    tau_s: FloatArray
    """Averaging times, shape (M,), s."""
    variance: FloatArray
    """Shape (M,), signal units squared."""
    duration_s: float
    """Length of the record."""

    @property
    def rate_hz(self) -> float:
        return float(1.0 / self.tau_s[0])


@dataclass(frozen=True, eq=False)
class Fit:
    """Powers of some of the ``TERMS``, fitted to one Allan variance."""

    terms: tuple[str, ...]
    power: FloatArray
    """Shape (P,); may come out negative where a term is not there."""
    cov: FloatArray
    """Shape (P, P)."""
    chi2: float
    """Of the residuals, with ``dof`` degrees of freedom."""
    dof: int


def allan_variance(y: FloatArray, rate_hz: float) -> AllanVariance:
    """Overlapping Allan variance of equally spaced samples, each the mean over its interval, shape (N,).

    From second differences of the integral (NIST SP 1065, 5.5); memory is a few copies of ``y``.
    """
    x = np.concatenate([[0.0], np.cumsum(y - y.mean())])
    factors = 2 ** np.arange(max(int(np.log2(max(len(y) / LONGEST, 1.0))), 0) + 1)
    variance = np.empty(len(factors))
    for k, m in enumerate(factors):
        second = x[2 * m :] - 2.0 * x[m:-m]
        second += x[: -2 * m]
        variance[k] = np.dot(second, second) / (2.0 * float(m) ** 2 * len(second))
    return AllanVariance(factors / rate_hz, variance, len(y) / rate_hz)


def model_variance(terms: Sequence[str], tau_s: FloatArray) -> FloatArray:
    """The Allan variance of unit powers, shape (M, P)."""
    columns = {
        "Q": 3.0 / tau_s**2,
        "N": 1.0 / tau_s,
        "B": np.full_like(tau_s, 2.0 * np.log(2.0) / np.pi),
        "K": tau_s / 3.0,
    }
    return np.stack([columns[term] for term in terms], axis=-1)


def fit_terms(
    measured: AllanVariance,
    terms: Sequence[str],
    first: int = 0,
    model_error: float = 0.0,
    absent: str | None = None,
) -> Fit:
    """Fit powers to the Allan variance of a record whose linear trend was removed.

    Parameters
    ----------
    first : int
        Octaves left out at the short end.
    model_error : float
        1-sigma, relative to the variance, by which the terms may fail at each averaging time by themselves.
    absent : str, optional
        A term that is fitted, but has no part in the covariance of the Allan variance: the fit then tells how far its
        power comes out from zero by chance where it is not there (a score test).
    """
    tau, variance = measured.tau_s[first:], measured.variance[first:]
    design = model_variance(terms, tau) * _kept(tuple(terms), tau / measured.duration_s)
    # relative to the variance and to each term's share of it: both span many powers of ten
    share = (design / variance[:, None]).max(axis=0)
    A, b = design / variance[:, None] / share, np.ones(len(variance))
    present = np.array([term != absent for term in terms]) / share
    spectra = {
        t: s[first:] for t, s in _seen_spectra(measured.rate_hz, measured.duration_s, len(measured.tau_s)).items()
    }
    least = 1e-6 * measured.variance[0] / measured.rate_hz
    cov = np.diag(np.sqrt(tau))
    power = np.zeros(len(terms))
    for _ in range(_ITERATIONS):
        weighted = cho_solve(cho_factor(cov), A)
        cov_power = np.linalg.inv(A.T @ weighted)
        before, power = power, cov_power @ (weighted.T @ b)
        powers = dict(zip(terms, np.maximum(power, 0.0) * present, strict=True))
        seen = (spectra["N"] * least + sum(spectra[t] * p for t, p in powers.items())) / variance[:, None]
        cov = seen @ seen.T + model_error**2 * np.eye(len(b))
        if np.abs(power - before).max() < 1e-3 * np.sqrt(np.diag(cov_power).min()):
            break
    residual = b - A @ power
    misfit = float(residual @ cho_solve(cho_factor(cov), residual))
    return Fit(tuple(terms), power / share, cov_power / np.outer(share, share), misfit, len(tau) - len(terms))


@lru_cache(maxsize=4)
def _seen_spectra(rate_hz: float, duration_s: float, octaves: int) -> dict[str, FloatArray]:
    """What each averaging time sees of the spectra of unit powers, shape (M, F) each.

    Their sum is such that its rows' products are the covariance of the Allan variances: a mean over T of the square of
    a filtered Gaussian signal has the variance (4 / T) int |H|^4 S^2 df over positive frequencies.
    """
    step = 1.0 / rate_hz
    m = 2.0 ** np.arange(octaves)[:, None]
    f = 0.5 / step * 2.0 ** -np.arange(0.0, np.log2(duration_s / step), 1.0 / _PER_OCTAVE)
    df = f * np.log(2.0) / _PER_OCTAVE
    spectra = {
        "Q": 4.0 * np.sin(np.pi * f * step) ** 2 / step,
        "N": np.ones_like(f),
        "B": 1.0 / (2.0 * np.pi * f),
        "K": 1.0 / (2.0 * np.pi * f) ** 2,
    }
    gain = 2.0 * np.sin(np.pi * f * m * step) ** 4 / (m * np.sin(np.pi * f * step)) ** 2
    gain *= np.sqrt(4.0 * df / (duration_s - 2.0 * m * step))
    return {term: gain * spectrum for term, spectrum in spectra.items()}


def _kept(terms: tuple[str, ...], part: FloatArray) -> FloatArray:
    """How much of each term's Allan variance is left when the record's linear trend is removed, shape (M, P).

    ``part`` is the averaging time over the record's length.
    """
    cells = np.arange(1, _GRID // LONGEST + 1) / _GRID
    return np.stack([np.interp(part, np.r_[0.0, cells], np.r_[1.0, _kept_of(term)]) for term in terms], axis=-1)


@cache
def _kept_of(term: str) -> FloatArray:
    """The same for one term at averaging times of 1, 2, 3, ... cells of a grid over the record."""
    if term == "Q":
        return np.ones(_GRID // LONGEST)
    # generalised covariance of the integral; what polynomials it lacks, the second difference does not see
    t = np.abs(np.arange(-1.0, _GRID + 1.0))
    integral = {"N": -t / 2.0, "B": t**2 * np.log(np.maximum(t, 1e-300)), "K": t**3}[term]
    cov = toeplitz(2.0 * integral[1:-1] - integral[2:] - integral[:-2])
    line = np.vander(np.arange(_GRID) - (_GRID - 1) / 2.0, 2)
    detrend = np.eye(_GRID) - line @ np.linalg.pinv(line)
    kept = []
    for m in range(1, _GRID // LONGEST + 1):
        second = toeplitz(np.r_[-1.0, np.zeros(_GRID - 2 * m)], np.r_[-np.ones(m), np.ones(m), np.zeros(_GRID - 2 * m)])
        left = second @ detrend
        kept.append(
            np.einsum("ij,jk,ik", left, cov, left, optimize=True)
            / np.einsum("ij,jk,ik", second, cov, second, optimize=True)
        )
    return np.array(kept)
