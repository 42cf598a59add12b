"""Definitions of messages that logs of ROS 2 before Iron name and do not contain, for types outside its own packages.

Fields as in marine_acoustic_msgs 2.1, geographic_info 1.0 and dvl_msgs (Water Linked A50 and A125).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

_SEPARATOR: Final = "=" * 80 + "\n"

_VECTOR3: Final = f"{_SEPARATOR}MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_HEADER: Final = f"{_SEPARATOR}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_GEO_POINT: Final = (
    f"{_SEPARATOR}MSG: geographic_msgs/GeoPoint\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n"
)

_MARINE_DVL: Final = """std_msgs/Header header
uint8 velocity_mode
uint8 dvl_type
geometry_msgs/Vector3 velocity
float64[9] velocity_covar
float64 altitude
float64 course_gnd
float64 speed_gnd
uint8 num_good_beams
float32 sound_speed
bool beam_ranges_valid
bool beam_velocities_valid
geometry_msgs/Vector3[4] beam_unit_vec
float64[4] range
float32[4] range_covar
float32[4] beam_quality
float32[4] beam_velocity
float32[4] beam_velocity_covar
"""

_WATER_LINKED_DVL: Final = """std_msgs/Header header
float64 time
geometry_msgs/Vector3 velocity
float64 fom
float64[] covariance
float64 altitude
DVLBeam[] beams
bool velocity_valid
int64 status
int64 time_of_validity
int64 time_of_transmission
string form
"""

_WATER_LINKED_BEAM: Final = f"""{_SEPARATOR}MSG: dvl_msgs/DVLBeam
int64 id
float64 velocity
float64 distance
float64 rssi
float64 nsd
bool valid
"""

KNOWN_DEFINITIONS: Final[Mapping[str, str]] = {
    "marine_acoustic_msgs/msg/Dvl": _MARINE_DVL + _HEADER + _VECTOR3,
    "dvl_msgs/msg/DVL": _WATER_LINKED_DVL + _WATER_LINKED_BEAM + _HEADER + _VECTOR3,
    "geographic_msgs/msg/GeoPointStamped": (
        "std_msgs/Header header\ngeographic_msgs/GeoPoint position\n" + _GEO_POINT + _HEADER
    ),
}
"""By type."""
