"""World and body axes by name: ours are NED and FRD, and whoever reads the file wants others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from uwgraph.dive.logs.axes import turn
from uwgraph.export.track import Track
from uwgraph.types import FloatArray

FrameName = Literal["ned", "enu", "euroc"]


@dataclass(frozen=True, eq=False)
class Axes:
    """A world and a body frame; both have our origins (the dive's, and the IMU)."""

    world: str
    body: str
    world_id: str
    """What ROS and Foxglove call the world frame (REP 105 and 103, MAVROS)."""
    body_id: str
    R_wn: FloatArray
    """Rotation from n to the world, shape (3, 3)."""
    R_xb: FloatArray
    """Rotation from our body axes to those of the file, shape (3, 3)."""

    def __str__(self) -> str:
        return f"{self.world} world, {self.body} body"

    def position(self, track: Track) -> FloatArray:
        """Positions in the world, shape (K, 3), m."""
        p: FloatArray = track.p_n @ self.R_wn.T
        return p

    def velocity(self, track: Track) -> FloatArray:
        """Velocities in the world, shape (K, 3), m/s."""
        v: FloatArray = track.v_n @ self.R_wn.T
        return v

    def rotation(self, track: Track) -> FloatArray:
        """Rotations body to world, shape (K, 3, 3)."""
        R: FloatArray = self.R_wn @ track.R_nb @ self.R_xb.T
        return R


AXES: Final[Mapping[FrameName, Axes]] = {
    "ned": Axes("NED", "FRD", "map_ned", "base_link_frd", turn("ned").T, turn("frd").T),
    "enu": Axes("ENU", "FLU", "map", "base_link", turn("enu").T, turn("flu").T),
    "euroc": Axes("NWU", "URF (x up, y right, z forward)", "R", "S", turn("nwu").T, turn("urf").T),
}
