"""A dive's images into its sun stream."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Final

from uwgraph.camera.file import read_camera
from uwgraph.camera.images import read_image
from uwgraph.dive.model import Dive
from uwgraph.dive.vertical import vertical
from uwgraph.errors import ConfigError, DataError
from uwgraph.sun.estimate import Method, estimate_sun, view_of
from uwgraph.sun.observation import SunFlag, SunObservation, sun_stream
from uwgraph.types import FloatArray, Sun

CAMERA_FILE: Final = "camera.yaml"
_WORTH_A_PROCESS: Final = 40
"""Fewer images are done before a second process has started."""


@dataclass(frozen=True, eq=False)
class _Taken:
    """One image and its circumstances."""

    file: Path
    t_ns: int
    up_b: FloatArray
    tilt_sigma: float


@dataclass(frozen=True, eq=False)
class Processed:
    """What became of the images."""

    sun: Sun
    """Every image in which a sun was found, those with flags included."""
    images: int
    used: int
    """Those without any flag."""
    refused: dict[str, int]
    """How often each flag was raised, and how many images could not be read."""


def process_images(
    dive: Dive,
    folder: Path,
    camera: str,
    *,
    method: Method | None = None,
    n: float = 1.0,
    processes: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Processed:
    """Find the sun in every image of one camera of a dive.

    The vertical at each image comes from IMU and DVL; time and the dive's origin tell how high the sun stands.

    Parameters
    ----------
    folder : Path
        The dive's folder; the images and ``camera.yaml`` are in its ``images/CAMERA``.
    method : optional
        Polarization where the camera file names a mosaic, otherwise the gradient.
    n : float
        Refractive index of what the camera sits in: 1 in air.

    Raises
    ------
    ConfigError, DataError
        No such camera, no camera file, images that cannot be read, or none that shows the sun.
    """
    if camera not in dive.images:
        known = ", ".join(dive.images) or "none"
        raise ConfigError(
            f"the dive has no camera {camera!r} ({known})", where=str(folder), remedy="name one with --camera"
        )
    stream, place = dive.images[camera], folder / "images" / camera
    _camera(place / CAMERA_FILE)  # a bad file is told before the work begins
    up = vertical(dive, stream.t_ns)
    taken = [
        _Taken(place / str(name), int(t), u, float(s))
        for name, t, u, s in zip(stream.file, stream.t_ns, up.up_b, up.sigma, strict=True)
    ]
    one = partial(_observe, place / CAMERA_FILE, method, n, (dive.origin.lat, dive.origin.lon))
    found = list(_watched(_mapped(one, taken, processes), len(taken), progress))
    observations = [o for o in found if isinstance(o, SunObservation)]
    unread = [problem for problem in found if isinstance(problem, str)]
    sun = sun_stream(observations)
    refused = {
        name: count
        for flag in SunFlag
        for name in flag.names()
        if (count := sum(flag in o.flags for o in observations))
    }
    if unread:
        refused["unreadable"] = len(unread)
    used = sum(o.ok for o in observations)
    if not used:
        why = ", ".join(f"{name} {count}" for name, count in refused.items())
        raise DataError(
            f"no sun to be used in any of {len(taken)} images ({why}){': ' + unread[0] if unread else ''}",
            where=str(place),
            remedy="look at one with 'uwgraph sun show'",
        )
    return Processed(sun, len(taken), used, refused)


_camera = lru_cache(read_camera)  # the geometry of its pixels is cached by camera, too


def _observe(
    camera: Path, method: Method | None, n: float, place: tuple[float, float], taken: _Taken
) -> SunObservation | str:
    """The observation, or what is wrong with the image."""
    file = _camera(camera)
    view = view_of(file, taken.up_b, n=n, tilt_sigma=taken.tilt_sigma, t_ns=taken.t_ns, place=place)
    try:
        return estimate_sun([read_image(taken.file)], file, view, method).observation
    except DataError as error:
        return str(error)


def _mapped(
    one: Callable[[_Taken], SunObservation | str], taken: list[_Taken], processes: int
) -> Iterable[SunObservation | str]:
    if processes == 1 or len(taken) < _WORTH_A_PROCESS:
        return map(one, taken)
    return _in_processes(one, taken, processes)


def _in_processes(
    one: Callable[[_Taken], SunObservation | str], taken: list[_Taken], processes: int
) -> Iterable[SunObservation | str]:
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(one, taken, chunksize=8)


def _watched(
    results: Iterable[SunObservation | str], count: int, progress: Callable[[float], None] | None
) -> Iterable[SunObservation | str]:
    for number, result in enumerate(results, start=1):
        if progress is not None:
            progress(number / count)
        yield result
