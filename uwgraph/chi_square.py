"""The chi-square distribution, by the incomplete gamma function: ``scipy.stats`` takes half a second to load."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincc, gammaincinv

from uwgraph.types import FloatArray


def chi2_quantile(share: ArrayLike, dof: ArrayLike) -> FloatArray:
    """What the given share of chi-square numbers with ``dof`` degrees of freedom stays below; broadcast."""
    return np.asarray(2.0 * gammaincinv(0.5 * np.asarray(dof), share))


def chi2_beyond(value: ArrayLike, dof: ArrayLike) -> FloatArray:
    """The share of chi-square numbers with ``dof`` degrees of freedom above ``value``; broadcast."""
    return np.asarray(gammaincc(0.5 * np.asarray(dof), 0.5 * np.asarray(value)))
