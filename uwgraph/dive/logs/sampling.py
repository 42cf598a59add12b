"""What an IMU sample stands for: our streams hold means over intervals, most logs instantaneous values."""

from __future__ import annotations

from uwgraph.types import FloatArray


def interval_means(samples: FloatArray) -> FloatArray:
    """Means over the intervals between instantaneous samples, by the trapezoidal rule: one row less."""
    means = samples[1:] + samples[:-1]
    means *= 0.5
    return means
