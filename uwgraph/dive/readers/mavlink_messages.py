"""What the messages of ArduPilot become: one table for MAVLink, one for its own DataFlash logs.

Both log specific force and rates in FRD axes of the autopilot. What ArduPilot computes itself (attitude, position) is
proposed as a heading, thinned, and as a reference; never as an independent measurement.
Sources: MAVLink's common and ardupilotmega dialects; ArduPilot's list of onboard log messages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees
from typing import Any, Final

from pydantic import ValidationError

from uwgraph.dive.logs.log import Proposal, Topic
from uwgraph.dive.logs.mapping import (
    AltitudeMapping,
    DepthMapping,
    DvlMapping,
    FixesMapping,
    HeadingMapping,
    ImuMapping,
    ReferenceMapping,
    StreamMapping,
)
from uwgraph.dive.rig import DvlRig, FixesRig, HeadingRig, ImuRig, Rig

AUTOPILOT_IMU: Final = ImuRig(
    gyro_noise_density=2e-4,
    accel_noise_density=3e-3,
    gyro_bias_walk=5e-6,
    accel_bias_walk=1e-4,
    gyro_bias_sigma=1e-2,
    accel_bias_sigma=0.2,
    gyro_range=34.9,
    accel_range=156.9,
)
"""The MEMS IMU of an autopilot among thrusters: twice its data sheet's noise; biases as they are after power-up."""

LARGEST_TRIM_DEG: Final = 15.0
"""ArduPilot allows 10; more is a damaged log."""

WATER, AIR, MAGNETIC, PLACED = "in water", "in air, not in water", "magnetic", "placed"
"""What a log says of a barometer, of a heading's north, and of a filter that knew where it was."""


def autopilot_rig(parameters: Mapping[str, float]) -> Rig:
    """The rig of an ArduSub vehicle: grades of its sensors, and the trim of its autopilot's mounting."""
    trim = [degrees(parameters.get(f"AHRS_TRIM_{axis}", 0.0)) for axis in "XY"]
    rotation = (*trim, 0.0) if all(abs(angle) < LARGEST_TRIM_DEG for angle in trim) else (0.0, 0.0, 0.0)
    return Rig(
        imu=AUTOPILOT_IMU.model_copy(update={"rotation_deg": rotation}),
        dvl=DvlRig(sigma=0.03, scale_sigma=0.005, misalignment_sigma_deg=1.0),
        fixes=FixesRig(sigma=5.0),
        heading=HeadingRig(sigma_deg=5.0),
    )


def north_of(parameters: Mapping[str, float]) -> str:
    """``magnetic`` where the autopilot was told no declination, else nothing."""
    return MAGNETIC if parameters.get("COMPASS_DEC") == 0.0 else ""


@dataclass(frozen=True)
class Preset:
    """A stream that a message can become."""

    stream: str
    mapping: Mapping[str, Any]
    """The stream's mapping but for its topic; fields have their unit in brackets."""
    rank: int = 0
    note: str = ""
    says: str | None = None
    """Only where the log says this of the topic; None: whatever it says."""


_MODELS: Final[Mapping[str, type[StreamMapping]]] = {
    "imu": ImuMapping,
    "dvl": DvlMapping,
    "depth": DepthMapping,
    "altitude": AltitudeMapping,
    "fixes": FixesMapping,
    "heading": HeadingMapping,
    "reference": ReferenceMapping,
}

_FILTERED = "the autopilot's filter of gyro and compass: not independent of the IMU, hence one sample in 5 s"
_OWN_SOLUTION = "the autopilot's own solution, no truth"
_HOUSING = "if this barometer sits inside the housing there is no depth in this log"
_BELOW = "the rangefinder is taken to look down"
_DELTAS = "mean velocity over the time between two messages, as the DVL's driver sends it to the autopilot"
_DEPTH = {"surface_pressure_pa": "least"}
_HEADING = {"max_rate_hz": 0.2, "sigma": "5 [deg]"}
"""A compass among thrusters is wrong by degrees, and for minutes."""


