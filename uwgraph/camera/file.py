"""Camera files: our own YAML, Kalibr's camchain, OpenCV's FileStorage (YAML or XML), ROS's camera_info: by their keys.

``mount``, ``R_bs``, ``translation_m``, ``port``, ``analyser``, ``mosaic``, ``polarizer_deg`` and ``sensor`` may be
added to any of them.

Our own::

    model: fisheye              # or pinhole
    f: [820.5, 819.8]           # pixels; one number for both
    c: [1223.2, 1022.9]         # principal point (column, row)
    size: [2448, 2048]          # width, height
    distortion: [0.01, -0.002, 0.0, 0.0]
    mount: up-forward           # or down-forward, or R_bs: nine numbers by rows, camera to body (forward, right, down)
    translation_m: [0, 0, 0]    # the camera's place in the vehicle, from the IMU: forward, right, down
    port: dome                  # or flat
    analyser: lens              # or sheet, projected
    mosaic: sony
    polarizer_deg: [0, 45, 90, 135]
    sensor: {white: 4000, black: 60, gain: 2.5, read_noise: 3}
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from uwgraph.camera.formats import (
    file_values,
    is_kalibr,
    is_matrix_file,
    is_opencv,
    kalibr_values,
    opencv_values,
)
from uwgraph.camera.model import DOWN_FORWARD, UP_FORWARD, Analyser, Camera, Model, Port
from uwgraph.camera.sensor import Sensor
from uwgraph.dive.yamlfile import parse_settings, read_text
from uwgraph.errors import ConfigError
from uwgraph.types import FloatArray

MOUNTS: Final = {"up-forward": UP_FORWARD, "down-forward": DOWN_FORWARD}
"""Usual mountings, by name: where the camera looks, and where the top of its image points."""
COEFFICIENTS: Final = {"pinhole": (0, 4, 5, 8, 12, 14), "fisheye": (0, 4)}
"""How many distortion coefficients OpenCV's models take."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Extent = Annotated[int, Field(ge=1, le=100_000)]


@dataclass(frozen=True, eq=False)
class CameraFile:
    """What a camera file tells."""

    camera: Camera
    sensor: Sensor | None = None
    """None where the file does not say: see :meth:`uwgraph.camera.sensor.Sensor.of`."""
    mosaic: str | None = None
    """Name of the division-of-focal-plane layout."""
    polarizer_deg: tuple[float, ...] | None = None
    """Angles of the polarizers of separate images, from image +x towards +y, degrees."""


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _SensorSettings(_Settings):
    white: Positive
    black: NonNegative = 0.0
    gain: Positive = 1.0
    read_noise: NonNegative = 3.0


