"""Images of the underwater sky along a dive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.file import CameraFile, write_camera
from uwgraph.camera.model import Camera
from uwgraph.camera.sensor import Sensor
from uwgraph.dive import Dive
from uwgraph.dive.folder import CAMERA_FILE
from uwgraph.dive.rig import NonNegative, Positive, Settings
from uwgraph.errors import ConfigError, DataError
from uwgraph.frames import R_n_local, geodetic_from_ned
from uwgraph.simulate.exposure import auto_scale, expose, mosaic
from uwgraph.simulate.noise import Noise
from uwgraph.simulate.render import Shot, render
from uwgraph.simulate.replay import ReferenceMotion
from uwgraph.simulate.scene import Scene
from uwgraph.sun.ephemeris import sun_axes, sun_azimuth_elevation
from uwgraph.time import from_seconds, isoformat
from uwgraph.types import FloatArray, Images

SKY_CAMERA: Final = Camera("fisheye", f=(165.0, 165.0), c=(191.5, 191.5), size=(384, 384))
"""Looks up and sees 66 degrees around, the window at tilts of up to 15 degrees."""
_SHALLOWEST_M: Final = 0.1
_LOWEST_SUN_DEG: Final = 5.0


class ImageModel(Settings):
    """What the camera records, and how often."""

    kind: Literal["gradient", "polarization"] = "gradient"
    """Intensity, or the raw mosaic of a division-of-focal-plane sensor (Sony's layout)."""
    rate_hz: Positive = 0.1
    depth: NonNegative | None = None
    """Metres below the surface throughout; None: that of the dive, and no image while surfaced."""
    bits: Literal[8, 12, 16] = 12
    full_well: Positive = 10_000.0
    """Electrons at the top of the range."""
    read_noise: NonNegative = 3.0
    """Electrons."""
    longest_exposure: Positive = 1000.0
    """Of the automatic exposure, over that which the clear zenith in air would need; deeper, the images get dark."""

    @property
    def mosaic(self) -> str | None:
        """Name of the sensor's layout."""
        return "sony" if self.kind == "polarization" else None

    @property
    def sensor(self) -> Sensor:
        top = 2.0**self.bits - 1.0
        return Sensor(white=0.98 * top, gain=self.full_well / top, read_noise=self.read_noise)


def add_sun_images(
    dive: Dive,
    folder: str | Path,
    *,
    camera: Camera = SKY_CAMERA,
    name: str = "sky",
    scene: Scene | None = None,
    model: ImageModel | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Dive:
    """The dive with images of the sky above it, at its own place and time of day.

    Parameters
    ----------
    dive : Dive
        Its reference tells position and attitude.
    folder : path
        The files are written to ``images/NAME/`` in it; ``write_dive(..., images_from=folder)`` takes them over.
    camera : Camera
        Calibration and mounting; written beside the images.
    name : str
        Of the camera.
    scene, model
        The light, the sea and the water; what is recorded. The defaults where not given.
    seed : int
        The same seed gives the same clouds, waves and noise.
    progress : callable, optional
        Called with the share that is done.

    Raises
    ------
    ConfigError
        When the dive has a camera of that name.
    DataError
        By night, when the dive never is under water, and as :meth:`ReferenceMotion.of`.
    """
    scene, model = scene or Scene(), model or ImageModel()
    if name in dive.images:
        raise ConfigError(f"the dive has a camera {name!r}", where=f"images/{name}", remedy="give another name")
    motion = ReferenceMotion.of(dive)
    t, shots = _shots(motion, camera, model)
    place = Path(folder) / "images" / name
    place.mkdir(parents=True, exist_ok=True)
    write_camera(place / CAMERA_FILE, CameraFile(camera, model.sensor, model.mosaic))
    t_ns = from_seconds(t, motion.start_ns)
    files = [f"{stamp}.png" for stamp in t_ns]
    rng = Noise.of(seed, f"images {name}").rng
    for number, (file, shot) in enumerate(zip(files, shots, strict=True)):
        _write_png(place / file, _recorded(render(scene, shot, seed), model, rng))
        if progress is not None:
            progress((number + 1) / len(files))
    images = Images(t_ns, file=np.array(files, dtype=np.str_), camera=name)
    how = f"simulated: {model.model_dump_json()}, scene {scene.model_dump_json()}, seed {seed}"
    simulated = {**dive.provenance.get("simulated", {}), f"images/{name}": how}
    return replace(dive, images={**dive.images, name: images}, provenance={**dive.provenance, "simulated": simulated})


def _shots(motion: ReferenceMotion, camera: Camera, model: ImageModel) -> tuple[FloatArray, list[Shot]]:
    """Times [s] and circumstances of the images: under water and by day."""
    t = np.arange(int(np.floor(motion.duration_s * model.rate_hz + 1e-9)) + 1) / model.rate_hz
    p_n, R_nb = motion.position(t), motion.attitude(t)
    lat, lon, height = geodetic_from_ned(motion.origin, p_n)
    depth = -height if model.depth is None else np.full(len(t), model.depth)
    azimuth, elevation = sun_azimuth_elevation(from_seconds(t, motion.start_ns), lat, lon)
    by_day, under_water = elevation > np.radians(_LOWEST_SUN_DEG), depth > _SHALLOWEST_M
    if not by_day.any():
        raise DataError(
            f"the sun is below {_LOWEST_SUN_DEG:g} deg all the time; it stands at "
            f"{np.degrees(elevation[0]):.1f} deg at {isoformat(motion.start_ns)}",
            where="images",
            remedy="start by day, or leave the images out",
        )
    if not (by_day & under_water).any():
        raise DataError(
            "the camera is never under water by day",
            where="images",
            remedy="give the depth at which the images are to be taken",
        )
    R_lb = np.swapaxes(R_n_local(motion.origin, lat, lon), -1, -2) @ R_nb
    s_l = sun_axes(azimuth, elevation)[0]
    taken = np.flatnonzero(by_day & under_water)
    return t[taken], [Shot(camera, R_lb[i], s_l[i], float(depth[i]), p_n[i, :2], float(t[i])) for i in taken]


def _recorded(stokes: FloatArray, model: ImageModel, rng: np.random.Generator) -> NDArray[Any]:
    radiance = mosaic(stokes) if model.kind == "polarization" else stokes[..., 0]
    sensor = model.sensor
    scale = auto_scale(radiance, sensor.white, most=model.longest_exposure * sensor.white)
    return expose(radiance, sensor, scale, model.bits, rng)


def _write_png(file: Path, image: NDArray[Any]) -> None:
    if not cv2.imwrite(str(file), image, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
        raise DataError("cannot be written", where=str(file), remedy="check the disk and the permissions")
