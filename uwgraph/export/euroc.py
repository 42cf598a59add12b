"""EuRoC's ASL layout: the states as one CSV file, or a folder with the IMU beside it that ``uwgraph import`` reads.

The columns speak of a world R and of the IMU S, the body. In the data set R has z up and S is x up, y right, z forward;
that is what ``euroc`` frames mean, with R's x to the north.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from uwgraph.dive.model import Dive
from uwgraph.export.axes import Axes
from uwgraph.export.poses import write_columns
from uwgraph.export.track import Track
from uwgraph.types import FloatArray

STATES: Final = Path("mav0/state_groundtruth_estimate0/data.csv")
IMU: Final = Path("mav0/imu0/data.csv")


def write_euroc(track: Track, path: Path, axes: Axes) -> None:
    """Stamp [ns], position, quaternion wxyz (body to world), velocity, gyro and accelerometer bias; NaN: not known."""
    wxyz = Rotation.from_matrix(axes.rotation(track)).as_quat(scalar_first=True)
    columns = (
        _named("p_RS_R_{} [m]", "xyz", axes.position(track))
        | _named("q_RS_{} []", "wxyz", wxyz)
        | _named("v_RS_R_{} [m s^-1]", "xyz", axes.velocity(track))
        | _named("b_w_RS_S_{} [rad s^-1]", "xyz", track.bias_gyro @ axes.R_xb.T)
        | _named("b_a_RS_S_{} [m s^-2]", "xyz", track.bias_accel @ axes.R_xb.T)
    )
    write_columns({"#timestamp": track.t_ns} | columns, path)


def write_asl_folder(track: Track, dive: Dive | None, folder: Path, axes: Axes) -> None:
    """The states and, of a dive, the IMU, each with its ``sensor.yaml``."""
    (folder / STATES).parent.mkdir(parents=True)
    write_euroc(track, folder / STATES, axes)
    _sensor_yaml(folder / STATES, {"sensor_type": "visual-inertial", "comment": f"uwgraph {track.name}: {axes}"})
    if dive is not None and dive.imu is not None:
        (folder / IMU).parent.mkdir(parents=True)
        _write_imu(dive, folder / IMU, axes)


def _write_imu(dive: Dive, path: Path, axes: Axes) -> None:
    """Instantaneous samples: our mean over (t_{i-1}, t_i] is, to second order, the value in the middle of it."""
    imu, rig = dive.imu, dive.rig.imu
    assert imu is not None
    period = int(np.median(np.diff(imu.t_ns))) if len(imu) > 1 else 0
    step = np.diff(imu.t_ns, prepend=imu.t_ns[0] - period)
    R_xs = axes.R_xb @ rig.R_bs
    columns = _named("w_RS_S_{} [rad s^-1]", "xyz", imu.w_s @ R_xs.T)
    columns |= _named("a_RS_S_{} [m s^-2]", "xyz", imu.f_s @ R_xs.T)
    write_columns({"#timestamp [ns]": imu.t_ns + rig.time_offset_ns - step // 2} | columns, path)
    noise = {
        "sensor_type": "imu",
        "comment": f"uwgraph: {axes.body}; interval means stamped in the middle of their intervals",
        "rate_hz": 1e9 / period if period else None,
        "gyroscope_noise_density": rig.gyro_noise_density,
        "gyroscope_random_walk": rig.gyro_bias_walk,
        "accelerometer_noise_density": rig.accel_noise_density,
        "accelerometer_random_walk": rig.accel_bias_walk,
    }
    _sensor_yaml(path, noise)


def _sensor_yaml(data: Path, values: Mapping[str, object]) -> None:
    text = yaml.safe_dump(dict(values), sort_keys=False, width=120)
    data.with_name("sensor.yaml").write_text(text, encoding="utf-8")


def _named(pattern: str, parts: str, values: FloatArray) -> dict[str, FloatArray]:
    return {pattern.format(part): column for part, column in zip(parts, values.T, strict=True)}
