"""Are innovations as large as a filter believes? Averages per sensor, with the interval in which they should lie."""

from __future__ import annotations

from typing import Any

import numpy as np

from uwgraph.evaluate.metrics import nees_bounds
from uwgraph.types import Innovations


def nis_metrics(innovations: Innovations | None) -> dict[str, Any]:
    """For every kind of measurement: mean NIS over its dimension, its 95 % interval, what was refused, the noise.

    ``nis_KIND`` is the mean over the measurements used (1 expected), ``nis_KIND_95`` the interval of as many
    independent ones: innovations of a right filter are independent. ``noise_KIND`` is what the filter believed at the
    end, in stated sigmas: the root mean square of the axes.
    """
    if innovations is None:
        return {}
    figures: dict[str, Any] = {}
    for kind in np.unique(innovations.kind).tolist():
        of_kind = innovations.select(innovations.kind == kind)
        used = of_kind.select(of_kind.accepted)
        figures[f"measurements_{kind}"] = len(of_kind)
        figures[f"refused_{kind}"] = len(of_kind) - len(used)
        figures[f"noise_{kind}"] = float(np.sqrt(np.nanmean(of_kind.noise[-1] ** 2)))
        if len(used):
            figures[f"nis_{kind}"] = float(used.nis @ used.dof / used.dof.sum())
            figures[f"nis_{kind}_95"] = list(nees_bounds(1, int(used.dof.sum())))
    return figures
