"""A sweep from polarization images of the water: blocks of pixels that look more or less level."""

from __future__ import annotations

from typing import Final

import numpy as np

from uwgraph.errors import DataError
from uwgraph.sun.evector import light_of
from uwgraph.sun.stokes import StokesImage, binned
from uwgraph.sun.sweep import Sweep
from uwgraph.sun.view import View
from uwgraph.types import BoolArray

BLOCKS: Final = 12
"""Views along the longer side of an image."""
DOP_ERROR: Final = 0.002
"""Error of the degree of polarization from the sensor itself (gains, crosstalk), 1-sigma."""


def sweep_of_image(image: StokesImage, view: View, *, max_elevation: float = np.radians(30.0)) -> Sweep:
    """The sweep of one image of a camera in the water that looks more or less level.

    Blocks of pixels become one view each, in their own direction; those with a view steeper than ``max_elevation``
    [rad], up (where the sky comes in) or down, and those half dark or saturated are left out.

    Parameters
    ----------
    view : View
        Of the whole camera, before the binning of ``image``.

    Raises
    ------
    DataError
        When the camera is not in water, or nothing can be used.
    """
    if not view.in_water:
        raise DataError(
            "the scattering method sees the water, and the camera is in air", where="medium", remedy="use medium water"
        )
    factor = max(1, round(max(image.I.shape) / BLOCKS))
    coarse, filled = _blocks(image, factor)
    view = view.binned(coarse.factor)
    w_b = view.body_rays()[0]
    level = np.abs(w_b @ view.up_b) < np.sin(max_elevation)
    use = np.flatnonzero(filled.ravel() & level)
    if not len(use):
        raise DataError(
            "no part of the image is lit, below saturation and near the horizontal",
            where="image",
            remedy="look at exposure, mounting and attitude",
        )
    light = light_of(coarse, view, use, np.arange(len(use)), DOP_ERROR)
    seen = light.evectors()
    dolp = np.hypot(light.Q, light.U) / light.I
    return Sweep.of_evectors(
        seen.a_b, seen.e_b, seen.sigma, view.up_b, dolp=dolp, n=view.n, tilt_sigma=view.tilt_sigma, t_ns=view.t_ns
    )


def _blocks(image: StokesImage, factor: int) -> tuple[StokesImage, BoolArray]:
    """Means of the good pixels of ``factor`` x ``factor``, and which blocks are at least half good."""
    good = ~(image.dark | image.saturated)
    share = binned(good.astype(np.float64), factor)
    safe = np.maximum(share, 1e-9)
    I, Q, U, variance = (  # noqa: E741
        binned(np.where(good, x, 0.0), factor) / safe for x in (image.I, image.Q, image.U, image.sigma**2)
    )
    filled = share >= 0.5
    sigma = np.sqrt(variance / (safe * factor**2))
    return StokesImage(I, Q, U, sigma, ~filled, ~filled, image.redundancy, image.factor * factor), filled