def _imu(force: str, rate: str, unit_f: str, unit_w: str) -> dict[str, Any]:
    """The mapping of fields named with ``*`` for the axis."""
    return {"f": _axes(force, unit_f), "w": _axes(rate, unit_w), "axes": "frd"}


def _axes(name: str, unit: str, axes: str = "xyz") -> list[str]:
    return [f"{name.replace('*', axis)} [{unit}]" for axis in axes]


def _scaled_imu(rank: int) -> tuple[Preset, ...]:
    return (Preset("imu", _imu("*acc", "*gyro", "mg", "mrad/s"), rank),)


def _scaled_pressure(rank: int, note: str = "") -> tuple[Preset, ...]:
    return (Preset("depth", _DEPTH | {"pressure": "press_abs [hPa]"}, rank, note),)


def _gps(rank: int, sigma: str) -> tuple[Preset, ...]:
    place = {"lat": "lat [degE7]", "lon": "lon [degE7]", "valid": "fix_type [1]", "valid_above": 2}
    return (Preset("fixes", place | {"sigma": sigma}, rank),)


def _yaw(field: str) -> tuple[Preset, ...]:
    heading = _HEADING | {"heading": field}
    return (
        Preset("heading", heading | {"reference": "true"}, 1, _FILTERED, says=""),
        Preset("heading", heading | {"reference": "magnetic"}, 1, _FILTERED, says=MAGNETIC),
    )


MAVLINK: Final[Mapping[str, tuple[Preset, ...]]] = {
    "HIGHRES_IMU": (Preset("imu", _imu("*acc", "*gyro", "m/s^2", "rad/s"), 3),),
    "RAW_IMU": _scaled_imu(2),
    "SCALED_IMU": _scaled_imu(2),
    "SCALED_IMU2": _scaled_imu(1),
    "SCALED_IMU3": _scaled_imu(0),
    "SCALED_PRESSURE2": _scaled_pressure(2, "the second barometer, which on ArduSub is the one in the water"),
    "SCALED_PRESSURE": _scaled_pressure(1, _HOUSING),
    "VFR_HUD": (Preset("depth", {"height": "alt [m]"}, -1, "the autopilot's altitude: no pressure in this log"),),
    "VISION_POSITION_DELTA": (
        Preset("dvl", {"v": [f"velocity[{k}] [m/s]" for k in range(3)], "valid": "confidence [1]"}, 1, _DELTAS),
    ),
    "RANGEFINDER": (Preset("altitude", {"altitude": "distance [m]"}, 1, _BELOW),),
    "DISTANCE_SENSOR": (Preset("altitude", {"altitude": "current_distance [cm]"}, 0, _BELOW),),
    "GPS_RAW_INT": _gps(2, "h_acc [mm]"),
    "GPS2_RAW": _gps(1, "h_acc [mm]"),
    "GPS_INPUT": _gps(0, "horiz_accuracy [m]"),
    "ATTITUDE": (
        *_yaw("yaw [rad]"),
        Preset("reference", {"rph": ["roll [rad]", "pitch [rad]", "yaw [rad]"]}, 0, _OWN_SOLUTION),
    ),
    "GLOBAL_POSITION_INT": (
        Preset(
            "reference",
            {
                "lat": "lat [degE7]",
                "lon": "lon [degE7]",
                "height": "relative_alt [mm]",
                "velocity": _axes("v*", "cm/s"),
                "world": "ned",
            },
            1,
            _OWN_SOLUTION,
        ),
    ),
}
"""By message name."""


def _onboard_imu(rank: int) -> tuple[Preset, ...]:
    return (
        Preset(
            "imu",
            {"f": _axes("Acc*", "m/s^2", "XYZ"), "w": _axes("Gyr*", "rad/s", "XYZ"), "axes": "frd"},
            rank,
        ),
    )


def _onboard_pressure(rank: int) -> tuple[Preset, ...]:
    depth = _DEPTH | {"pressure": "Press [Pa]"}
    return (
        Preset("depth", depth, rank + 10, "its altitude follows its pressure as in water", says=WATER),
        Preset("depth", depth, rank, _HOUSING, says=""),
    )


