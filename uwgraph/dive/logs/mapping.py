"""The mapping file: which topic of a log becomes which stream, and what its numbers mean.

``uwgraph import`` writes it with what it guessed; people edit it and give it back with ``--mapping``. A field is named
with its unit, ``-acc_y [mg]`` (:mod:`uwgraph.dive.logs.quantity`); without one it is SI.

    origin: {lat_deg: 43.1, lon_deg: 5.9}
    streams:
      imu: {topic: /imu/data, axes: flu, f: [linear_acceleration.x, ...], w: [angular_velocity.x, ...]}
      depth: {topic: /pressure, pressure: 'fluid_pressure [Pa]', surface_pressure_pa: 101325}
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from itertools import takewhile
from typing import Annotated, Any, Final, Literal, TypeAlias

from pydantic import BeforeValidator, model_validator
from pydantic import Field as Setting

from uwgraph.dive.folder import OriginSettings
from uwgraph.dive.logs.quantity import (
    Acceleration,
    Angle,
    Field,
    Length,
    LengthVariance,
    Number,
    Pressure,
    Quantity,
    Rate,
    Seconds,
    Speed,
    SpeedVariance,
)
from uwgraph.dive.rig import Positive, Rig, Settings

Axes = Literal["frd", "flu", "rfu", "luf", "rdf"]
"""Sensor or vehicle axes by name: forward/left/right/up/down for x, y, z (ROS: flu; cameras: rdf)."""
World = Literal["ned", "enu", "nwu"]
"""Axes of a local map."""
North = Annotated[Literal["true", "magnetic"], BeforeValidator(lambda value: "true" if value is True else value)]
"""A plain ``true`` in YAML is meant as the word."""
Six: TypeAlias = tuple[SpeedVariance, SpeedVariance, SpeedVariance, SpeedVariance, SpeedVariance, SpeedVariance]
Vector: TypeAlias = tuple[Length, Length, Length]
Camera = Annotated[str, Setting(pattern=r"^[A-Za-z0-9][\w.-]*$")]
Quaternion: TypeAlias = tuple[Number, Number, Number, Number]


class TopicMapping(Settings):
    """What every stream needs: its topic and its time."""

    topic: str
    """The topic, or for tables the file's name."""
    time: Literal["auto", "header", "log"] | Seconds = "auto"
    """``header``: the stamp inside the message; ``log``: when it was logged; a field: seconds from ``epoch``; ``auto``:
    the header's where it is plausible, else the log's."""
    epoch: datetime | None = None
    """What a field of time counts from, with a time zone; without it from 1970-01-01 UTC."""
    max_rate_hz: Positive | None = None
    """Thin the stream to at most this rate, for sources whose samples are not independent."""

    @model_validator(mode="after")
    def _zoned(self) -> TopicMapping:
        if self.epoch is not None and self.epoch.tzinfo is None:
            raise ValueError("epoch has no time zone: write it in UTC, as in 2022-06-08T09:00:00Z")
        return self

    def quantities(self) -> Mapping[str, tuple[Quantity, ...]]:
        """The quantities of every field that is set, ``time`` included."""
        found: dict[str, tuple[Quantity, ...]] = {}
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, Quantity):
                found[name] = (value,)
            elif isinstance(value, tuple):
                found[name] = value
        return found

    def relevant(self) -> dict[str, Any]:
        """What matters of it: the fields that are set and the settings that act on them, defaults included."""
        values = {name: value for name, value in self if value is not None}
        for setting, fields in _ACTS_ON.items():
            idle = not any(field in values for field in fields)
            if setting in values and idle and values[setting] == type(self).model_fields[setting].default:
                del values[setting]
        return values

    def in_words(self) -> str:
        """What is taken for what, on one line."""
        words = []
        for name, value in self.relevant().items():
            if name == "topic" or (name not in _ACTS_ON and value == type(self).model_fields[name].default):
                continue
            words.append(f"{name} {_together_in_words(value) if isinstance(value, tuple) else value}")
        return "; ".join(words)