class _CameraSettings(_Settings):
    model: Model
    f: tuple[Positive, Positive]
    c: tuple[Finite, Finite]
    size: tuple[Extent, Extent]
    distortion: tuple[Finite, ...] = ()
    mount: Literal["up-forward", "down-forward"] | None = None
    R_bs: tuple[Finite, ...] | None = None
    translation_m: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    port: Port = "dome"
    analyser: Analyser = "lens"
    mosaic: str | None = None
    polarizer_deg: Annotated[tuple[Finite, ...], Field(min_length=3)] | None = None
    sensor: _SensorSettings | None = None

    @field_validator("f", mode="before")
    @classmethod
    def _one_for_both(cls, f: Any) -> Any:
        return (f, f) if isinstance(f, int | float) else f

    @field_validator("R_bs", mode="before")
    @classmethod
    def _rows(cls, R: Any) -> Any:
        if isinstance(R, list) and R and all(isinstance(row, list) for row in R):
            return [value for row in R for value in row]
        return R

    @field_validator("R_bs")
    @classmethod
    def _rotation(cls, R: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if R is not None:
            if len(R) != 9:
                raise ValueError("a rotation has nine numbers, row by row")
            matrix = np.reshape(R, (3, 3))
            off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
            if off > 1e-3:
                raise ValueError(f"is no rotation: R R^T is off the identity by {off:.2g}")
            if np.linalg.det(matrix) < 0.0:
                raise ValueError("is a mirror image, not a rotation (determinant -1)")
        return R

    @model_validator(mode="after")
    def _consistent(self) -> _CameraSettings:
        if len(self.distortion) not in COEFFICIENTS[self.model]:
            counts = ", ".join(map(str, COEFFICIENTS[self.model]))
            raise ValueError(
                f"distortion of a {self.model} camera has {counts} coefficients, not {len(self.distortion)}"
            )
        if self.mount is not None and self.R_bs is not None:
            raise ValueError("mount and R_bs say the same: give one of them")
        return self

    def _rotation_bs(self) -> FloatArray:
        if self.R_bs is not None:
            return _nearest_rotation(np.reshape(self.R_bs, (3, 3)))
        return MOUNTS[self.mount or "up-forward"].copy()

    def camera_file(self) -> CameraFile:
        return CameraFile(
            Camera(
                model=self.model,
                f=self.f,
                c=self.c,
                size=self.size,
                distortion=self.distortion,
                R_bs=self._rotation_bs(),
                l_b=np.array(self.translation_m),
                port=self.port,
                analyser=self.analyser,
            ),
            None if self.sensor is None else Sensor(**self.sensor.model_dump()),
            self.mosaic,
            self.polarizer_deg,
        )


def read_camera(path: Path, name: str | None = None) -> CameraFile:
    """The camera of a file in any of the formats above; ``name`` is that of one in a camchain.

    Kalibr's and OpenCV's files do not say how the camera sits in the vehicle (Kalibr's ``T_cam_imu`` refers to its own
    IMU): the mounting is taken as up-forward unless the caller replaces ``R_bs``. Of a camchain the first camera is
    taken where none is named.

    Raises
    ------
    ConfigError
        When the file cannot be read, or a field is missing or unusable; it names file and field.
    """
    text, where = read_text(path), str(path)
    values = file_values(text, where)
    if not values:
        raise ConfigError("holds no camera", where=where, remedy="give model, f, c and size")
    if is_kalibr(values):
        values = kalibr_values(values, where, name)
    elif is_opencv(text) or is_matrix_file(values):
        values = opencv_values(values, where)
    return parse_settings(_CameraSettings, values, where).camera_file()


def write_camera(path: Path, file: CameraFile) -> None:
    """Write our own YAML; :func:`read_camera` gives the same back."""
    camera = file.camera
    values: dict[str, Any] = {
        "model": camera.model,
        "f": [float(x) for x in camera.f],
        "c": [float(x) for x in camera.c],
        "size": [int(x) for x in camera.size],
        "distortion": [float(x) for x in camera.distortion],
        "port": camera.port,
        "analyser": camera.analyser,
    }
    named = next((name for name, R_bs in MOUNTS.items() if np.array_equal(camera.R_bs, R_bs)), None)
    values |= {"mount": named} if named else {"R_bs": camera.R_bs.ravel().tolist()}
    if camera.l_b.any():
        values["translation_m"] = camera.l_b.tolist()
    if file.mosaic is not None:
        values["mosaic"] = file.mosaic
    if file.polarizer_deg is not None:
        values["polarizer_deg"] = [float(x) for x in file.polarizer_deg]
    if file.sensor is not None:
        sensor = file.sensor
        values["sensor"] = {
            "white": float(sensor.white),
            "black": float(sensor.black),
            "gain": float(sensor.gain),
            "read_noise": float(sensor.read_noise),
        }
    path.write_text(yaml.safe_dump(values, sort_keys=False, default_flow_style=None), encoding="utf-8")


def _nearest_rotation(R: FloatArray) -> FloatArray:
    u, _, vt = np.linalg.svd(R)
    return np.asarray(u @ vt)
