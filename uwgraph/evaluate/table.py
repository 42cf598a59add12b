"""The solution as files: one row per keyframe in people's units, and the TUM trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from uwgraph.evaluate.people import people, sigmas
from uwgraph.time import NS
from uwgraph.types import ClosureVerdicts, FloatArray, Innovations, Solution, TimeArray, stream_fields


def solution_table(solution: Solution) -> pa.Table:
    """Every state and its 1-sigma at every keyframe.

    ``sigma_X`` is the 1-sigma of column ``X`` in the same unit: positions and velocities along n (metres, m/s), roll,
    pitch and heading in degrees, biases in SI. ``height`` is against the sea surface. The position's correlations are
    ``cov_north_east``, ``cov_north_down`` and ``cov_east_down`` (m^2).
    """
    read = people(solution)
    columns: dict[str, FloatArray] = {
        "lat_deg": np.degrees(read.lat),
        "lon_deg": np.degrees(read.lon),
        "height": read.height,
    }
    cov_p = read.cov_p_n
    columns |= _with_sigma(("north", "east", "down"), solution.p_n, sigmas(cov_p))
    columns |= _with_sigma(
        ("roll_deg", "pitch_deg", "heading_deg"), _degrees(read.rph), np.degrees(sigmas(read.cov_rph))
    )
    columns |= _with_sigma(("v_n", "v_e", "v_d"), solution.v_n, sigmas(solution.cov_v))
    sigma_bias = sigmas(solution.cov_bias)
    columns |= _with_sigma(tuple(f"bias_gyro_{a}" for a in "xyz"), solution.bias_gyro, sigma_bias[:, 3:])
    columns |= _with_sigma(tuple(f"bias_accel_{a}" for a in "xyz"), solution.bias_accel, sigma_bias[:, :3])
    columns |= {
        "cov_north_east": cov_p[:, 0, 1],
        "cov_north_down": cov_p[:, 0, 2],
        "cov_east_down": cov_p[:, 1, 2],
    }
    return pa.table({"t_ns": solution.t_ns} | columns)


def closures_table(verdicts: ClosureVerdicts) -> pa.Table:
    """What was decided about every closure, a column for every field of :class:`uwgraph.types.ClosureVerdicts`."""
    return pa.table(dict(stream_fields(verdicts)))


def innovations_table(innovations: Innovations) -> pa.Table:
    """What a filter made of its measurements, in :class:`uwgraph.types.Innovations`; vectors as columns _1, _2, ..."""
    columns: dict[str, Any] = {}
    for name, array in stream_fields(innovations):
        if array.ndim == 1:
            columns[name] = array
        else:
            columns |= {f"{name}_{i}": column for i, column in enumerate(array.T, start=1)}
    return pa.table(columns)


def trajectory_tum(solution: Solution) -> str:
    """Lines of ``t x y z qx qy qz qw``: seconds UTC with 9 decimals, position and quaternion of T_nb (NED, FRD)."""
    return tum_lines(solution.t_ns, solution.p_n, solution.R_nb)


def tum_lines(t_ns: TimeArray, p: FloatArray, R: FloatArray) -> str:
    """Lines of ``t x y z qx qy qz qw`` of poses in any frame: positions (K, 3), rotations (K, 3, 3)."""
    quaternions = Rotation.from_matrix(R).as_quat()
    rows = zip(t_ns.tolist(), p.tolist(), quaternions.tolist(), strict=True)
    return "".join(
        f"{t // NS}.{t % NS:09d} {x:.6f} {y:.6f} {z:.6f} {qx:.12f} {qy:.12f} {qz:.12f} {qw:.12f}\n"
        for t, (x, y, z), (qx, qy, qz, qw) in rows
    )


def _degrees(rph: FloatArray) -> FloatArray:
    """Roll and pitch signed, heading from 0 to 360."""
    out = np.degrees(rph)
    out[:, 2] %= 360.0
    return out


def _with_sigma(names: tuple[str, ...], values: FloatArray, sigma: FloatArray) -> dict[str, FloatArray]:
    columns = dict(zip(names, values.T, strict=True))
    return columns | {f"sigma_{name}": s for name, s in zip(names, sigma.T, strict=True)}
