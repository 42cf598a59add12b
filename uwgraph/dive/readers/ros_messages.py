"""What the messages of ROS become in a dive: one row for each type, DVLs also by what they look like.

Axes are those of REP 103 and REP 105 (forward, left, up; east, north, up), except where a driver's documentation or the
``frame_id`` says otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from uwgraph.dive.logs.log import Proposal, Topic
from uwgraph.dive.logs.mapping import (
    AltitudeMapping,
    DepthMapping,
    DvlMapping,
    FixesMapping,
    HeadingMapping,
    ImagesMapping,
    ImuMapping,
    ReferenceMapping,
    TopicMapping,
)

Preset = Callable[[Topic], Proposal]

_DOWN: Final = re.compile(r"(?:^|[_/.\-])(?:ned|frd)(?:$|[_/.\-])", re.IGNORECASE)
"""A frame that names its axes as z down."""
_DIAGONAL_3: Final = (0, 1, 2, 4, 5, 8)
"""xx, xy, xz, yy, yz, zz in a matrix of 3 by 3, row by row."""
_DIAGONAL_6: Final = (0, 1, 2, 7, 8, 14)
_FRD_DRIVERS: Final = (
    "waterlinked",
    "dvl_msgs",
    "marine_acoustic_msgs",
    "ds_sensor_msgs",
    "cola2",
    "stonefish",
    "nortek",
)
"""Packages whose DVL has x forward, y to the right and z down, as the instruments have."""
MAX_NAME: Final = 64
"""Letters of a camera's name: it is a folder."""
_IMAGE_WORDS: Final = re.compile(r"^(?:image(?:_\w+)?|compressed|raw)$")


def proposals(topic: Topic) -> tuple[Proposal, ...]:
    """What a topic could become; nothing for a type that is not known or that lacks the fields."""
    if preset := PRESETS.get(topic.type):
        return (preset(topic),)
    if not _looks_like_a_dvl(topic):
        return ()
    return (_dvl(topic), _dvl_altitude(topic)) if "altitude" in topic.fields else (_dvl(topic),)


def is_known(type_name: str) -> bool:
    """Whether messages of a type may become something, by the type's name alone."""
    return type_name in PRESETS or _is_dvl(type_name)


def _axes(topic: Topic, usual: str) -> tuple[str, str]:
    """Axes of a sensor, and the words for it."""
    frame = f" (frame {topic.frame!r})" if topic.frame else ""
    if _DOWN.search(topic.frame):
        return "frd", f"axes taken as forward, right, down, as the frame's name says{frame}"
    words = "forward, left, up as usual in ROS" if usual == "flu" else "forward, right, down as its driver documents"
    return usual, f"axes taken as {words}{frame}"


def _vector(path: str) -> tuple[str, str, str]:
    return (f"{path}.x", f"{path}.y", f"{path}.z")


def _matrix(path: str, entries: Sequence[int]) -> tuple[str, ...]:
    return tuple(f"{path}[{entry}]" for entry in entries)


def _mapping(kind: type[TopicMapping], topic: Topic, **fields: Any) -> Any:
    return kind.model_validate({"topic": topic.name, **fields})


def _imu(topic: Topic) -> Proposal:
    axes, note = _axes(topic, "flu")
    fields = {"f": _vector("linear_acceleration"), "w": _vector("angular_velocity"), "axes": axes}
    return Proposal("imu", _mapping(ImuMapping, topic, **fields), note=note)


def _pressure(topic: Topic) -> Proposal:
    note = "pressure taken as absolute and in Pa, the air's as 101325 Pa"
    return Proposal("depth", _mapping(DepthMapping, topic, pressure="fluid_pressure [Pa]"), note=note)


def _nav_sat_fix(topic: Topic) -> Proposal:
    fields = {
        "lat": "latitude [deg]",
        "lon": "longitude [deg]",
        "cov": _matrix("position_covariance", _DIAGONAL_3),
        "valid": "status.status",
        "valid_above": -1.0,
    }
    note = "altitude left out: it counts from the ellipsoid, which may lie 50 m off the sea"
    return Proposal("fixes", _mapping(FixesMapping, topic, **fields), rank=1, note=note)


def _geo_point(topic: Topic) -> Proposal:
    fields = {"lat": "position.latitude [deg]", "lon": "position.longitude [deg]", "source": "geopoint"}
    return Proposal("fixes", _mapping(FixesMapping, topic, **fields), note="without a covariance")


def _magnetic_field(topic: Topic) -> Proposal:
    axes, note = _axes(topic, "flu")
    fields = {"magnetic_field": _vector("magnetic_field"), "axes": axes}
    return Proposal("heading", _mapping(HeadingMapping, topic, **fields), note=f"magnetic, not calibrated; {note}")


