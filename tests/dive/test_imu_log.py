"""The IMU of a recording from a bench: no position, gaps, other topics beside it."""

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from uwgraph.dive.folder import write_dive
from uwgraph.dive.imu_log import read_imu
from uwgraph.dive.imu_noise import imu_noise
from uwgraph.dive.logs.mapping import LogMapping
from uwgraph.dive.logs.window import Window
from uwgraph.dive.model import Dive
from uwgraph.dive.rig import ImuRig, Rig
from uwgraph.dive.yamlfile import parse_settings
from uwgraph.errors import DataError
from uwgraph.types import Imu, Origin

START_NS, RATE_HZ, SECONDS = 1_700_000_000_000_000_000, 50.0, 60
DENSITY = 3e-4


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A ROS 2 bag of two IMUs at rest, three seconds of it lost, and nothing else."""
    path = tmp_path_factory.mktemp("bags") / "bench"
    store, rng = get_typestore(Stores.ROS2_JAZZY), np.random.default_rng(3)
    types = store.types
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {
            name: writer.add_connection(name, "sensor_msgs/msg/Imu", typestore=store) for name in ("/imu", "/other")
        }
        for k in range(int(SECONDS * RATE_HZ)):
            t_ns = START_NS + round(k * 1e9 / RATE_HZ) + (3_000_000_000 if k > 500 else 0)
            header = types["std_msgs/msg/Header"](
                types["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9), "base_link"
            )
            for scale, (_, connection) in enumerate(topics.items(), start=1):
                w, f = (scale * s * np.sqrt(RATE_HZ) * rng.standard_normal(3) for s in (DENSITY, 1e-3))
                vector = types["geometry_msgs/msg/Vector3"]
                message = types["sensor_msgs/msg/Imu"](
                    header=header,
                    orientation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
                    orientation_covariance=np.full(9, -1.0),
                    angular_velocity=vector(*w),
                    angular_velocity_covariance=np.zeros(9),
                    linear_acceleration=vector(f[0], f[1], 9.81 + f[2]),
                    linear_acceleration_covariance=np.zeros(9),
                )
                writer.write(connection, t_ns, store.serialize_cdr(message, "sensor_msgs/msg/Imu"))
    return path


def mapping(topic):
    of = {
        "f": [f"linear_acceleration.{a} [m/s^2]" for a in "xyz"],
        "w": [f"angular_velocity.{a} [rad/s]" for a in "xyz"],
    }
    return parse_settings(LogMapping, {"streams": {"imu": {"topic": topic, "axes": "flu", **of}}}, "mapping")


@pytest.mark.parametrize(("topic", "scale"), [("/imu", 1.0), ("/other", 2.0)])
def test_a_bench_has_no_position(bag, topic, scale):
    imu, rig = read_imu(bag, mapping(topic), Window(first=13.5))
    assert imu.f_s[:, 2].mean() == pytest.approx(-9.81, abs=0.01)
    found = imu_noise(imu)
    assert found.duration_s == pytest.approx(49.0, abs=2.0)
    density = found.fields["gyro_noise_density"]
    assert density.value == pytest.approx(scale * DENSITY, rel=0.1)
    assert found.rig(rig.imu).gyro_bias_walk == rig.imu.gyro_bias_walk


def test_a_topic_is_guessed(bag):
    assert len(read_imu(bag, window=Window(last=10.0))[0]) == pytest.approx(500, abs=2)


def test_a_log_with_a_gap_says_which_part_to_take(bag):
    with pytest.raises(DataError, match="--from 2023-11-14T22:13:33"):
        read_imu(bag)


def test_a_dive_with_a_gap(tmp_path):
    rng = np.random.default_rng(0)
    t_ns = START_NS + np.arange(4000) * 10_000_000 + np.where(np.arange(4000) > 2000, 5_000_000_000, 0)
    imu = Imu(t_ns, f_s=rng.standard_normal((4000, 3)) - np.array([0, 0, 9.8]), w_s=rng.standard_normal((4000, 3)))
    write_dive(Dive(Origin(0.5, 0.6), Rig(imu=ImuRig(gyro_range=3.0)), imu=imu), tmp_path / "dive")
    found, rig = read_imu(tmp_path / "dive")
    assert np.array_equal(found.t_ns, t_ns)
    part, _ = read_imu(tmp_path / "dive", window=Window(int(t_ns[100]), 5.0))
    assert np.array_equal(part.t_ns, t_ns[100:501])
    with pytest.raises(DataError, match="holds nothing"):
        read_imu(tmp_path / "dive", window=Window(1e6))
    assert rig.imu.gyro_range == 3.0


def test_a_dive_without_an_imu(tmp_path):
    write_dive(Dive(Origin(0.5, 0.6)), tmp_path / "dive")
    with pytest.raises(DataError, match="has no IMU"):
        read_imu(tmp_path / "dive")
    with pytest.raises(DataError, match="no such file"):
        read_imu(tmp_path / "nothing")
