"""Which cameras of a dive map the floor, and their images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from uwgraph.camera.file import read_camera
from uwgraph.camera.images import read_image
from uwgraph.camera.model import Camera, check_size
from uwgraph.dive.folder import CAMERA_FILE
from uwgraph.dive.model import Dive
from uwgraph.errors import ConfigError
from uwgraph.seafloor.patch import Colours
from uwgraph.seafloor.stereo import is_left
from uwgraph.types import TimeArray

_DOWNWARD: Final = 0.3
"""Sine of the angle below the horizon from which on a camera looks at the floor."""
_ALIKE: Final = 0.5
"""Cosine of the angle between the axes of a stereo pair, at least."""
_SHARED: Final = 0.5
"""Of the images of a pair so many must have a partner."""


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera, and where its images are."""

    name: str
    camera: Camera
    t_ns: TimeArray
    """As stamped, shape (N,)."""
    files: tuple[Path, ...]

    def read(self, index: int) -> Colours:
        """An image in 8 bits and three colours.

        Raises
        ------
        DataError
            When it cannot be read, or is not of the camera file's size.
        """
        image = read_image(self.files[index])
        check_size(self.camera, image, str(self.files[index]))
        if image.dtype == np.uint16:
            image = (image >> 8).astype(np.uint8)
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image[:, :, :3])


@dataclass(frozen=True, eq=False)
class Eyes:
    """One camera, or a stereo pair, left and right, whose images are matched by their stamps."""

    first: Eye
    second: Eye | None

    @property
    def t_ns(self) -> TimeArray:
        """Stamps of the images of one camera or of both, in order, shape (K,)."""
        if self.second is None:
            return self.first.t_ns
        return np.intersect1d(self.first.t_ns, self.second.t_ns)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(eye.name for eye in (self.first, self.second) if eye is not None)

    def read(self, t_ns: int) -> tuple[Colours, ...]:
        """The images of a stamp, of one camera or of both; raises as :meth:`Eye.read`."""
        eyes = [eye for eye in (self.first, self.second) if eye is not None]
        return tuple(eye.read(int(np.searchsorted(eye.t_ns, t_ns))) for eye in eyes)


def choose_eyes(dive: Dive, folder: Path, first: str | None = None, second: str | None = None) -> Eyes:
    """The cameras named, or those that look down: two of them with shared stamps are a stereo pair.

    Raises
    ------
    ConfigError
        When there is no such camera, none that looks down, more than can be told apart, or no calibration.
    """
    if first is None and second is not None:
        raise ConfigError("a second camera without a first", where="--right", remedy="name both, --camera and --right")
    eyes = {name: _eye(dive, folder, name) for name in ([first] if first else dive.images) if name is not None}
    if first is None:
        eyes = {name: eye for name, eye in eyes.items() if eye.camera.R_bs[2, 2] > _DOWNWARD}
        if not eyes:
            raise ConfigError(
                f"no camera looks down (cameras: {', '.join(dive.images) or 'none'})",
                where=str(folder),
                remedy="say 'mount: down-forward' (or R_bs) in its camera.yaml, or name one with --camera",
            )
    chosen = next(iter(eyes.values()))
    if second is not None:
        return _pair(chosen, _eye(dive, folder, second))
    if first is None:
        partners = [eye for eye in list(eyes.values())[1:] if _is_pair(chosen, eye)]
        if len(eyes) > 1 + len(partners) or len(partners) > 1:
            raise ConfigError(
                f"several cameras look down: {', '.join(eyes)}",
                where=str(folder),
                remedy="name one with --camera, or a stereo pair with --camera and --right",
            )
        return _pair(chosen, partners[0]) if partners else Eyes(chosen, None)
    return Eyes(chosen, None)


def _eye(dive: Dive, folder: Path, name: str) -> Eye:
    if name not in dive.images:
        known = ", ".join(dive.images) or "none"
        raise ConfigError(f"the dive has no camera {name!r} ({known})", where=str(folder), remedy="name one of these")
    images, place = dive.images[name], folder / "images" / name
    order = np.argsort(images.t_ns, kind="stable")
    files = tuple(place / str(file) for file in images.file[order])
    return Eye(name, read_camera(place / CAMERA_FILE).camera, images.t_ns[order], files)


def _is_pair(first: Eye, second: Eye) -> bool:
    apart = np.linalg.norm(first.camera.l_b - second.camera.l_b) > 0.0
    alike = first.camera.R_bs[:, 2] @ second.camera.R_bs[:, 2] > _ALIKE
    return bool(apart and alike and _shared(first, second) >= _SHARED)


def _shared(first: Eye, second: Eye) -> float:
    return len(np.intersect1d(first.t_ns, second.t_ns)) / max(min(len(first.t_ns), len(second.t_ns)), 1)


def _pair(one: Eye, other: Eye) -> Eyes:
    if not _shared(one, other):
        raise ConfigError(
            f"the images of {one.name!r} and {other.name!r} share no stamps",
            where="--right",
            remedy="give the images of a pair the same stamps, or map with one camera",
        )
    return Eyes(one, other) if is_left(one.camera, other.camera) else Eyes(other, one)
