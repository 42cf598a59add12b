"""Relative pose errors: how far a trajectory drifts over a distance travelled, wherever it started.

A rigid motion of the whole estimate changes nothing, so no alignment is needed. The definition is that of the TUM
RGB-D benchmark (Sturm et al. 2012) with distances in place of times, over all pairs (Geiger et al. 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from uwgraph.evaluate.statistics import rms
from uwgraph.frames import wrap_pi
from uwgraph.types import FloatArray, TimeArray

TOLERANCE: Final = 0.1
"""A pair is taken when the distance between its poses is within this share of the one asked for."""
MAX_STARTS: Final = 100_000
"""With more poses, every so many of them starts a pair, as ``pair_spacing`` says."""


def usual_distances(travelled_m: float) -> tuple[float, ...]:
    """The four longest of 1, 2, 5, 10, 20, 50, ... m that are no longer than half the way; 20 to 200 m for 700 m."""
    if not travelled_m > 0.0:
        return ()
    top = int(np.ceil(np.log10(travelled_m)))
    ladder = [step * 10.0**power for power in range(top - 3, top + 1) for step in (1.0, 2.0, 5.0)]
    return tuple(distance for distance in ladder if distance <= travelled_m / 2.0)[-4:]


def relative_errors(
    p: FloatArray,
    R: FloatArray,
    p_true: FloatArray,
    R_true: FloatArray,
    e_heading: FloatArray,
    distances: Sequence[float] | None = None,
) -> list[dict[str, Any]]:
    """RMS errors of the motion between poses that are a distance apart along the reference's way.

    Every pose starts a pair; it ends at the later pose whose distance travelled is nearest to the one asked for, if
    within :data:`TOLERANCE`. Rows of poses that are not known are left out.

    Parameters
    ----------
    p, p_true : array
        Positions of estimate and reference in one frame, shape (K, 3), m; the down component may be NaN.
    R, R_true : array
        Rotations body to that frame, shape (K, 3, 3); NaN where not known.
    e_heading : array
        Heading error, shape (K,), rad; used where the attitude is not known.
    distances : sequence of float, optional
        Metres; :func:`usual_distances` by default.

    Returns
    -------
    list of dict
        A row for every distance that has pairs: ``distance_m``, ``pairs``, ``pair_spacing`` (poses from start to
        start), ``translation_rmse_m``, ``translation_rmse_percent`` (of each pair's own distance),
        ``heading_rmse_deg``, ``rotation_rmse_deg`` and ``axes``: translations are compared in the ``body`` at the
        start, or in the ``navigation`` frame where attitudes or heights are not known.
    """
    placed = np.isfinite(p[:, :2]).all(axis=1) & np.isfinite(p_true[:, :2]).all(axis=1)
    posed = placed & np.isfinite(p[:, 2] + p_true[:, 2]) & np.isfinite(R + R_true).all(axis=(1, 2))
    in_body = bool(posed.any())
    k = posed if in_body else placed
    p, R, p_true, R_true, e_heading = p[k], R[k], p_true[k], R_true[k], e_heading[k]
    if not in_body:
        deep = np.isfinite(p + p_true).all(axis=0)
        p, p_true = p[:, deep], p_true[:, deep]
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p_true, axis=0), axis=1))])
    rows = []
    for distance in usual_distances(travelled[-1]) if distances is None else distances:
        spacing = -(-len(p) // MAX_STARTS)
        i, j = pairs_apart(travelled, distance, spacing)
        if len(i) == 0:
            continue
        if in_body:
            translation, rotation, heading = _errors_in_body(p, R, p_true, R_true, i, j)
        else:
            translation = np.linalg.norm((p[j] - p[i]) - (p_true[j] - p_true[i]), axis=1)
            rotation, heading = np.full(len(i), np.nan), wrap_pi(e_heading[j] - e_heading[i])
        rows.append(
            {
                "distance_m": float(distance),
                "pairs": len(i),
                "pair_spacing": spacing,
                "translation_rmse_m": rms(translation),
                "translation_rmse_percent": rms(100.0 * translation / (travelled[j] - travelled[i])),
                "heading_rmse_deg": rms(np.degrees(heading)),
                "rotation_rmse_deg": rms(np.degrees(rotation)),
                "axes": "body" if in_body else "navigation",
            }
        )
    return rows


def pairs_apart(travelled: FloatArray, distance: float, spacing: int = 1) -> tuple[TimeArray, TimeArray]:
    """Starts and ends of pairs: the later pose nearest to ``distance`` from the start, the first of those as near."""
    i = np.arange(0, len(travelled) - 1, spacing)
    after = np.searchsorted(travelled, travelled[i] + distance, side="left")
    after = np.clip(after, i + 1, len(travelled) - 1)
    # the last pose before; where the vehicle stood still there, the first of those at the same place
    before = np.searchsorted(travelled, travelled[np.maximum(after - 1, i + 1)], side="left")
    before = np.maximum(before, i + 1)
    short, long = (np.abs(travelled[j] - travelled[i] - distance) for j in (before, after))
    j = np.where(short <= long, before, after)
    fits = np.minimum(short, long) <= TOLERANCE * distance
    return i[fits], j[fits]


def _errors_in_body(
    p: FloatArray, R: FloatArray, p_true: FloatArray, R_true: FloatArray, i: TimeArray, j: TimeArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Length of the error of translation [m], angle of that of rotation and its part about the vertical [rad]."""
    moved, moved_true = _relative(p, R, i, j), _relative(p_true, R_true, i, j)
    turned, turned_true = (np.swapaxes(x[i], 1, 2) @ x[j] for x in (R, R_true))
    error = Rotation.from_matrix(np.swapaxes(turned_true, 1, 2) @ turned).as_rotvec()
    down_b = R_true[j][:, 2, :]
    return (
        np.linalg.norm(moved - moved_true, axis=1),
        np.linalg.norm(error, axis=1),
        np.sum(error * down_b, axis=1),
    )


def _relative(p: FloatArray, R: FloatArray, i: TimeArray, j: TimeArray) -> FloatArray:
    """The way from pose i to pose j in the body axes of i, shape (N, 3), m."""
    way: FloatArray = np.einsum("kji,kj->ki", R[i], p[j] - p[i])
    return way
