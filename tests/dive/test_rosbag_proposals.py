"""What ROS messages become: by type, by the looks of a DVL, with axes by the frame's name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uwgraph.dive import Dive
from uwgraph.dive.logs.log import Topic
from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.samples import Samples
from uwgraph.dive.logs.streams import BUILDERS
from uwgraph.dive.readers.ros_known import KNOWN_DEFINITIONS
from uwgraph.dive.readers.ros_messages import PRESETS, proposals
from uwgraph.dive.readers.ros_types import MessageType
from uwgraph.types import Origin

VELOCITY = ("velocity.x", "velocity.y", "velocity.z")


def mapping_of(type_name: str, frame: str = "", fields: tuple[str, ...] = (), name: str = "/t") -> dict[str, Any]:
    (proposal,) = proposals(Topic(name, type_name, fields=fields, frame=frame))
    return {"stream": proposal.stream, "note": proposal.note, **proposal.mapping.model_dump(mode="json")}


@pytest.mark.parametrize(
    ("frame", "axes"),
    [
        ("", "flu"),
        ("base_link", "flu"),
        ("imu_frd", "frd"),
        ("base_link_NED", "frd"),
        ("robot/frd", "frd"),
        ("aligned", "flu"),
        ("turned_link", "flu"),
    ],
)
def test_the_name_of_a_frame_tells_its_axes(frame: str, axes: str) -> None:
    mapping = mapping_of("sensor_msgs/msg/Imu", frame)
    assert mapping["axes"] == axes
    assert frame in mapping["note"]


@pytest.mark.parametrize(
    ("type_name", "fields", "axes", "uses"),
    [
        ("marine_acoustic_msgs/msg/Dvl", ("velocity_covar", "num_good_beams"), "frd", {"cov", "valid"}),
        ("ds_sensor_msgs/msg/Dvl", ("velocity_covar", "num_good_beams"), "frd", {"cov", "valid"}),
        ("waterlinked_a50_ros_driver/msg/DVL", ("fom", "velocity_valid"), "frd", {"sigma", "valid"}),
        ("dvl_msgs/msg/DVL", ("fom", "covariance", "velocity_valid"), "frd", {"sigma", "valid"}),
        ("cola2_msgs/msg/DVL", ("velocity_covariance",), "frd", {"cov", "valid"}),
        ("uuv_sensor_ros_plugins_msgs/msg/DVL", ("velocity_covariance",), "flu", {"cov", "valid"}),
        ("smarc_msgs/msg/DVL", ("velocity_covariance",), "flu", {"cov", "valid"}),
        ("somebodys_msgs/msg/Dvl", (), "flu", set()),
    ],
)
def test_dvls(type_name: str, fields: tuple[str, ...], axes: str, uses: set[str]) -> None:
    mapping = mapping_of(type_name, fields=(*VELOCITY, *fields))
    assert mapping["stream"] == "dvl"
    assert mapping["axes"] == axes
    assert {name for name in ("cov", "sigma", "valid") if mapping[name] is not None} == uses


@pytest.mark.parametrize(
    ("type_name", "flag", "says"),
    [
        ("uuv_sensor_ros_plugins_msgs/msg/DVL", "velocity_covariance", {-1.0: False, 0.0: True, 1e-4: True}),
        ("marine_acoustic_msgs/msg/Dvl", "num_good_beams", {0.0: False, 2.0: False, 3.0: True, 4.0: True}),
        ("waterlinked_a50_ros_driver/msg/DVL", "velocity_valid", {0.0: False, 1.0: True}),
    ],
)
def test_a_dvl_without_lock_says_so(type_name: str, flag: str, says: dict[float, bool]) -> None:
    (proposal,) = proposals(Topic("/t", type_name, fields=(*VELOCITY, flag)))
    values = {"v": np.ones((len(says), 3)), "valid": np.array(list(says))}
    stream = BUILDERS["dvl"](Samples(np.arange(len(says)), values), proposal.mapping, Dive(Origin(0.7, 0.1)), Notes())
    assert stream.valid.tolist() == list(says.values())


def test_what_is_only_named_like_a_dvl_is_left() -> None:
    assert proposals(Topic("/t", "my_msgs/msg/DVL", fields=("speed",))) == ()
    assert proposals(Topic("/t", "std_msgs/msg/Float64", fields=("data",))) == ()


@pytest.mark.parametrize(
    ("topic", "camera"),
    [
        ("/camera/image_raw", "camera"),
        ("/cam0/image_raw/compressed", "cam0"),
        ("/rov/front left/image_rect_color", "rov_front_left"),
        ("/image_raw", "camera"),
        ("frames", "frames"),
        ("/../../etc/image_raw", "etc"),
    ],
)
def test_names_of_cameras(topic: str, camera: str) -> None:
    assert mapping_of("sensor_msgs/msg/Image", name=topic)["stream"] == f"images/{camera}"


@pytest.mark.parametrize("type_name", [*PRESETS, *KNOWN_DEFINITIONS])
def test_presets_name_fields_that_the_messages_have(type_name: str) -> None:
    fields = MessageType(type_name, "cdr").fields
    assert "header.stamp" in fields
    found = proposals(Topic("/t", type_name, fields=fields))
    used = {q.path.partition("[")[0] for p in found for group in p.mapping.quantities().values() for q in group}
    assert used <= set(fields)


@pytest.mark.parametrize("type_name", [name for name in KNOWN_DEFINITIONS if name.lower().endswith("dvl")])
def test_a_dvl_that_has_an_altitude_gives_it(type_name: str) -> None:
    found = proposals(Topic("/dvl", type_name, fields=MessageType(type_name, "cdr").fields))
    assert [proposal.stream for proposal in found] == ["dvl", "altitude"]
