"""The reference of a dive as aiding sensors: its positions as fixes, and its heading where asked.

A reference is smooth, so its errors are not those of independent fixes: it is thinned, and each fix is given a sigma
of the size of its slow errors. Its velocity is left alone: that of a post-processed solution may contradict its own
positions by centimetres per second.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uwgraph.dive import Dive
from uwgraph.dive.rig import FixesRig, HeadingRig, Positive, Sensor, Settings
from uwgraph.errors import DataError
from uwgraph.types import Fixes, Heading


class ReferenceUse(Settings):
    """How far the reference is believed."""

    sigma_m: Positive = 1.0
    """1-sigma of a position per axis; over 500 m of straight way twenty of them tell 0.15 % of scale."""
    period_s: Positive = 20.0
    """Time between two that count as independent."""
    heading_sigma_deg: Positive | None = None
    """1-sigma of its heading, where it is to aid too."""

    @property
    def replaces(self) -> tuple[str, ...]:
        """The streams whose place it takes."""
        return ("fixes",) if self.heading_sigma_deg is None else ("fixes", "heading")


def with_reference_aids(dive: Dive, use: ReferenceUse) -> Dive:
    """The dive with fixes (and headings) made from its reference in place of its own.

    They stand where ``rig.reference`` puts the reference, and on its clock.

    Raises
    ------
    DataError
        When there is no reference, or it has no positions.
    """
    reference, rig = dive.reference, dive.rig.reference
    placed = None if reference is None else np.isfinite(reference.lat) & np.isfinite(reference.lon)
    if reference is None or placed is None or placed.sum() < 2:
        raise DataError("the dive has no reference with positions", where="reference", remedy="calibrate without it")
    thinned = reference.select(np.flatnonzero(placed))
    thinned = thinned.select(np.unique(thinned.t_s // use.period_s, return_index=True)[1])
    n = len(thinned)
    fixes = Fixes(
        thinned.t_ns,
        lat=thinned.lat,
        lon=thinned.lon,
        height=thinned.height,
        cov_n=np.tile(use.sigma_m**2 * np.eye(3), (n, 1, 1)),
        source=np.full(n, "reference"),
    )
    clock = rig.time_offset_s
    parts: dict[str, Sensor] = {
        "fixes": FixesRig(translation_m=rig.translation_m, time_offset_s=clock, sigma=use.sigma_m)
    }
    dive = replace(dive, fixes=fixes)
    known = np.isfinite(thinned.rph).all(axis=1)
    if use.heading_sigma_deg is not None and known.any():
        sigma = np.full(int(known.sum()), np.radians(use.heading_sigma_deg))
        heading = Heading(thinned.t_ns[known], thinned.rph[known, 2], sigma)
        parts["heading"] = HeadingRig(rotation_deg=rig.rotation_deg, time_offset_s=clock)
        dive = replace(dive, heading=heading)
    return replace(dive, rig=dive.rig.model_copy(update=parts))
