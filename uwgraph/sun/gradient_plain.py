"""The plain form: every normal of view and gradient is orthogonal to the sun, and nothing else lights the sky.

Exact where the radiance depends on the angle from the sun alone. A real sky also depends on the zenith angle; in a full
view the symmetry about the sun's meridian then keeps the azimuth, but not the height nor even the sense.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uwgraph.sun.gradient_field import GradientField
from uwgraph.sun.information import Spectrum
from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class PlainResult:
    """The sun by the smallest eigenvector of the normals' scatter."""

    s: FloatArray
    """Unit vector to the sun, in b, above the horizon, shape (3,)."""
    cov: FloatArray
    """Covariance of ``s`` (3, 3), as if gradients erred independently."""
    quality: float
    """Smallest over second eigenvalue: 0 where the model is exact, towards 1 where it says nothing."""
    signs_agree: bool
    """Whether the light grows towards the ``s`` that is above the horizon."""


def plain_sun(field: GradientField, up_b: FloatArray) -> PlainResult:
    """Smallest eigenvector of sum w (m m^T - N): weights by the noise along the sun, its own scatter N taken off."""
    weight = np.ones(len(field.m))
    for _ in range(3):
        M = (field.m * weight[:, None]).T @ field.m
        own = np.einsum("n,nij->ij", weight, field.noise)
        spectrum = Spectrum.of(M - own)
        s = spectrum.s
        along = np.einsum("i,nij,j->n", s, field.noise, s)
        weight = 1.0 / np.maximum(along, 1e-3 * np.median(along) + 1e-30)
    s = s if s @ up_b > 0.0 else -s
    chi2 = float(s @ M @ s) / max(len(weight) - 2, 1)
    E, curvature = spectrum.E, np.maximum(spectrum.curvature, 1e-12)
    return PlainResult(
        s=s,
        cov=(E / curvature) @ E.T * max(1.0, chi2),
        quality=float(np.clip(spectrum.eigenvalues[0] / spectrum.eigenvalues[1], 0.0, 1.0)),
        signs_agree=bool((field.g @ s).sum() > 0.0),
    )
