"""How a camera sits on an IMU, as Kalibr's ``camchain-imucam.yaml`` and OpenVINS's files have it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from uwgraph.camera.formats import kalibr_camera
from uwgraph.dive.kalibr import Matrix4, rotation_of
from uwgraph.dive.yamlfile import parse_settings
from uwgraph.types import FloatArray


@dataclass(frozen=True, eq=False)
class CameraOnImu:
    """Mounting and clock of a camera."""

    R_is: FloatArray
    """Rotation from the camera to the first IMU, shape (3, 3)."""
    p_is: FloatArray
    """The camera's place in the first IMU's frame, shape (3,), m."""
    time_offset_s: float | None
    """Added to the camera's stamps to get the IMU's; None where it is not stated."""


class _Extrinsics(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)

    T_cam_imu: Matrix4 | None = None
    """Kalibr's: from the IMU to the camera."""
    T_imu_cam: Matrix4 | None = None
    """OpenVINS's: from the camera to the IMU."""
    timeshift_cam_imu: Annotated[float, Field(ge=-3600, le=3600)] | None = None

    @field_validator("T_cam_imu", "T_imu_cam")
    @classmethod
    def _rigid(cls, T: Matrix4 | None) -> Matrix4 | None:
        if T is not None:
            rotation_of(T)
        return T


def camera_on_imu(chain: Mapping[str, Any], where: str, camera: str | None = None) -> CameraOnImu | None:
    """Mounting and clock of a camera of a camchain, the first one by default; None where no mounting is stated.

    Raises
    ------
    ConfigError
        When there is no such camera, or what is stated cannot be used.
    """
    values, where = kalibr_camera(chain, where, camera)
    found = parse_settings(_Extrinsics, dict(values), where)
    if found.T_imu_cam is not None:
        return CameraOnImu(rotation_of(found.T_imu_cam), _translation(found.T_imu_cam), found.timeshift_cam_imu)
    if found.T_cam_imu is not None:
        R_is = np.ascontiguousarray(rotation_of(found.T_cam_imu).T)
        return CameraOnImu(R_is, -R_is @ _translation(found.T_cam_imu), found.timeshift_cam_imu)
    return None


def _translation(T: Matrix4) -> FloatArray:
    return np.asarray(T, dtype=np.float64)[:3, 3]
