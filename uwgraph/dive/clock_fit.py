"""One clock against another: the time shift under which two motions agree.

A model gives, for stamps moved onto the IMU's clock, what should be *slow* once a few constants are known: values
``y`` and columns ``C`` such that y - C x is a slow trend plus noise. The trend (gravity, biases, drift: a cubic per
block of about a minute) and the constants x (scale, mounting, lever arm) are projected out for every trial shift, so
that only the shift is left. Its sigma is a delete-one-block jackknife, which honours correlated noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import argrelmin

from uwgraph.types import BoolArray, FloatArray

IndexArray = NDArray[np.intp]
Model = Callable[[IndexArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Which samples and their times on the IMU's clock, shapes (n,) -> y, shape (n, d), and columns C, shape (n, d, c)."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A sensor's samples and the model that compares them with the IMU."""

    how: str
    t_s: FloatArray
    """Stamps of the samples, shape (n,), seconds since the IMU's first stamp."""
    model: Model
    span_s: tuple[float, float]
    """First and last time that the model can be asked for."""
    local: int = 0
    """How many of the columns, from the first, have a constant for each block: those that drift with the gyro."""


GRID_S = 0.1
FLOOR = 0.02
"""Systematic part of sigma, in sampling periods: real 1 Hz logs (seven of DVL, seven of depth) scatter by 13 and
30 ms about the shift that goes by way of an attitude reference, more than their noise explains."""
BLOCK_S = 60.0
BLOCK_SAMPLES = 30
MAX_BLOCKS = 30
"""Of a longer stream every second block is used, or every third, and so on."""
DEGREE = 3
STEP_S = 0.1
ITERATIONS = 20
MAX_STEP_S = 0.2
SCAN_SAMPLES = 40
"""The search over the whole range uses about this many samples of each block, the refinement all."""
HUBER = 2.0
AMBIGUOUS = 25.0
"""chi-square by which the best shift must beat every other minimum, and twice that over a shift at random."""


@dataclass(frozen=True)
class ClockOffset:
    """Offset and rate of a sensor's clock against the IMU's.

    ``offset_s`` is what must be **added** to the sensor's stamps (at the middle of the stream) to bring them on the
    IMU's clock; ``rate_ppm`` is how fast that grows along the stream. Both are NaN when the motion does not show them.
    """

    sensor: str
    offset_s: float
    sigma_s: float
    rate_ppm: float
    rate_sigma_ppm: float
    how: str
    """What was compared with what, or why nothing could be said."""
    n: int
    """Samples used."""

    @property
    def observable(self) -> bool:
        return bool(np.isfinite(self.offset_s))


def unobservable(sensor: str, why: str, n: int = 0) -> ClockOffset:
    """The answer when there is none."""
    return ClockOffset(sensor, np.nan, np.nan, np.nan, np.nan, f"not observable: {why}", n)


