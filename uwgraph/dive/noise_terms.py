"""Which noise terms three axes of a sensor show, how large they are, and what goes for all three."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from uwgraph.chi_square import chi2_beyond
from uwgraph.dive.allan import TERMS, AllanVariance, Fit, allan_variance, fit_terms, model_variance
from uwgraph.types import FloatArray

SEEN: Final = 3.0
"""Sigmas by which a term's power must differ from zero."""
MISFIT: Final = 1e-4
"""Probability of residuals (or of a scatter of the axes) so large, below which they are not put down to chance."""
DOUBT: Final = 0.01
"""The same for the shortest averaging times, which are soon given up: a filter of the sensor lowers them by and by."""
LEAST_OCTAVES: Final = 5
"""Averaging times that are never given up for a better fit."""
LONGEST_START_S: Final = 1.0
"""s; shorter averaging times may be given up: the sensor's filter and vibration are no terms of the model."""
MODEL_ERROR: Final = 0.05
"""Of the variance; what the terms of a real sensor may fail by before its record is doubted."""
MAX_INFLATION: Final = 3.0
"""Sigmas inflated by more: what was recorded is not the noise of a sensor at rest, and nothing is taken from it."""
LEAST_FOR_WALK_S: Final = 600.0
"""s; what a shorter record shows as a walk is warming up, or motion."""
ONE_SIDED_95: Final = 1.645


@dataclass(frozen=True)
class Term:
    """One of the ``TERMS``, as a standard deviation or density (not a power)."""

    seen: bool
    value: float
    """0 where the power came out negative."""
    sigma: float
    """1-sigma of the value; NaN where it is not seen."""
    limit: float
    """95 % upper limit."""
    axes: str
    """What it is of: one axis, or ``xyz`` for the mean (of the powers) of axes that agree."""


