"""IMU noise as Kalibr's ``imu.yaml`` states it, which allan_variance_ros and OpenVINS write too.

Flat, or one block per IMU (``imu0:`` ...), as Kalibr's results have it. There, ``T_i_b`` takes vectors of the first IMU
to this one, and ``time_offset`` is added to this one's stamps to get the first one's clock
(https://github.com/ethz-asl/kalibr/wiki/yaml-formats).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from uwgraph.dive.rig import Finite, ImuRig, Positive
from uwgraph.dive.yamlfile import parse_settings
from uwgraph.errors import ConfigError
from uwgraph.types import FloatArray

ROTATION_ERROR: Final = 1e-3
"""What R R^T may be off the identity: files are rounded."""

_RIG_FIELDS: Final = {
    "gyroscope_noise_density": "gyro_noise_density",
    "accelerometer_noise_density": "accel_noise_density",
    "gyroscope_random_walk": "gyro_bias_walk",
    "accelerometer_random_walk": "accel_bias_walk",
}


def _bare(value: Any) -> Any:
    """The number in ``np.float64(0.1)``, which scripts write that print NumPy's numbers."""
    found = re.fullmatch(r"\s*np\.float(?:32|64)\((.{1,40})\)\s*", value) if isinstance(value, str) else None
    return found[1] if found else value


Density = Annotated[Positive, BeforeValidator(_bare)]
Matrix4 = Annotated[tuple[tuple[Finite, Finite, Finite, Finite], ...], Field(min_length=4, max_length=4)]


class KalibrImu(BaseModel):
    """One IMU; keys that say nothing of noise, place or clock are left alone."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    gyroscope_noise_density: Density | None = None
    """rad/s/sqrt(Hz)."""
    gyroscope_random_walk: Density | None = None
    """rad/s^2/sqrt(Hz)."""
    accelerometer_noise_density: Density | None = None
    """m/s^2/sqrt(Hz)."""
    accelerometer_random_walk: Density | None = None
    """m/s^3/sqrt(Hz)."""
    time_offset: Annotated[float, Field(ge=-3600, le=3600)] = 0.0
    """s, added to the stamps."""
    T_i_b: Matrix4 | None = None
    """From the first IMU to this one."""

    @model_validator(mode="after")
    def _useful(self) -> KalibrImu:
        if not any(getattr(self, name) is not None for name in _RIG_FIELDS):
            raise ValueError(f"states none of {', '.join(_RIG_FIELDS)}")
        if self.T_i_b is not None:
            rotation_of(self.T_i_b)
        return self

    @property
    def R_ib(self) -> FloatArray:
        """Rotation from the first IMU to this one, shape (3, 3)."""
        return np.eye(3) if self.T_i_b is None else rotation_of(self.T_i_b)

    @property
    def p_ib(self) -> FloatArray:
        """Place of the first IMU in this one's frame, shape (3,), m."""
        return np.zeros(3) if self.T_i_b is None else np.asarray(self.T_i_b, dtype=np.float64)[:3, 3]

    def rig(self, base: ImuRig) -> ImuRig:
        """The rig with what is stated here; every other field as it was."""
        stated = {ours: value for theirs, ours in _RIG_FIELDS.items() if (value := getattr(self, theirs)) is not None}
        return base.model_copy(update=stated | {"time_offset_s": self.time_offset})


def rotation_of(T: Any) -> FloatArray:
    """The rotation of a rigid transform of 4 x 4 numbers, made exact, shape (3, 3).

    Raises
    ------
    ValueError
        When it is none.
    """
    matrix = np.asarray(T, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError("is not a matrix of 4 x 4 numbers")
    if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > ROTATION_ERROR:
        raise ValueError("is no rigid transform: the last row is not 0, 0, 0, 1")
    R = matrix[:3, :3]
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > ROTATION_ERROR:
        raise ValueError(f"holds no rotation: R R^T is off the identity by {off:.2g}")
    if np.linalg.det(R) < 0.0:
        raise ValueError("holds a mirror image, not a rotation (determinant -1)")
    u, _, vt = np.linalg.svd(R)
    return np.asarray(u @ vt)


def imus_of(values: Mapping[str, Any], where: str) -> dict[str, KalibrImu]:
    """The IMUs of a calibration by name, ``imu0`` for one without; none where the file is not about IMUs.

    Raises
    ------
    ConfigError
        When an IMU's block cannot be used, naming file and key.
    """
    if isinstance(values.get("Gyr"), dict) or isinstance(values.get("Acc"), dict):
        raise ConfigError(
            "is of imu_utils, whose gyr_n and acc_n are noise per sample and gyr_w and acc_w bias instabilities: "
            "none of them is a density",
            where=where,
            remedy="take them from the same recording with 'uwgraph calibrate noise'",
        )
    if any(name in values for name in _RIG_FIELDS):
        return {"imu0": parse_settings(KalibrImu, dict(values), where)}
    blocks = {name: block for name, block in values.items() if re.fullmatch(r"imu\d*", str(name))}
    return {name: parse_settings(KalibrImu, block, f"{where}: {name}") for name, block in blocks.items()}