def fit_clock(sensor: str, comparison: Comparison, max_offset_s: float, max_sigma_s: float) -> ClockOffset:
    """Shift and rate that make the comparison's values slow.

    Shifts are sought within +- ``max_offset_s``; one less certain than ``max_sigma_s`` is called not observable.
    """
    t_s, (first, last) = comparison.t_s, comparison.span_s
    inside = np.flatnonzero((t_s > first + max_offset_s) & (t_s < last - max_offset_s))
    blocks = _blocks(t_s[inside])
    if blocks.size == 0:
        return unobservable(sensor, "too few samples overlap with the IMU", len(inside))
    used = blocks >= 0
    every = max(blocks.shape[1] // SCAN_SAMPLES, 1)
    scan = _Problem(comparison, inside[blocks[:, ::every]], used[:, ::every])
    shifts = np.arange(-max_offset_s, max_offset_s + GRID_S / 2, GRID_S)
    cost = scan.costs(shifts)
    scan = scan.reweighted(shifts[np.argmin(cost)])
    cost = scan.costs(shifts)
    best = int(np.argmin(cost))
    if best in (0, len(shifts) - 1):
        return unobservable(sensor, f"no best shift within +-{max_offset_s:g} s", len(inside))

    problem = _Problem(comparison, inside[blocks], used)
    with_rate = len(blocks) >= 4
    rough = problem.reweighted(shifts[best]).refine(shifts[best], 0.0, with_rate)
    fit = problem.reweighted(rough.offset, rough.rate).refine(rough.offset, rough.rate, with_rate)
    excess = (cost - cost[best]) * every / fit.scale
    rivals = [i for i in argrelmin(excess)[0] if abs(i - best) > 1]
    if not fit.sigma <= max_sigma_s or np.median(excess) < 2 * AMBIGUOUS:
        return unobservable(sensor, "the motion is too quiet", len(inside))
    if any(excess[i] < AMBIGUOUS for i in rivals):
        return unobservable(sensor, "the motion repeats itself, several shifts fit", len(inside))
    rate_ppm = fit.rate * 1e6 if with_rate else np.nan
    return ClockOffset(sensor, fit.offset, fit.sigma, rate_ppm, fit.rate_sigma * 1e6, comparison.how, problem.n)


def _blocks(t: FloatArray) -> IndexArray:
    """Indices of the samples of each block, shape (blocks, longest), -1 where a block is shorter."""
    if len(t) < BLOCK_SAMPLES:
        return np.empty((0, 0), dtype=np.intp)
    length = max(BLOCK_S, BLOCK_SAMPLES * float(np.median(np.diff(t))))
    count = max(int((t[-1] - t[0]) / length), 1)
    number = np.minimum(((t - t[0]) / (t[-1] - t[0]) * count).astype(int), count - 1)
    members = [np.flatnonzero(number == k) for k in range(count)]
    members = [m for m in members if len(m) >= BLOCK_SAMPLES // 2]
    members = members[:: -(-len(members) // MAX_BLOCKS) or 1]
    table = np.full((len(members), max(map(len, members), default=0)), -1, dtype=np.intp)
    for row, m in zip(table, members, strict=True):
        row[: len(m)] = m
    return table


@dataclass(frozen=True)
class _Fit:
    offset: float
    rate: float
    sigma: float
    rate_sigma: float
    scale: float
    """Variance of a unit-weight residual, its correlation between samples included."""


class _Problem:
    """The model's residual as a function of shift and rate, everything else projected out."""

    def __init__(
        self, comparison: Comparison, index: IndexArray, used: BoolArray, weight: FloatArray | None = None
    ) -> None:
        self.comparison, self.index, self.used = comparison, index, used
        t_s = self.t_s = comparison.t_s
        t = t_s[index]
        self.t_mid = float(t[used].mean())
        first, last = t[:, :1], np.where(used, t, -np.inf).max(axis=1, keepdims=True)
        x = 2 * (t - first) / (last - first) - 1
        self.powers = np.polynomial.legendre.legvander(x, DEGREE) * used[..., None]
        self.weight = weight

    @property
    def n(self) -> int:
        return int(self.used.sum())

    def residual(self, shift: float, rate: float) -> FloatArray:
        """Weighted residuals, shape (blocks, longest, d)."""
        index, used = self.index, self.used
        t = self.t_s[index] + shift + rate * (self.t_s[index] - self.t_mid)
        y, columns = self.comparison.model(index.ravel(), t.ravel())
        stacked = np.concatenate([columns, y[..., None]], axis=-1).reshape(*index.shape, *y.shape[1:], -1)
        weight = used[..., None] if self.weight is None else self.weight
        stacked = np.moveaxis(stacked * weight[..., None], 1, 2)  # block, axis, sample, column
        local = self.comparison.local
        slow = self.powers[:, None] * np.moveaxis(weight, 1, 2)[..., None]
        slow = np.concatenate([np.broadcast_to(slow, (*stacked.shape[:3], DEGREE + 1)), stacked[..., :local]], axis=-1)
        basis, _ = np.linalg.qr(slow)
        rest = stacked[..., local:]
        rest = rest - basis @ (np.swapaxes(basis, -1, -2) @ rest)
        flat = rest.reshape(-1, rest.shape[-1])
        nuisance, value = flat[:, :-1], flat[:, -1]
        left = value - nuisance @ np.linalg.lstsq(nuisance, value, rcond=1e-9)[0] if nuisance.size else value
        return np.moveaxis(left.reshape(rest.shape[:-1]), 1, 2)

    def costs(self, shifts: FloatArray) -> FloatArray:
        """Sum of squared residuals at each shift."""
        return np.array([np.sum(self.residual(shift, 0.0) ** 2) for shift in shifts])

    def reweighted(self, shift: float, rate: float = 0.0) -> _Problem:
        """The same problem with each axis at its own noise and outliers held back (Huber)."""
        r = self.residual(shift, rate)
        scale = 1.4826 * np.median(np.abs(r[self.used]), axis=0)
        scale = np.maximum(scale, 1e-3 * scale.max() + np.finfo(float).tiny)
        size = np.abs(r) / scale
        weight = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, HUBER))) / scale * self.used[..., None]
        return _Problem(self.comparison, self.index, self.used, weight)

    def refine(self, shift: float, rate: float, with_rate: bool) -> _Fit:
        """The best shift and rate near those given.

        Gauss-Newton; differences are taken over STEP_S, in which motion counts more than the IMU's noise.
        """
        length = float(np.ptp(self.t_s[self.index][self.used]))
        unit = np.diag([1.0, 1.0 / length])[: 2 if with_rate else 1]
        x = np.array([shift, rate])
        for _ in range(ITERATIONS):
            r = self.residual(*x)
            J = np.stack([(self.residual(*(x + STEP_S * u)) - self.residual(*(x - STEP_S * u))) for u in unit], axis=-1)
            J /= 2 * STEP_S
            H = np.einsum("bndi,bndj->bij", J, J)
            score = np.einsum("bndi,bnd->bi", J, r)
            step = np.linalg.solve(H.sum(axis=0), score.sum(axis=0))
            x = x - np.clip(step, -MAX_STEP_S, MAX_STEP_S) @ unit
            if np.abs(step).max() < 1e-5:
                break
        inverse = np.linalg.inv(H.sum(axis=0))
        variance = np.diag(inverse @ _score_covariance(J, r) @ inverse)
        blocks = len(self.index)
        if blocks > 2:  # delete-one-block jackknife
            moved = np.einsum("bij,bj->bi", np.linalg.pinv(H.sum(axis=0) - H), score)
            variance = np.maximum(variance, (blocks - 1) / blocks * np.sum(moved**2, axis=0))
        scale = float(variance[0] / inverse[0, 0])
        floor = FLOOR * float(np.median(np.diff(self.t_s[self.index], axis=1)[self.used[:, 1:]]))
        sigma = np.sqrt(variance + floor**2 * np.array([1.0, 12.0])[: len(unit)])
        rate_sigma = float(sigma[1]) / length if with_rate else np.nan
        return _Fit(float(x[0]), float(x[1]), float(sigma[0]), rate_sigma, scale)


def _score_covariance(J: FloatArray, r: FloatArray) -> FloatArray:
    """Covariance of the score J^T r when r is a stationary process within each block, shape (k, k).

    Its spectrum is pooled over the blocks, so that a block with all of the signal is not its own judge of the noise.
    """
    length = 2 * r.shape[1]
    power = np.sum(np.abs(np.fft.rfft(r, length, axis=1)) ** 2, axis=0) / np.count_nonzero(r[..., 0])
    white = np.sum(r**2, axis=(0, 1)) / np.count_nonzero(r[..., 0])
    spectrum = np.fft.rfft(J, length, axis=1)
    fold = np.full(len(power), 2.0 / length)
    fold[[0, -1]] = 1.0 / length
    coloured = np.maximum(power, white)
    covariance: FloatArray = np.einsum("bfdi,fd,bfdj->ij", spectrum, coloured * fold[:, None], spectrum.conj()).real
    return covariance
