"""What the simulated sea floor is like, what lights it, and what is recorded of it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from uwgraph.dive.rig import AltitudeRig, NonNegative, Positive, Settings, Vector3

Rgb = tuple[NonNegative, NonNegative, NonNegative]


class Ground(Settings):
    """Shape and texture of the floor."""

    texture: Literal["natural", "tiles", "plain"] = "natural"
    """``tiles`` repeats one pattern, ``plain`` is bare fine sand: floors on which places cannot be told apart."""
    relief: NonNegative = 0.12
    """1-sigma of the gentle ups and downs, m; tiles are flat."""
    stones: Annotated[float, Field(ge=0, le=4)] = 1.0
    """Scale of the number of stones, pebbles and shells."""
    photo_width_m: Annotated[float, Field(ge=0.2, le=10)] = 2.4
    """What a photograph shows across."""
    tile_m: Annotated[float, Field(ge=0.1, le=2)] = 0.6
    """Period of ``tiles``."""


class Lamp(Settings):
    """A lamp on the vehicle; it shines along its direction with a beam cos^n."""

    place: Vector3
    """From the camera, in body axes, m."""
    towards: Vector3 = (0.0, 0.0, 1.0)
    """In body axes."""
    power: NonNegative = 9.0
    """Irradiance at 1 m on the axis in clear water."""
    beam: NonNegative = 3.0
    """Exponent n; 3 falls to a half at 37 degrees."""


class Murk(Settings):
    """The water's optics at red, green and blue, and the daylight."""

    attenuation: Rgb = (0.30, 0.15, 0.18)
    """Of a beam, 1/m."""
    scattering: Rgb = (0.0018, 0.0026, 0.0024)
    """Back to the camera, 1/m/sr."""
    turbidity: NonNegative = 1.0
    """Scale of both."""
    forward: Annotated[float, Field(ge=0, le=1)] = 0.25
    """Share of the light scattered forward into a halo, per unit of attenuation."""
    snow: NonNegative = 6.0
    """Particles of marine snow per cubic metre."""
    daylight: NonNegative = 20.0
    """Irradiance below the surface, in units of the lamps'; 0 for night."""
    diffuse_attenuation: Rgb = (0.42, 0.17, 0.22)
    """Of daylight with depth, 1/m."""


class EchoSounder(Settings):
    """What measures the altitude."""

    rig: AltitudeRig = AltitudeRig(translation_m=(0.3, 0.0, 0.15), sigma=0.02)
    rate_hz: Positive = 5.0
    range_m: Positive = 50.0


class FloorModel(Settings):
    """The floor, the light, the camera's recording."""

    ground: Ground = Ground()
    water: Murk = Murk()
    lamps: Annotated[tuple[Lamp, ...], Field(max_length=8)] = (
        Lamp(place=(0.25, -0.45, 0.0), towards=(-0.05, 0.12, 1.0)),
        Lamp(place=(0.25, 0.45, 0.0), towards=(-0.05, -0.12, 1.0)),
    )
    altitude: Positive = 3.0
    """m, of the deepest moment of the dive over the mean floor, where ``depth`` is not given."""
    depth: NonNegative | None = None
    """m, of the mean floor below the sea surface."""
    rate_hz: Positive = 1.0
    sight_m: Annotated[float, Field(gt=0.5, le=15)] = 8.0
    """No image is taken from higher up; rays that are longer fade."""
    stereo_baseline_m: NonNegative = 0.0
    """0: one camera; else a second one, to the right in the image, with the same stamps."""
    blur: NonNegative = 0.6
    """1-sigma of the lens's point spread, pixels."""
    full_well: Positive = 8_000.0
    """Electrons at the top of the range."""
    read_noise: NonNegative = 4.0
    """Electrons."""
    longest_exposure: Positive = 60.0
    """Of the automatic exposure, over that which a white surface at irradiance 1 needs."""
    white_balance: Annotated[float, Field(ge=0, le=1)] = 0.7
    """How far the camera evens out the water's colour; 0: not at all."""
    format: Literal["jpg", "png"] = "jpg"
    sounder: EchoSounder | None = EchoSounder()
