"""The reference brought to the body's origin and the dive's clock, as the rig says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uwgraph.dive.model import Dive
from uwgraph.frames import R_n_local, geodetic_from_ned, matrix_from_rph, ned_from_geodetic, rph_from_matrix
from uwgraph.types import Reference


def body_reference(dive: Dive) -> Reference | None:
    """The dive's reference on the dive's clock, turned and moved to the body by the rig's ``reference``.

    A lever arm is only taken off where the reference knows its own attitude.
    """
    reference, rig = dive.reference, dive.rig.reference
    if reference is None or len(reference) < 2:
        return None
    R_lb = matrix_from_rph(reference.rph) @ rig.R_bs.T
    deep = np.isfinite(reference.height)
    p_n = ned_from_geodetic(dive.origin, reference.lat, reference.lon, np.where(deep, reference.height, 0.0))
    arm_l = np.nan_to_num(R_lb @ rig.l_b, nan=0.0)
    arm_n = np.einsum("kij,kj->ki", R_n_local(dive.origin, reference.lat, reference.lon), arm_l)
    lat, lon, height = geodetic_from_ned(dive.origin, p_n - arm_n)
    turned = bool(np.any(rig.rotation_deg))
    return replace(
        reference,
        t_ns=reference.t_ns + rig.time_offset_ns,
        lat=lat,
        lon=lon,
        height=np.where(deep, height, np.nan),
        rph=rph_from_matrix(R_lb) if turned else reference.rph,
        v_n=reference.v_n - np.gradient(arm_l, reference.t_s, axis=0),
    )
