"""The rig: where the sensors sit, how noisy they are, and how their clocks differ.

Unknown keys are errors. Angles are degrees in the file (names end in ``_deg``) and radians in code. A sensor's
``rotation_deg`` is roll, pitch, yaw of R_bs (sensor to body); ``translation_m`` is the sensor's place in the body
frame, whose origin is the IMU. ``time_offset_s`` is added to a sensor's stamps to get the dive's clock.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from uwgraph.frames import matrix_from_rph
from uwgraph.types import FloatArray

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]


class Settings(BaseModel):
    """Frozen, and strict about unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Sensor(Settings):
    """What every sensor has: its mounting and its clock."""

    rotation_deg: Vector3 = (0.0, 0.0, 0.0)
    time_offset_s: Annotated[float, Field(ge=-3600, le=3600)] = 0.0

    @property
    def R_bs(self) -> FloatArray:
        """Rotation sensor to body, shape (3, 3)."""
        return matrix_from_rph(np.radians(self.rotation_deg))

    @property
    def time_offset_ns(self) -> int:
        return round(self.time_offset_s * 1e9)


class MountedSensor(Sensor):
    """A sensor away from the body origin."""

    translation_m: Vector3 = (0.0, 0.0, 0.0)

    @property
    def l_b(self) -> FloatArray:
        """Lever arm from the IMU to the sensor in the body frame, shape (3,), m."""
        return np.array(self.translation_m)


class ImuRig(Sensor):
    """Noise of the IMU as densities; its place is the origin of the body frame, so it has no translation."""

    gyro_noise_density: Positive = 5e-5
    """rad/s/sqrt(Hz), the angle random walk."""
    accel_noise_density: Positive = 5e-4
    """m/s^2/sqrt(Hz), the velocity random walk."""
    gyro_bias_walk: Positive = 1e-7
    """rad/s^2/sqrt(Hz): how fast the gyro bias wanders."""
    accel_bias_walk: Positive = 1e-5
    """m/s^3/sqrt(Hz): how fast the accelerometer bias wanders."""
    gyro_bias_sigma: Positive = 5e-5
    """rad/s, 1-sigma of the bias at the start of the dive."""
    accel_bias_sigma: Positive = 2e-2
    """m/s^2, 1-sigma of the bias at the start of the dive."""
    gyro_range: Positive = 10.0
    """rad/s, full scale."""
    accel_range: Positive = 100.0
    """m/s^2, full scale."""


class DvlRig(MountedSensor):
    """The Doppler log."""

    sigma: Positive = 0.01
    """m/s per axis and ping, where the log states no covariance."""
    scale: Positive = 1.0
    """True velocity over measured velocity."""
    scale_sigma: NonNegative = 0.002
    """1-sigma of what is left of the scale error."""
    misalignment_sigma_deg: NonNegative = 0.2
    """1-sigma per axis of what is left of the mounting error."""
    max_gap_s: Positive = 3.0
    """Two pings further apart than this give no displacement."""


class DepthRig(MountedSensor):
    """The pressure or depth sensor."""

    sigma: Positive = 0.05
    """m, where the log states none."""


class AltitudeRig(MountedSensor):
    """The echo sounder that measures the distance to the bottom along its z axis (down, where it is not turned)."""

    sigma: Positive = 0.05
    """m, where the log states none."""


class VisualRig(Settings):
    """The clock of the camera that visual odometry and closures come from; its mounting is in its camera file."""

    time_offset_s: Annotated[float, Field(ge=-3600, le=3600)] = 0.0

    @property
    def time_offset_ns(self) -> int:
        return round(self.time_offset_s * 1e9)


class FixesRig(MountedSensor):
    """The antenna or transponder that the fixes are of."""

    sigma: Positive = 3.0
    """m per axis, where the log states no covariance."""


class HeadingRig(Sensor):
    """The compass; of its ``rotation_deg`` only the yaw is used: what it points to the right of the body's x axis."""

    sigma_deg: Positive = 1.0
    """Where the log states none."""
    declination_deg: float | None = None
    """Added to a magnetic heading to get the true one; a magnetic stream without it is refused."""


class SunRig(Sensor):
    """The sun sensor: its clock, and as ``rotation_deg`` what is left of its mounting, since its observations are
    turned to the body by the camera's calibration."""


class ReferenceRig(MountedSensor):
    """The point of the vehicle that the reference is of, and the reference's clock; used only to judge a solution."""


class Rig(Settings):
    """All sensors of a vehicle."""

    imu: ImuRig = ImuRig()
    dvl: DvlRig = DvlRig()
    depth: DepthRig = DepthRig()
    fixes: FixesRig = FixesRig()
    heading: HeadingRig = HeadingRig()
    sun: SunRig = SunRig()
    altitude: AltitudeRig = AltitudeRig()
    visual: VisualRig = VisualRig()
    reference: ReferenceRig = ReferenceRig()
