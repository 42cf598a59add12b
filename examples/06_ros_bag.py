"""A ROS bag, imported by what its messages are, then smoothed.

    python examples/06_ros_bag.py [seconds]

The bag is simulated, axes as ROS has them. A bag of one's own needs no code: ``uwgraph import BAG DIVE``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import gsw
import numpy as np
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive
from uwgraph.graph import SmoothSettings, smooth
from uwgraph.simulate import SimulationSettings, simulate

ROS, TIME = get_typestore(Stores.ROS2_HUMBLE), "builtin_interfaces/msg/Time"
TYPES, NONE, COV = ROS.types, np.zeros(9), np.diag([4.0, 4.0, 9.0]).ravel()


def write_bag(dive: Dive, folder: Path) -> None:
    arrays = (dive.imu.f_s, dive.imu.w_s, dive.dvl.v_s, np.zeros((1, 3)))
    f, w, v, zero = ([TYPES["geometry_msgs/msg/Vector3"](x, -y, -z) for x, y, z in a.tolist()] for a in arrays)
    level = TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    fixed = TYPES["sensor_msgs/msg/NavSatStatus"](0, 1)
    places = np.degrees([dive.fixes.lat, dive.fixes.lon]).T
    pressure = 101_325.0 + 1e4 * gsw.p_from_z(-dive.depth.depth, 43.0)
    bodies = {
        "sensor_msgs/msg/Imu": (dive.imu, [(level, NONE, w_i, NONE, f_i, NONE) for f_i, w_i in zip(f, w, strict=True)]),
        "geometry_msgs/msg/TwistStamped": (dive.dvl, [(TYPES["geometry_msgs/msg/Twist"](v_i, *zero),) for v_i in v]),
        "sensor_msgs/msg/FluidPressure": (dive.depth, [(p, 0.0) for p in pressure]),
        "sensor_msgs/msg/NavSatFix": (dive.fixes, [(fixed, *place, 0.0, COV, 2) for place in places]),
    }
    with Writer(folder, version=9) as bag:
        for name, (stream, contents) in bodies.items():
            link = bag.add_connection(f"/rov/{name.split('/')[-1].lower()}", name, typestore=ROS)
            for t, content in zip(stream.t_ns.tolist(), contents, strict=True):
                header = TYPES["std_msgs/msg/Header"](TYPES[TIME](*divmod(t, 10**9)), "base_link")
                bag.write(link, t, ROS.serialize_cdr(TYPES[name](header, *content), name))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as work:
        truth = simulate(SimulationSettings(duration_s=float(sys.argv[1]) if len(sys.argv) > 1 else 300.0), seed=1)
        write_bag(truth, Path(work) / "bag")
        report = import_dive(Path(work) / "bag", Path(work) / "dive")
        print(*(f"{topic.topic} ({topic.type}) is {topic.stream}" for topic in report.taken), sep="\n")
        solution = smooth(
            read_dive(Path(work) / "dive"), SmoothSettings(heading_deg=np.degrees(truth.reference.rph[0, 2]))
        )
        print(f"{len(solution)} keyframes, {np.linalg.norm(np.diff(solution.p_n, axis=0), axis=1).sum():.0f} m")
