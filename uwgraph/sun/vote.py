"""The vote: every pixel's e-vector and the sun's known height leave two azimuths of the sun; the true ones pile up.

The e-vector e of singly scattered light is orthogonal to the sun s. With the sun's zenith angle z known, e.s = 0 reads

    e_bow cos A + e_starboard sin A = -e_up cot z,

so A = atan2(e_starboard, e_bow) +- arccos(-e_up cot z / |e_horizontal|): two candidates a pixel, none where the pixel
contradicts the model. The true branch is the same at all pixels, the false one is spread. (Solar-meridian voting on
sky polarization patterns; candidates in closed form, so that any tilt is exact.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d

from uwgraph.frames import wrap_pi
from uwgraph.sun.observation import level_axes
from uwgraph.types import FloatArray

BINS: Final = 360
_APART: Final = 15  # bins between two modes that count as two
_MODES: Final = 4


@dataclass(frozen=True, eq=False)
class Vote:
    """What the pixels say about the sun's azimuth in the levelled body."""

    candidates: FloatArray
    """Azimuths clockwise from the bow, rad, shape (N, 2); NaN where a pixel has none."""
    weights: FloatArray
    """Weight of each candidate, shape (N, 2); 0 where there is none."""
    histogram: FloatArray
    """Smoothed weight per degree of azimuth, the first bin from -180 deg on, shape (360,)."""
    modes: FloatArray
    """Refined azimuths of the highest maxima, the highest first, rad, shape (M,); empty without any candidate."""
    heights: FloatArray
    """Height of the histogram at the modes, shape (M,)."""

    @property
    def azimuth(self) -> float:
        """The winner, rad; NaN without any candidate."""
        return float(self.modes[0]) if len(self.modes) else float("nan")

    @property
    def other(self) -> float:
        """The runner-up, rad; NaN where there is none."""
        return float(self.modes[1]) if len(self.modes) > 1 else float("nan")

    @property
    def ratio(self) -> float:
        """Height of the runner-up over that of the winner, 0 to 1."""
        return float(self.heights[1] / self.heights[0]) if len(self.modes) > 1 else 0.0


def vote(
    a_b: FloatArray,
    e_b: FloatArray,
    sigma: FloatArray,
    up_b: FloatArray,
    sun_zenith: float,
    smoothing: float = np.radians(2.0),
) -> Vote:
    """Vote on the sun's azimuth.

    Parameters
    ----------
    a_b, e_b : shape (N, 3)
        Unit directions in the sky and e-vectors normal to them, in the body.
    sigma : shape (N,)
        1-sigma of the e-vector's angle about its direction, rad.
    up_b : shape (3,)
        Zenith in the body.
    sun_zenith : float
        Zenith angle of the sun, rad.
    smoothing : float
        Standard deviation of the kernel that smooths the histogram, rad.
    """
    azimuths = candidates(e_b, up_b, sun_zenith)
    weights = _weights(azimuths, a_b, e_b, sigma, up_b, sun_zenith)
    voters = weights > 0.0
    cells = ((azimuths[voters] + np.pi) * (BINS / (2.0 * np.pi))).astype(np.intp) % BINS
    raw = np.bincount(cells, weights[voters], BINS)
    histogram = gaussian_filter1d(raw, np.degrees(smoothing), mode="wrap")
    peaks = _peaks(histogram)
    start = wrap_pi((peaks + 0.5) * (2.0 * np.pi / BINS) - np.pi)
    modes = np.array([_refined(a, azimuths[voters], weights[voters]) for a in start])
    return Vote(azimuths, weights, histogram, modes, histogram[peaks])


def candidates(e_b: FloatArray, up_b: FloatArray, sun_zenith: float) -> FloatArray:
    """The two azimuths [rad, clockwise from the bow], shape (N, 2), that each e-vector (N, 3) leaves; NaN for none."""
    e_bow, e_starboard, e_up = level_axes(up_b) @ e_b.T
    horizontal = np.maximum(np.hypot(e_bow, e_starboard), 1e-12)
    C = -e_up / np.tan(sun_zenith) / horizontal
    half = np.arccos(np.where(np.abs(C) <= 1.0, C, np.nan))
    middle = np.arctan2(e_starboard, e_bow)
    return wrap_pi(np.stack([middle + half, middle - half], axis=1))


def _weights(
    azimuths: FloatArray, a_b: FloatArray, e_b: FloatArray, sigma: FloatArray, up_b: FloatArray, sun_zenith: float
) -> FloatArray:
    """F_A^2 / (F_phi^2 + F_A^2) / sigma^2 with F = e.s: bounded, and 0 where the two branches merge.

    The inverse variance of the azimuth, F_A^2 / F_phi^2 / sigma^2, would let the false branch win where F_phi is 0.
    """
    bow, starboard, up = level_axes(up_b)
    weights = np.zeros_like(azimuths)
    m_b = np.cross(a_b, e_b)
    for branch, A in enumerate(azimuths.T):
        cos_A, sin_A = np.cos(A), np.sin(A)
        F_A = cos_A * (e_b @ starboard) - sin_A * (e_b @ bow)
        F_phi = cos_A * (m_b @ bow) + sin_A * (m_b @ starboard) + (m_b @ up) / np.tan(sun_zenith)
        weights[:, branch] = np.nan_to_num(F_A**2 / (F_phi**2 + F_A**2 + 1e-12) / sigma**2)
    return weights


def _peaks(histogram: FloatArray) -> FloatArray:
    """Bins of the highest local maxima that keep apart, the highest first."""
    local = (histogram > np.roll(histogram, 1)) & (histogram >= np.roll(histogram, -1)) & (histogram > 0.0)
    order = np.flatnonzero(local)
    order = order[np.argsort(-histogram[order])]
    kept: list[int] = []
    for bin_ in order:
        if all(min(abs(bin_ - k), BINS - abs(bin_ - k)) >= _APART for k in kept):
            kept.append(int(bin_))
        if len(kept) == _MODES:
            break
    return np.array(kept, dtype=np.intp)


def _refined(azimuth: float, votes: FloatArray, weights: FloatArray) -> float:
    """Three rounds of the weighted median of the votes within 5 deg: free of the bins' width."""
    for _ in range(3):
        offset = wrap_pi(votes - azimuth)
        near = np.abs(offset) < np.radians(5.0)
        if not near.any():
            break
        order = np.argsort(offset[near])
        share = np.cumsum(weights[near][order])
        azimuth += float(offset[near][order][np.searchsorted(share, 0.5 * share[-1])])
    return float(wrap_pi(azimuth))
