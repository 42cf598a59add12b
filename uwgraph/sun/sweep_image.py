"""A sweep from polarization images of the water: the pixels that look about level."""

from __future__ import annotations

from typing import Final

import numpy as np

from uwgraph.errors import DataError
from uwgraph.sun.evector import light_of
from uwgraph.sun.stokes import StokesImage
from uwgraph.sun.sweep import Sweep
from uwgraph.sun.view import View

LEVEL: Final = np.radians(20.0)
"""Views steeper than this are not used: the window's light is added there, and the pattern bends, rad."""
PIXELS: Final = 300
"""Of one image, evenly spread: neighbours say the same."""
DOP_ERROR: Final = 0.002


def sweep_of_image(image: StokesImage, view: View) -> Sweep:
    """The water's angles of polarization about the horizontal; ``view`` is that of the camera before binning.

    Raises
    ------
    DataError
        When no pixel looks about level, or all are too dark or too bright.
    """
    view = view.binned(image.factor)
    w_b, _ = view.body_rays()
    level = np.abs(w_b @ view.up_b) < np.sin(LEVEL)
    use = np.flatnonzero(level & ~image.saturated.ravel() & ~image.dark.ravel())
    if len(use) < 3:
        problem = "no pixel looks about level" if level.sum() < 3 else "all that look level are too dark or too bright"
        raise DataError(problem, where="image", remedy="the scattering method needs a camera that looks into the water")
    use = use[:: max(1, len(use) // PIXELS)]
    light = light_of(image, view, use, np.arange(len(use)), DOP_ERROR)
    seen = light.evectors()
    return Sweep.of_evectors(
        seen.a_b,
        seen.e_b,
        seen.sigma,
        view.up_b,
        dolp=np.hypot(light.Q, light.U) / light.I,
        n=view.n,
        tilt_sigma=view.tilt_sigma,
        t_ns=view.t_ns,
    )
