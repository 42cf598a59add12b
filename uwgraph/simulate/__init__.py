"""Simulated dives, and simulated sensors on real ones."""

from uwgraph.simulate.begin import begin_at
from uwgraph.simulate.closures import ClosureModel, OdometryModel
from uwgraph.simulate.degrade import (
    add_closures,
    add_depth,
    add_dvl,
    add_fixes,
    add_odometry,
    add_sun,
    add_sun_heading,
    degrade_imu,
)
from uwgraph.simulate.dive import SimulationSettings, simulate, trajectory_of, truth
from uwgraph.simulate.floor import FLOOR_CAMERA, add_floor_images, terrain_of
from uwgraph.simulate.floor_model import EchoSounder, FloorModel, Ground, Lamp, Murk
from uwgraph.simulate.floor_terrain import Terrain
from uwgraph.simulate.images import SKY_CAMERA, ImageModel, add_sun_images
from uwgraph.simulate.imu import GRADES, ImuGrade
from uwgraph.simulate.render import Shot, render
from uwgraph.simulate.scene import OccluderSettings, Scene
from uwgraph.simulate.sensors import DepthModel, DvlModel, GnssModel, HeadingModel, SunModel

__all__ = [
    "FLOOR_CAMERA",
    "GRADES",
    "SKY_CAMERA",
    "ClosureModel",
    "DepthModel",
    "DvlModel",
    "EchoSounder",
    "FloorModel",
    "GnssModel",
    "Ground",
    "HeadingModel",
    "ImageModel",
    "ImuGrade",
    "Lamp",
    "Murk",
    "OccluderSettings",
    "OdometryModel",
    "Scene",
    "Shot",
    "SimulationSettings",
    "SunModel",
    "Terrain",
    "add_closures",
    "add_depth",
    "add_dvl",
    "add_fixes",
    "add_floor_images",
    "add_odometry",
    "add_sun",
    "add_sun_heading",
    "add_sun_images",
    "begin_at",
    "degrade_imu",
    "render",
    "simulate",
    "terrain_of",
    "trajectory_of",
    "truth",
]