def _onboard_gps(rank: int) -> tuple[Preset, ...]:
    place = {"lat": "Lat [deg]", "lon": "Lng [deg]", "valid": "Status [1]", "valid_above": 2}
    return (Preset("fixes", place, rank),)


_ONBOARD_RPH: Final = {"rph": ["Roll [deg]", "Pitch [deg]", "Yaw [deg]"]}
_ONBOARD_FILTER: Final = (
    Preset("reference", _ONBOARD_RPH, 1, f"{_OWN_SOLUTION}; it knew no position", says=""),
    Preset(
        "reference",
        _ONBOARD_RPH
        | {"position": ["PN [m]", "PE [m]", "PD [m]"], "velocity": ["VN [m/s]", "VE [m/s]", "VD [m/s]"]}
        | {"world": "ned"},
        1,
        _OWN_SOLUTION,
        says=PLACED,
    ),
)

DATAFLASH: Final[Mapping[str, tuple[Preset, ...]]] = {
    "IMU": _onboard_imu(2),
    "IMU2": _onboard_imu(1),
    "IMU3": _onboard_imu(0),
    "BARO": _onboard_pressure(1),
    "BAR2": _onboard_pressure(2),
    "CTUN": (Preset("depth", {"height": "Alt [m]"}, -1, "the autopilot's altitude: no pressure in this log"),),
    "VISO": (Preset("dvl", {"v": _axes("Vel*", "m/s", "XYZ"), "valid": "conf [1]"}, 1, _DELTAS),),
    "RFND": (Preset("altitude", {"altitude": "Dist [m]", "valid": "Stat [1]", "valid_above": 3.0}, 1, _BELOW),),
    "GPS": _onboard_gps(2),
    "GPS2": _onboard_gps(1),
    "ATT": _yaw("Yaw [deg]"),
    "XKF1": _ONBOARD_FILTER,
    "NKF1": _ONBOARD_FILTER,
}
"""By message name."""

_UNITS: Final[Mapping[str, str]] = {
    "rad/s": "rad/s", "deg/s": "deg/s", "m/s/s": "m/s^2", "Pa": "Pa", "deg": "deg", "degheading": "deg",
    "deglatitude": "deg", "deglongitude": "deg", "rad": "rad", "m": "m", "cm": "cm", "mm": "mm", "m/s": "m/s",
    "cm/s": "cm/s",
}  # fmt: skip
"""ArduPilot's names of units that its logs state, and ours."""


def proposals_from(table: Mapping[str, tuple[Preset, ...]], topic: Topic) -> tuple[Proposal, ...]:
    """What a topic could become with the fields that it has, in the units that the log states for them."""
    found = []
    for preset in table.get(topic.type, ()):
        if preset.says is None or preset.says == topic.says:
            mapping = _mapping(preset, topic)
            if mapping is not None:
                found.append(Proposal(preset.stream, mapping, preset.rank, preset.note))
    return tuple(found)


def _mapping(preset: Preset, topic: Topic) -> StreamMapping | None:
    """The mapping without fields that messages of this version lack; None where it cannot do without."""
    usual = {key: value for key, value in preset.mapping.items() if _paths(value) <= set(topic.fields)}
    stated = {key: _in_units_of(topic, value) for key, value in usual.items()}
    for fields in (stated, usual):  # a damaged log states units of another dimension
        try:
            return _MODELS[preset.stream].model_validate({**fields, "topic": topic.name})
        except ValidationError:
            continue
    return None


def _paths(value: Any) -> set[str]:
    """Fields that a preset's value names; settings name none."""
    if isinstance(value, list):
        return set().union(*map(_paths, value))
    path = value.partition(" [")[0] if isinstance(value, str) and " [" in value else ""
    return {path} if path and not path.isdecimal() else set()


def _in_units_of(topic: Topic, value: Any) -> Any:
    """A field's text, or a list of them, with the unit that the log states for it."""
    if isinstance(value, list):
        return [_in_units_of(topic, one) for one in value]
    unit = (
        _UNITS.get(topic.units.get(value.partition(" [")[0], "")) if isinstance(value, str) and " [" in value else None
    )
    return f"{value.partition(' [')[0]} [{unit}]" if unit else value
