"""A sea floor under a dive: pictures of it from a camera that looks down, or two, and its distance by echo."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.file import CameraFile, write_camera
from uwgraph.camera.model import DOWN_FORWARD, Camera
from uwgraph.dive import Dive
from uwgraph.dive.folder import CAMERA_FILE
from uwgraph.dive.yamlfile import parse_settings
from uwgraph.errors import ConfigError, DataError
from uwgraph.frames import geodetic_from_ned
from uwgraph.simulate.floor_light import Light
from uwgraph.simulate.floor_model import EchoSounder, FloorModel
from uwgraph.simulate.floor_photos import read_photos
from uwgraph.simulate.floor_record import recorded, write_picture
from uwgraph.simulate.floor_render import Eye, radiance, ranges
from uwgraph.simulate.floor_snow import add_snow, drift
from uwgraph.simulate.floor_terrain import TEXEL_M, Terrain
from uwgraph.simulate.noise import Noise
from uwgraph.simulate.replay import ReferenceMotion
from uwgraph.simulate.trajectory import Motion
from uwgraph.time import from_seconds
from uwgraph.types import Altitude, FloatArray, Images

FLOOR_CAMERA: Final = Camera(
    "pinhole",
    f=(525.0, 525.0),
    c=(319.5, 239.5),
    size=(640, 480),
    distortion=(-0.06, 0.02, 0.0, 0.0),
    R_bs=DOWN_FORWARD,
    l_b=np.array([0.4, 0.0, 0.2]),
)
"""Looks down and sees 3.7 by 2.7 m at an altitude of 3 m."""
_NEAREST_M: Final = 0.3
_SHALLOWEST_M: Final = 0.1
_PHOTO_PIXEL_M: Final = 0.875 * TEXEL_M


def add_floor_images(
    dive: Dive,
    folder: str | Path,
    *,
    photos: str | Path | None = None,
    camera: Camera = FLOOR_CAMERA,
    name: str = "down",
    model: FloorModel | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Dive:
    """The dive with pictures of a simulated floor below it, and with the altitude over that floor.

    Parameters
    ----------
    dive : Dive
        Its reference tells position and attitude.
    folder : path
        The files are written to ``images/NAME/`` in it (and ``images/NAME_right/`` for a stereo pair);
        ``write_dive(..., images_from=folder)`` takes them over.
    photos : path, optional
        Folder of photographs of a real floor, whose texture is used; without it the floor is made of noise.
    camera : Camera
        Calibration and mounting; written beside the images. Of a stereo pair the left one.
    name : str
        Of the camera.
    model : FloorModel, optional
        Floor, light, water and recording.
    seed : int
        The same seed gives the same floor, noise and marine snow.
    progress : callable, optional
        Called with the share that is done.

    Raises
    ------
    ConfigError
        When the dive has such a camera or an altitude already.
    DataError
        When the floor never is in sight, photographs cannot be used, and as :meth:`ReferenceMotion.of`.
    """
    model = model or FloorModel()
    cameras = _cameras(camera, name, model)
    _refuse_taken(dive, cameras, model)
    motion = ReferenceMotion.of(dive)
    terrain = _terrain(model, _floor_depth(motion, model), seed, photos)
    t = _moments(motion, terrain, camera, model)
    t_ns = from_seconds(t, motion.start_ns) - dive.rig.visual.time_offset_ns
    for camera_name, one in cameras.items():
        place = Path(folder) / "images" / camera_name
        place.mkdir(parents=True, exist_ok=True)
        write_camera(place / CAMERA_FILE, CameraFile(one))
    files = [f"{stamp}.{model.format}" for stamp in t_ns]
    eyes = {camera_name: Eye(one) for camera_name, one in cameras.items()}
    rng = Noise.of(seed, f"images {name}").rng
    for number, (file, p_n, R_nb) in enumerate(zip(files, motion.position(t), motion.attitude(t), strict=True)):
        for camera_name, picture in _pictures(terrain, eyes, model, p_n, R_nb, rng):
            write_picture(Path(folder) / "images" / camera_name / file, picture)
        if progress is not None:
            progress((number + 1) / len(files))
    images = {one: Images(t_ns, file=np.array(files, dtype=np.str_), camera=one) for one in cameras}
    seen = replace(dive, images={**dive.images, **images}, provenance=_told(dive, cameras, model, terrain, photos))
    return seen if model.sounder is None else _sounded(seen, motion, terrain, model.sounder, seed)


def terrain_of(dive: Dive, photos: str | Path | None = None) -> Terrain:
    """The floor that :func:`add_floor_images` put under a dive: its heights, and given the photographs its colours.

    Raises
    ------
    ConfigError
        When there is none, or its description cannot be used.
    DataError
        When the photographs cannot be used.
    """
    told = dive.provenance.get("floor")
    if not isinstance(told, Mapping):
        raise ConfigError("the dive has no simulated floor", where="provenance.floor", remedy="simulate with --floor")
    try:
        depth, seed = float(told["depth"]), int(told["seed"])
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            "does not tell depth and seed", where="provenance.floor", remedy="simulate the dive again"
        ) from error
    model = parse_settings(FloorModel, told.get("model", {}), "provenance.floor.model")
    return _terrain(model, depth, seed, photos)


def _terrain(model: FloorModel, depth: float, seed: int, photos: str | Path | None) -> Terrain:
    stock = () if photos is None else read_photos(Path(photos), model.ground.photo_width_m, _PHOTO_PIXEL_M)
    return Terrain(model.ground, seed, depth, stock, _PHOTO_PIXEL_M)


def _cameras(camera: Camera, name: str, model: FloorModel) -> dict[str, Camera]:
    cameras = {name: camera}
    if model.stereo_baseline_m > 0.0:
        right = camera.l_b + camera.R_bs @ np.array([model.stereo_baseline_m, 0.0, 0.0])
        cameras[f"{name}_right"] = replace(camera, l_b=right)
    return cameras


def _refuse_taken(dive: Dive, cameras: Iterable[str], model: FloorModel) -> None:
    for name in cameras:
        if name in dive.images:
            raise ConfigError(f"the dive has a camera {name!r}", where=f"images/{name}", remedy="give another name")
    if dive.altitude is not None and model.sounder is not None:
        raise ConfigError(
            "the dive has an altitude, over another floor", where="altitude", remedy="leave it or the sounder out"
        )


def _depths(motion: Motion, p_n: FloatArray) -> FloatArray:
    return np.asarray(-geodetic_from_ned(motion.origin, p_n)[2])


def _floor_depth(motion: ReferenceMotion, model: FloorModel) -> float:
    if model.depth is not None:
        return model.depth
    t = np.arange(0.0, motion.duration_s, 1.0)
    return float(_depths(motion, motion.position(t)).max() + model.altitude)


def _moments(motion: ReferenceMotion, terrain: Terrain, camera: Camera, model: FloorModel) -> FloatArray:
    """Times [s] of the images: under water, and over a floor that is in sight."""
    t: FloatArray = np.arange(int(np.floor(motion.duration_s * model.rate_hz + 1e-9)) + 1) / model.rate_hz
    p_n = motion.position(t) + motion.attitude(t) @ camera.l_b
    above = terrain.mean_down(p_n[:, :2]) - p_n[:, 2]
    near = np.flatnonzero((above < model.sight_m) & (_depths(motion, p_n) > _SHALLOWEST_M))
    if len(near):
        near = near[terrain.down(p_n[near, :2]) - p_n[near, 2] > _NEAREST_M]
    if not len(near):
        raise DataError(
            f"the floor at {terrain.depth:.1f} m is never in sight ({model.sight_m:g} m)",
            where="images",
            remedy="give a floor depth or an altitude that the dive comes near to, or leave them out",
        )
    return t[near]


def _pictures(
    terrain: Terrain, eyes: Mapping[str, Eye], model: FloorModel, p_n: FloatArray, R_nb: FloatArray,
    rng: np.random.Generator,
) -> Iterator[tuple[str, NDArray[np.uint8]]]:  # fmt: skip
    """All cameras' pictures of one moment, with the same marine snow before them."""
    first = next(iter(eyes.values())).camera
    flakes, radius = drift(first, model.water.snow, rng)
    for name, eye in eyes.items():
        aside = eye.camera.l_b - first.l_b
        light = Light.at(model.lamps, model.water, terrain.depth, aside)
        seen = radiance(terrain, eye, light, p_n + R_nb @ eye.camera.l_b, R_nb, model.sight_m)
        add_snow(seen, eye.camera, light, flakes - aside, radius)
        yield name, recorded(seen, model, rng)


