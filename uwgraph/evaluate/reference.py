"""The reference brought to the keyframes' stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from uwgraph.frames import R_n_local, matrix_from_rph, ned_from_geodetic, rph_from_matrix
from uwgraph.types import BoolArray, FloatArray, Origin, Reference, TimeArray

GAP_FACTOR = 10.0
"""Nothing is interpolated across a gap longer than this many median sample periods."""


@dataclass(frozen=True, eq=False)
class ReferenceAt:
    """The reference at K stamps; NaN where it does not reach or does not know.

    A stamp counts as reached inside the reference's span and not inside a gap of more than :data:`GAP_FACTOR` periods.
    """

    p_n: FloatArray
    """Position in n, shape (K, 3), m; the down component is NaN where the reference has no height."""
    depth: FloatArray
    """Below the sea surface along the local vertical, shape (K,), m."""
    rph: FloatArray
    """Roll, pitch and heading against the local vertical and true north, shape (K, 3), rad."""

    @property
    def has_position(self) -> BoolArray:
        """Where north and east are known, shape (K,)."""
        return known_rows(self.p_n[:, :2])


def reference_at(reference: Reference, origin: Origin, t_ns: TimeArray) -> ReferenceAt:
    """Interpolate: positions by cubic Hermite where the velocity is known, else linearly; attitude by slerp."""
    t = (reference.t_ns - reference.t_ns[0]) * 1e-9
    query = (t_ns - reference.t_ns[0]) * 1e-9

    # Without heights the horizontal position is still known: put the point on the surface and forget its down.
    deep = np.isfinite(reference.height)
    p_n = ned_from_geodetic(origin, reference.lat, reference.lon, np.where(deep, reference.height, 0.0))
    v_n = np.einsum("kij,kj->ki", R_n_local(origin, reference.lat, reference.lon), reference.v_n)

    horizontal = interpolate_rows(t, p_n[:, :2], v_n[:, :2], query)
    down = interpolate_rows(t, np.where(deep, p_n[:, 2], np.nan)[:, None], v_n[:, 2:], query)
    depth = interpolate_rows(t, -reference.height[:, None], reference.v_n[:, 2:], query)[:, 0]
    return ReferenceAt(np.hstack([horizontal, down]), depth, _interpolate_rph(t, reference.rph, query))


def known_rows(table: FloatArray) -> BoolArray:
    """Rows without a NaN, shape (K,)."""
    return np.asarray(np.isfinite(table).all(axis=1))


def interpolate_rows(t: FloatArray, value: FloatArray, rate: FloatArray, query: FloatArray) -> FloatArray:
    """Rows of ``value`` at ``query``, from the rows that are finite, by Hermite where ``rate`` is; shape (K, n)."""
    out = np.full((len(query), value.shape[1]), np.nan)
    known = known_rows(value)
    t, value, rate = t[known], value[known], rate[known]
    inside = reached(t, query)
    if not inside.any():
        return out
    i = np.clip(np.searchsorted(t, query, side="right") - 1, 0, len(t) - 2)
    share = ((query - t[i]) / (t[i + 1] - t[i]))[:, None]
    linear = value[i] + share * (value[i + 1] - value[i])
    moving = known_rows(rate)
    cubic = CubicHermiteSpline(t, value, np.where(moving[:, None], rate, 0.0))(query)
    smooth = moving[i] & moving[i + 1]
    out[inside] = np.where(smooth[:, None], cubic, linear)[inside]
    return out


def _interpolate_rph(t: FloatArray, rph: FloatArray, query: FloatArray) -> FloatArray:
    """Slerp where all three angles are known, otherwise each known angle by itself along the shorter way."""
    known = known_rows(rph)
    if not known.any():
        each = []
        for angle in rph.T:
            seen = np.isfinite(angle)
            turned = np.full_like(angle, np.nan)
            turned[seen] = np.unwrap(angle[seen])
            each.append(interpolate_rows(t, turned[:, None], np.full((len(t), 1), np.nan), query))
        return np.hstack(each)
    return rph_from_matrix(interpolate_rotations(t[known], matrix_from_rph(rph[known]), query))


def interpolate_rotations(t: FloatArray, R: FloatArray, query: FloatArray) -> FloatArray:
    """Slerp between known rotations, shape (N, 3, 3), at ``query``; NaN where they do not reach, shape (K, 3, 3)."""
    out = np.full((len(query), 3, 3), np.nan)
    inside = reached(t, query)
    if inside.any():
        out[inside] = Slerp(t, Rotation.from_matrix(R))(query[inside]).as_matrix()
    return out


def reached(t: FloatArray, query: FloatArray) -> BoolArray:
    """Which queries lie between two samples that are not too far apart."""
    if len(t) < 2:
        return np.zeros(len(query), dtype=np.bool_)
    period = np.diff(t)
    i = np.clip(np.searchsorted(t, query, side="right") - 1, 0, len(t) - 2)
    near = (period[i] <= GAP_FACTOR * np.median(period)) | (query == t[i])
    reached: BoolArray = (query >= t[0]) & (query <= t[-1]) & near
    return reached
