"""Calibrations that others made, from one or several files: an IMU's noise, a camera, how it sits and keeps time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path
from typing import Final

import numpy as np

from uwgraph.camera.file import CameraFile, read_camera
from uwgraph.camera.formats import file_values, is_kalibr, is_matrix_file, is_opencv
from uwgraph.camera.on_imu import CameraOnImu, camera_on_imu
from uwgraph.dive.kalibr import KalibrImu, imus_of
from uwgraph.dive.logs.axes import turn
from uwgraph.dive.rig import Rig
from uwgraph.dive.yamlfile import read_text
from uwgraph.errors import ConfigError

AXES: Final = tuple(
    name
    for pairs in permutations(("fb", "rl", "du"))
    for name in map("".join, product(*pairs))
    if np.linalg.det(turn(name)) > 0.0
)
"""Right-handed axes by the directions of x, y and z: forward or back, right or left, down or up."""


@dataclass(frozen=True, eq=False)
class Calibrations:
    """What the files hold."""

    imu: KalibrImu | None = None
    imu_name: str = ""
    camera: CameraFile | None = None
    """With its mounting as :func:`~uwgraph.camera.file.read_camera` takes it."""
    on_imu: CameraOnImu | None = None
    """How the camera sits on the first IMU, where a file tells."""

    def rig(self, base: Rig) -> Rig:
        """The rig with the IMU's noise and clock, and the camera's clock where it is stated."""
        update: dict[str, object] = {}
        if self.imu is not None:
            update["imu"] = self.imu.rig(base.imu)
        if self.on_imu is not None and self.on_imu.time_offset_s is not None:
            clock = {"time_offset_s": self.on_imu.time_offset_s}
            update |= {"sun": base.sun.model_copy(update=clock), "visual": base.visual.model_copy(update=clock)}
        return base.model_copy(update=update)

    def mounted_camera(self, imu_axes: str | None) -> CameraFile | None:
        """The camera, mounted as its file tells; ``imu_axes`` names the axes of the dive's IMU in the vehicle.

        Raises
        ------
        ConfigError
            When the mounting is told against an IMU whose axes are not named.
        """
        if self.camera is None or self.on_imu is None:
            return self.camera
        if imu_axes not in AXES:
            raise ConfigError(
                "the camera's mounting is told against the IMU: where do the IMU's x, y and z point in the vehicle?"
                if imu_axes is None
                else f"{imu_axes!r} names no right-handed axes",
                where="--imu-axes",
                remedy=f"one of {', '.join(AXES)} (forward, back, right, left, down, up)",
            )
        R_ib, p_ib = (np.eye(3), np.zeros(3)) if self.imu is None else (self.imu.R_ib, self.imu.p_ib)
        R_bi = turn(imu_axes)
        R_bs, l_b = R_bi @ R_ib @ self.on_imu.R_is, R_bi @ (R_ib @ self.on_imu.p_is + p_ib)
        mounted = replace(self.camera.camera, R_bs=R_bs, l_b=l_b)
        return replace(self.camera, camera=mounted)


def read_calibrations(files: Sequence[Path], imu: str | None = None, camera: str | None = None) -> Calibrations:
    """Read Kalibr's, allan_variance_ros's, OpenVINS's and OpenCV's files, and our own camera file, by their keys.

    Parameters
    ----------
    imu, camera : str, optional
        Which ones to take where there are several; otherwise the first by name.

    Raises
    ------
    ConfigError
        When a file cannot be used or holds neither, when two hold the same, or there is none of the name.
    """
    imus: dict[str, KalibrImu] = {}
    cameras: list[tuple[CameraFile, CameraOnImu | None]] = []
    for path in files:
        text, where = read_text(path), str(path)
        values = file_values(text, where)
        here = imus_of(values, where)
        if twice := sorted(imus.keys() & here.keys()):
            raise ConfigError(f"holds {twice[0]!r}, as another file does", where=where, remedy="give one of them")
        imus |= here
        if is_kalibr(values):
            cameras.append((read_camera(path, camera), camera_on_imu(values, where, camera)))
        elif (is_opencv(text) and not here) or is_matrix_file(values) or "f" in values:
            cameras.append((read_camera(path), None))
        elif not here:
            raise ConfigError(
                "holds neither an IMU nor a camera",
                where=where,
                remedy="give imu.yaml or camchain.yaml of Kalibr, or a camera calibration of OpenCV",
            )
        if len(cameras) > 1:
            raise ConfigError("holds a camera, as another file does", where=where, remedy="give one of them")
    name = imu or min(imus, default="")
    if name and name not in imus:
        raise ConfigError(f"there is no IMU {name!r}", where="--imu", remedy=f"there is {', '.join(imus) or 'none'}")
    found, on_imu = cameras[0] if cameras else (None, None)
    return Calibrations(imus.get(name), name, found, on_imu)