def _odometry(topic: Topic) -> Proposal:
    world, axes = ("ned", "frd") if _DOWN.search(topic.frame) else ("enu", "flu")
    fields = {
        "position": _vector("pose.pose.position"),
        "orientation": (*_vector("pose.pose.orientation"), "pose.pose.orientation.w"),
        "velocity": _vector("twist.twist.linear"),
        "velocity_in": "body",
        "world": world,
        "axes": axes,
    }
    note = f"its map (frame {topic.frame!r}) is taken to lie at the origin, with {world.upper()} axes"
    return Proposal("reference", _mapping(ReferenceMapping, topic, **fields), note=note)


def _twist(topic: Topic, *, path: str, covariance: str = "") -> Proposal:
    axes, note = _axes(topic, "flu")
    fields: dict[str, Any] = {"v": _vector(path), "axes": axes}
    if covariance:
        fields["cov"] = _matrix(covariance, _DIAGONAL_6)
    return Proposal("dvl", _mapping(DvlMapping, topic, **fields), note=f"taken as velocity over the bottom; {note}")


def _dvl(topic: Topic) -> Proposal:
    """Of any message named after a DVL that has a velocity: marine_acoustic_msgs, Water Linked, UUV simulator, ..."""
    axes, note = _axes(topic, "frd" if topic.type.startswith(_FRD_DRIVERS) else "flu")
    fields: dict[str, Any] = {"v": _vector("velocity"), "axes": axes}
    if covariance := _first(topic, "velocity_covariance", "velocity_covar"):
        fields["cov"] = _matrix(covariance, _DIAGONAL_3)
    elif sigma := _first(topic, "fom", "figure_of_merit", "figureOfMerit"):
        fields["sigma"] = sigma
    if valid := _first(topic, "velocity_valid", "valid"):
        fields["valid"] = valid
    elif beams := _first(topic, "num_good_beams"):
        fields |= {"valid": beams, "valid_above": 2.0}  # two beams give no velocity in space
    elif covariance:
        fields |= {"valid": f"{covariance}[0]", "valid_above": -0.5}  # -1 without bottom lock, 0 where unknown
    return Proposal("dvl", _mapping(DvlMapping, topic, **fields), rank=1, note=note)


def _dvl_altitude(topic: Topic) -> Proposal:
    fields = {"valid": valid} if (valid := _first(topic, "velocity_valid", "valid")) else {}
    return Proposal("altitude", _mapping(AltitudeMapping, topic, altitude="altitude [m]", **fields), rank=1)


def _range(topic: Topic) -> Proposal:
    note = "taken as the distance to the bottom, straight down"
    return Proposal("altitude", _mapping(AltitudeMapping, topic, altitude="range [m]"), note=note)


def _images(topic: Topic, *, rank: int) -> Proposal:
    words = [word for word in topic.name.split("/") if word and not _IMAGE_WORDS.match(word)]
    camera = re.sub(r"[^\w.-]+", "_", "_".join(words)).strip("_.-")[:MAX_NAME] or "camera"
    return Proposal(f"images/{camera}", _mapping(ImagesMapping, topic), rank=rank)


def _first(topic: Topic, *paths: str) -> str:
    return next((path for path in paths if path in topic.fields), "")


def _is_dvl(type_name: str) -> bool:
    return type_name.rpartition("/")[2].lower() == "dvl"


def _looks_like_a_dvl(topic: Topic) -> bool:
    return _is_dvl(topic.type) and set(_vector("velocity")) <= set(topic.fields)


PRESETS: Final[Mapping[str, Preset]] = {
    "sensor_msgs/msg/Imu": _imu,
    "sensor_msgs/msg/FluidPressure": _pressure,
    "sensor_msgs/msg/Range": _range,
    "sensor_msgs/msg/NavSatFix": _nav_sat_fix,
    "sensor_msgs/msg/MagneticField": _magnetic_field,
    "sensor_msgs/msg/Image": partial(_images, rank=1),
    "sensor_msgs/msg/CompressedImage": partial(_images, rank=0),
    "geographic_msgs/msg/GeoPointStamped": _geo_point,
    "geometry_msgs/msg/TwistStamped": partial(_twist, path="twist.linear"),
    "geometry_msgs/msg/TwistWithCovarianceStamped": partial(
        _twist, path="twist.twist.linear", covariance="twist.covariance"
    ),
    "nav_msgs/msg/Odometry": _odometry,
}
"""By type, as ROS 2 writes it."""
