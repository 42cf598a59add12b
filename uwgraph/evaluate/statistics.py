"""Figures of what is known: NaN is left out, and None is what JSON has for nothing."""

from __future__ import annotations

import numpy as np

from uwgraph.types import FloatArray


def rms(error: FloatArray) -> float | None:
    """Root mean square of what is known; None where nothing is."""
    square = mean(error**2)
    return None if square is None else float(np.sqrt(square))


def mean(value: FloatArray) -> float | None:
    """Mean of what is known; None where nothing is."""
    known = value[np.isfinite(value)]
    return float(known.mean()) if len(known) else None


def number(value: float) -> float | None:
    """JSON has no NaN."""
    return float(value) if np.isfinite(value) else None


def percent(part: float | None, whole: float) -> float | None:
    """None where either is nothing."""
    return 100.0 * part / whole if part is not None and whole > 0.0 else None