_ACTS_ON: Final[Mapping[str, tuple[str, ...]]] = {
    "axes": ("f", "v", "orientation", "magnetic_field", "velocity"),
    "world": ("position", "cov", "orientation", "heading"),
    "velocity_in": ("velocity",),
    "reference": ("heading", "orientation", "magnetic_field"),
    "surface_pressure_pa": ("pressure",),
    "valid_above": ("valid",),
}
"""Conventions that are worth a look even where they are the defaults, and the fields that they are of."""


class ImuMapping(TopicMapping):
    """Specific force and angular rate."""

    f: tuple[Acceleration, Acceleration, Acceleration]
    w: tuple[Rate, Rate, Rate]
    axes: Axes = "frd"
    sampling: Literal["instantaneous", "mean"] = "instantaneous"
    """Whether a sample is the value at its stamp, or the mean over the interval before it."""


class DvlMapping(TopicMapping):
    """Velocity over the bottom in the instrument's axes."""

    v: tuple[Speed, Speed, Speed]
    sigma: Speed | None = None
    """One 1-sigma for all axes (a figure of merit) ..."""
    cov: Six | None = None
    """... or xx, xy, xz, yy, yz, zz."""
    valid: Number | None = None
    """Bottom lock: valid where it is not zero (nor NaN) ..."""
    valid_above: float | None = None
    """... or where it is greater than this: beams, or a variance that is -1 where there is no lock."""
    axes: Axes = "frd"


class DepthMapping(TopicMapping):
    """Exactly one of depth, height and pressure."""

    depth: Length | None = None
    height: Length | None = None
    """Above the surface: minus the depth."""
    pressure: Pressure | None = None
    """Absolute, unless ``surface_pressure_pa`` is 0."""
    surface_pressure_pa: Annotated[float, Setting(ge=0, le=2e5)] | Literal["first", "least"] = 101_325.0
    """The air's pressure: stated, or that of the first samples, or the least of the dive."""
    sigma: Length | None = None

    @model_validator(mode="after")
    def _one(self) -> DepthMapping:
        _exactly_one(self, "depth", "height", "pressure")
        return self


class AltitudeMapping(TopicMapping):
    """Distance to the bottom from an echo sounder or a DVL; what is not positive is none."""

    altitude: Length
    sigma: Length | None = None
    valid: Number | None = None
    """A distance where it is greater than ``valid_above``."""
    valid_above: float = 0.0


class FixesMapping(TopicMapping):
    """Latitude and longitude, or a place on a local map about the origin."""

    lat: Angle | None = None
    lon: Angle | None = None
    height: Length | None = None
    position: Vector | None = None
    world: World = "enu"
    """Axes of ``position`` and of ``cov``."""
    sigma: Length | None = None
    cov: tuple[LengthVariance, ...] | None = Setting(default=None, min_length=6, max_length=6)
    """xx, xy, xz, yy, yz, zz in the axes of ``world``."""
    valid: Number | None = None
    """A fix where it is greater than ``valid_above``."""
    valid_above: float = 0.0
    source: Annotated[str, Setting(pattern=r"^[\w.-]{1,32}$")] = "gnss"

    @model_validator(mode="after")
    def _one(self) -> FixesMapping:
        _exactly_one(self, "lat", "position")
        _together(self, "lat", "lon")
        return self


class HeadingMapping(TopicMapping):
    """Exactly one of a heading, an orientation, and a magnetic field."""

    heading: Angle | None = None
    """Clockwise from north; for one that counts from east anticlockwise set ``world: enu``."""
    orientation: Quaternion | None = None
    """x, y, z, w of the vehicle against ``world``."""
    magnetic_field: tuple[Field, Field, Field] | None = None
    """Levelled by the IMU's vertical; needs an imu stream."""
    axes: Axes = "frd"
    """Of the vehicle, for ``orientation``; of the magnetometer, for ``magnetic_field``."""
    world: World = "ned"
    reference: North = "magnetic"
    sigma: Angle | None = None

    @model_validator(mode="after")
    def _one(self) -> HeadingMapping:
        _exactly_one(self, "heading", "orientation", "magnetic_field")
        return self


