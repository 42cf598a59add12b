"""Simulated dives, and simulated sensors on real ones."""

from uwgraph.simulate.degrade import add_depth, add_dvl, add_fixes, add_sun, add_sun_heading, degrade_imu
from uwgraph.simulate.dive import SimulationSettings, simulate, trajectory_of, truth
from uwgraph.simulate.imu import GRADES, ImuGrade
from uwgraph.simulate.sensors import DepthModel, DvlModel, GnssModel, HeadingModel, SunModel

__all__ = [
    "GRADES",
    "DepthModel",
    "DvlModel",
    "GnssModel",
    "HeadingModel",
    "ImuGrade",
    "SimulationSettings",
    "SunModel",
    "add_depth",
    "add_dvl",
    "add_fixes",
    "add_sun",
    "add_sun_heading",
    "degrade_imu",
    "simulate",
    "trajectory_of",
    "truth",
]
