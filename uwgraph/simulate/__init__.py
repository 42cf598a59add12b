"""Simulated dives, and simulated sensors on real ones."""

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
    "simulate",
    "trajectory_of",
    "truth",
]