class ReferenceMapping(TopicMapping):
    """Somebody else's solution, as far as it goes."""

    lat: Angle | None = None
    lon: Angle | None = None
    height: Length | None = None
    position: Vector | None = None
    """On a local map about the origin, in the axes of ``world``."""
    world: World = "enu"
    rph: tuple[Angle, Angle, Angle] | None = None
    """Roll, pitch, heading of FRD against NED."""
    orientation: Quaternion | None = None
    """x, y, z, w of ``axes`` against ``world``."""
    axes: Axes = "flu"
    velocity: tuple[Speed, Speed, Speed] | None = None
    velocity_in: Literal["world", "body"] = "world"

    @model_validator(mode="after")
    def _some(self) -> ReferenceMapping:
        _together(self, "lat", "lon")
        if all(getattr(self, name) is None for name in ("lat", "position", "rph", "orientation", "velocity")):
            raise ValueError("give a position, an attitude or a velocity")
        return self


class GravityMapping(TopicMapping):
    """Exactly one of gravity and free-air anomaly."""

    gravity: Acceleration | None = None
    anomaly: Acceleration | None = None
    sigma: Acceleration

    @model_validator(mode="after")
    def _one(self) -> GravityMapping:
        _exactly_one(self, "gravity", "anomaly")
        return self


class ImagesMapping(TopicMapping):
    """Images, raw or compressed; the camera's name is the key."""


StreamMapping: TypeAlias = (
    ImuMapping
    | DvlMapping
    | DepthMapping
    | AltitudeMapping
    | FixesMapping
    | HeadingMapping
    | ReferenceMapping
    | GravityMapping
    | ImagesMapping
)


class Streams(Settings):
    """A mapping for each stream that the log has."""

    imu: ImuMapping | None = None
    dvl: DvlMapping | None = None
    depth: DepthMapping | None = None
    altitude: AltitudeMapping | None = None
    fixes: FixesMapping | None = None
    heading: HeadingMapping | None = None
    gravity: GravityMapping | None = None
    reference: ReferenceMapping | None = None


class LogMapping(Settings):
    """The whole file."""

    origin: OriginSettings | None = None
    """Without it: the first fix, or the reference's first position."""
    streams: Streams = Streams()
    images: Annotated[dict[Camera, ImagesMapping], Setting(default_factory=dict)]
    rig: Rig = Rig()
    left: Annotated[dict[str, Any], Setting(default_factory=dict)]
    """What is not taken, for people: ignored."""

    def by_stream(self) -> dict[str, StreamMapping]:
        """The mappings of all streams that are set, images as ``images/CAMERA``."""
        named = {name: getattr(self.streams, name) for name in Streams.model_fields}
        images = {f"images/{camera}": mapping for camera, mapping in self.images.items()}
        return {name: mapping for name, mapping in {**named, **images}.items() if mapping is not None}


def _exactly_one(mapping: TopicMapping, *names: str) -> None:
    given = [name for name in names if getattr(mapping, name) is not None]
    if len(given) != 1:
        raise ValueError(f"give exactly one of {', '.join(names)}; found {', '.join(given) or 'none'}")


def _together_in_words(quantities: tuple[Quantity, ...]) -> str:
    """``linear_acceleration.{x, y, z} [m/s^2]``: what they share is said once."""
    texts = list(map(str, quantities))
    head = "".join(letters[0] for letters in takewhile(lambda same: len(set(same)) == 1, zip(*texts, strict=False)))
    if len({q.unit for q in quantities}) > 1 or len(head) < 3 or "[" in head:
        return ", ".join(texts)
    unit = f" [{quantities[0].unit}]"
    return f"{head}{{{', '.join(text[len(head) :].removesuffix(unit) for text in texts)}}}{unit}"


def _together(mapping: TopicMapping, *names: str) -> None:
    if len({getattr(mapping, name) is None for name in names}) > 1:
        raise ValueError(f"give {' and '.join(names)} together")