def _sounded(dive: Dive, motion: Motion, terrain: Terrain, sounder: EchoSounder, seed: int) -> Dive:
    """The dive with the echo sounder's ranges, as far as it reaches."""
    t: FloatArray = np.arange(int(np.floor(motion.duration_s * sounder.rate_hz + 1e-9)) + 1) / sounder.rate_hz
    R_nb = motion.attitude(t)
    r = ranges(terrain, motion.position(t) + R_nb @ sounder.rig.l_b, R_nb @ sounder.rig.R_bs[:, 2], sounder.range_m)
    heard = np.isfinite(r)
    sigma = np.full(int(heard.sum()), sounder.rig.sigma)
    measured = r[heard] + Noise.of(seed, "altitude").normal(sounder.rig.sigma, sigma.shape)
    t_ns = from_seconds(t[heard], motion.start_ns) - sounder.rig.time_offset_ns
    altitude = Altitude(t_ns, altitude=np.maximum(measured, 0.0), sigma=sigma)
    return replace(dive, altitude=altitude, rig=dive.rig.model_copy(update={"altitude": sounder.rig}))


def _told(
    dive: Dive, cameras: Iterable[str], model: FloorModel, terrain: Terrain, photos: str | Path | None
) -> dict[str, Any]:
    """Provenance from which :func:`terrain_of` makes the floor again."""
    floor = {
        "depth": terrain.depth,
        "seed": terrain.seed,
        "photos": None if photos is None else str(photos),
        "model": model.model_dump(mode="json"),
    }
    made = [*(f"images/{camera}" for camera in cameras), *([] if model.sounder is None else ["altitude"])]
    simulated = {**dive.provenance.get("simulated", {}), **dict.fromkeys(made, "simulated: see floor")}
    return {**dive.provenance, "simulated": simulated, "floor": floor}