@dataclass(frozen=True, eq=False)
class AxisNoise:
    """One axis."""

    allan: AllanVariance
    """Of the signal less its linear trend."""
    model: FloatArray
    """The Allan variance of the fitted terms, shape (M,)."""
    terms: Mapping[str, Term]
    trend: float
    """What was removed, signal units per second."""


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Three axes of a sensor."""

    axes: tuple[AxisNoise, ...]
    terms: Mapping[str, Term]
    """For all axes: their mean where they agree, the noisiest where they do not."""
    tau_min_s: float
    """The shortest averaging time that the terms explain."""
    model_error: float
    """How much (of the variance) the terms were allowed to fail at each averaging time; 0 where they explain it."""
    inflation: float
    """What the sigmas were multiplied by because the terms fail by more; beyond ``MAX_INFLATION`` nothing is seen."""


@dataclass(frozen=True)
class _Model:
    """Which terms explain the Allan variance, from which octave on, how well; and their fits, one per axis."""

    terms: tuple[str, ...]
    first: int
    error: float
    fits: tuple[Fit, ...]

    @property
    def chance(self) -> float:
        """Probability of residuals at least as large."""
        return float(chi2_beyond(sum(f.chi2 for f in self.fits), sum(f.dof for f in self.fits)))

    @property
    def inflation(self) -> float:
        """What the sigmas must be multiplied by; 1 where the residuals are put down to chance."""
        if self.chance > MISFIT:
            return 1.0
        return float(np.sqrt(sum(f.chi2 for f in self.fits) / sum(f.dof for f in self.fits)))


def sensor_noise(signals: FloatArray, rate_hz: float) -> SensorNoise:
    """The terms of equally spaced samples at rest, shape (N, 3), each the mean over its interval."""
    trends, measured = [], []
    for column in signals.T:
        trend, rest = _detrended(column, rate_hz)
        trends.append(trend)
        measured.append(allan_variance(rest, rate_hz))
    model = _explain(measured)
    powers = {term: _powers(measured, model, term) for term in TERMS}
    shown = _shown(model, measured[0].duration_s)
    axes = tuple(
        AxisNoise(
            measured[k],
            model_variance(model.terms, measured[k].tau_s) @ np.maximum(fit.power, 0.0),
            {
                term: _term(power[k], sigma[k], term in shown and power[k] >= SEEN * sigma[k], "xyz"[k])
                for term, (power, sigma) in powers.items()
            },
            trends[k],
        )
        for k, fit in enumerate(model.fits)
    )
    together = {term: _together(*powers[term], term in shown) for term in TERMS}
    return SensorNoise(axes, together, float(measured[0].tau_s[model.first]), model.error, model.inflation)


def _detrended(y: FloatArray, rate_hz: float) -> tuple[float, FloatArray]:
    """Slope per second, and the signal less its straight line."""
    t = (np.arange(len(y)) - (len(y) - 1) / 2.0) / rate_hz
    slope = float(t @ y / (t @ t))
    return slope, y - y.mean() - slope * t


def _explain(measured: Sequence[AllanVariance]) -> _Model:
    """The first model that explains the Allan variance, short averaging times being given up first, or the best one."""
    tau_s = measured[0].tau_s
    last = max(min(int((tau_s < LONGEST_START_S).sum()), len(tau_s) - LEAST_OCTAVES), 0)
    tried = []
    for error in (0.0, MODEL_ERROR):
        for first in range(last + 1):
            tried.append(_seen_terms(measured, first, error))
            if tried[-1].chance > DOUBT:
                return tried[-1]
    return max(tried, key=lambda model: (model.chance, -model.inflation))


def _seen_terms(measured: Sequence[AllanVariance], first: int, error: float) -> _Model:
    """Every axis with the same terms: the faintest, of the mean over the axes, is left out until all are seen."""
    terms: tuple[str, ...] = TERMS
    while True:
        model = _Model(terms, first, error, tuple(fit_terms(m, terms, first, error) for m in measured))
        z = np.array([_sigmas(measured, model, term) for term in terms]) / model.inflation
        if z.min() >= SEEN or len(terms) == 1:
            return model
        terms = tuple(term for k, term in enumerate(terms) if k != int(z.argmin()))


def _sigmas(measured: Sequence[AllanVariance], model: _Model, term: str) -> float:
    """By how many sigmas of chance, were it absent, the mean power of a term differs from zero."""
    fits = [fit_terms(m, model.terms, model.first, model.error, absent=term) for m in measured]
    k = model.terms.index(term)
    return float(sum(f.power[k] for f in fits) / np.sqrt(sum(f.cov[k, k] for f in fits)))


def _shown(model: _Model, duration_s: float) -> tuple[str, ...]:
    """The terms that the record is long and quiet enough to show."""
    if model.inflation > MAX_INFLATION:
        return ()
    return tuple(term for term in model.terms if term != "K" or duration_s >= LEAST_FOR_WALK_S)


def _powers(measured: Sequence[AllanVariance], model: _Model, term: str) -> tuple[FloatArray, FloatArray]:
    """Power and 1-sigma of a term per axis; one that was left out is fitted beside the others."""
    terms = tuple(t for t in TERMS if t == term or t in model.terms)
    k = terms.index(term)
    fits = model.fits if term in model.terms else [fit_terms(m, terms, model.first, model.error) for m in measured]
    return np.array([f.power[k] for f in fits]), model.inflation * np.sqrt(np.array([f.cov[k, k] for f in fits]))


def _together(power: FloatArray, sigma: FloatArray, seen: bool) -> Term:
    """One term for all axes."""
    scatter = float((((power - power.mean()) / sigma) ** 2).sum())
    if chi2_beyond(scatter, len(power) - 1) > MISFIT:
        return _term(float(power.mean()), float(np.linalg.norm(sigma)) / len(power), seen, "xyz")
    worst = int(power.argmax())
    return _term(float(power[worst]), float(sigma[worst]), seen, "xyz"[worst])


def _term(power: float, sigma: float, seen: bool, axes: str) -> Term:
    value = float(np.sqrt(max(power, 0.0)))
    limit = float(np.sqrt(max(power, 0.0) + ONE_SIDED_95 * sigma))
    return Term(bool(seen), value, float(sigma / (2.0 * value)) if seen else float("nan"), limit, axes)
