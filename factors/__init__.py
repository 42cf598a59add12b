"""The measurement models as GTSAM factors; imports numpy and gtsam, never uwgraph.

Poses are T_nb: body (FRD) to navigation (NED, Cartesian). Every measurement is a frozen dataclass with ``residual``,
``jacobians``, ``noise``, ``reference`` (a Python factor) and ``lowered`` (the native factor that equals it).
"""

from factors.adapter import ArrayMeasurement, Measurement, Poses, custom_factor
from factors.check import check_equivalence, check_jacobians
from factors.depth import Depth, depth_from_pressure
from factors.dvl import Displacements, DvlDisplacement, displacements, inertial_bend
from factors.dvl_calibration import CALIBRATION_DIM, CalibratedDisplacement, CalibratedDisplacements
from factors.dvl_velocity import DvlVelocity
from factors.heading import Heading
from factors.inertial import (
    ImuNoise,
    InertialMotion,
    imu_factor,
    integration_steps,
    preintegrate,
    preintegration_params,
    rotation_history,
)
from factors.place import RelativePose
from factors.position import PositionFix
from factors.sun import Direction, SunScatter, sun_scatter_factors

__all__ = [
    "CALIBRATION_DIM",
    "ArrayMeasurement",
    "CalibratedDisplacement",
    "CalibratedDisplacements",
    "Depth",
    "Direction",
    "Displacements",
    "DvlDisplacement",
    "DvlVelocity",
    "Heading",
    "ImuNoise",
    "InertialMotion",
    "Measurement",
    "Poses",
    "PositionFix",
    "RelativePose",
    "SunScatter",
    "check_equivalence",
    "check_jacobians",
    "custom_factor",
    "depth_from_pressure",
    "displacements",
    "imu_factor",
    "inertial_bend",
    "integration_steps",
    "preintegrate",
    "preintegration_params",
    "rotation_history",
    "sun_scatter_factors",
]
