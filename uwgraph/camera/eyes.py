"""The cameras of a dive that belong together, one or a stereo pair, and their images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.file import read_camera
from uwgraph.camera.images import read_image
from uwgraph.camera.model import Camera, check_size
from uwgraph.dive.folder import CAMERA_FILE
from uwgraph.dive.model import Dive
from uwgraph.errors import ConfigError
from uwgraph.types import TimeArray

_DOWNWARD: Final = 0.3
"""Sine of the angle below the horizon from which on a camera looks at the floor."""
_ALIKE: Final = 0.5
"""Cosine of the angle between the axes of a stereo pair, at least."""
_SHARED: Final = 0.5
"""Of the images of a pair so many must have a partner."""
_TOGETHER: Final = 0.05
"""Two images are of one moment when their stamps differ by less than this part of the usual time between images."""

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera, and where its images are."""

    name: str
    camera: Camera
    t_ns: TimeArray
    """As stamped, in order, shape (N,)."""
    files: tuple[Path, ...]

    def read(self, index: int) -> NDArray[Any]:
        """An image as it was recorded.

        Raises
        ------
        DataError
            When it cannot be read, or is not of the camera file's size.
        """
        image = read_image(self.files[index])
        check_size(self.camera, image, str(self.files[index]))
        return image

    def select(self, rows: IndexArray) -> Eye:
        """With those of its images."""
        return Eye(self.name, self.camera, self.t_ns[rows], tuple(self.files[k] for k in rows.tolist()))


@dataclass(frozen=True, eq=False)
class Eyes:
    """One camera, or a stereo pair, left and right, whose images are of the same moments, one to one."""

    first: Eye
    second: Eye | None

    def __len__(self) -> int:
        return len(self.first.t_ns)

    @property
    def t_ns(self) -> TimeArray:
        """Stamps of the (left) images, in order, shape (K,)."""
        return self.first.t_ns

    @property
    def each(self) -> tuple[Eye, ...]:
        """The one, or both."""
        return (self.first,) if self.second is None else (self.first, self.second)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(eye.name for eye in self.each)

    @property
    def cameras(self) -> Camera | tuple[Camera, Camera]:
        """The one, or left and right."""
        return self.first.camera if self.second is None else (self.first.camera, self.second.camera)

    def read(self, index: int) -> tuple[NDArray[Any], ...]:
        """The images of a moment, of one camera or of both; raises as :meth:`Eye.read`."""
        return tuple(eye.read(index) for eye in self.each)


def choose_eyes(
    dive: Dive, folder: Path, first: str | None = None, second: str | None = None, *, downward: bool = True
) -> Eyes:
    """The cameras named, or the only ones that look down: two of them with images of one moment are a stereo pair.

    Without ``downward`` where they look does not matter.

    Raises
    ------
    ConfigError
        When there is no such camera, none that looks down, more than can be told apart, or no calibration.
    """
    if first is None and second is not None:
        raise ConfigError("a second camera without a first", where="--right", remedy="name both, --camera and --right")
    if first is not None:
        chosen = _eye(dive, folder, first)
        return Eyes(chosen, None) if second is None else _pair(chosen, _eye(dive, folder, second))
    eyes = {name: _eye(dive, folder, name) for name in dive.images}
    if downward or len(eyes) > 1:
        eyes = {name: eye for name, eye in eyes.items() if eye.camera.R_bs[2, 2] > _DOWNWARD}
    if not eyes:
        raise ConfigError(
            f"no camera looks down (cameras: {', '.join(dive.images) or 'none'})",
            where=str(folder),
            remedy="say 'mount: down-forward' (or R_bs) in its camera.yaml, or name one with --camera",
        )
    chosen, *others = eyes.values()
    partners = [eye for eye in others if _is_pair(chosen, eye)]
    if len(others) > len(partners) or len(partners) > 1:
        raise ConfigError(
            f"several cameras look down: {', '.join(eyes)}",
            where=str(folder),
            remedy="name one with --camera, or a stereo pair with --camera and --right",
        )
    return _pair(chosen, partners[0]) if partners else Eyes(chosen, None)


def is_left(one: Camera, other: Camera) -> bool:
    """Whether ``one`` is the left one of a pair: the other sits where its columns (or rows) grow."""
    across, along, _ = (other.l_b - one.l_b) @ one.R_bs
    return bool((across if abs(across) >= abs(along) else along) >= 0.0)


def _eye(dive: Dive, folder: Path, name: str) -> Eye:
    if name not in dive.images:
        known = ", ".join(dive.images) or "none"
        raise ConfigError(f"the dive has no camera {name!r} ({known})", where=str(folder), remedy="name one of these")
    images, place = dive.images[name], folder / "images" / name
    files = tuple(place / str(file) for file in images.file)
    return Eye(name, read_camera(place / CAMERA_FILE).camera, images.t_ns, files)


def _is_pair(one: Eye, other: Eye) -> bool:
    apart = np.linalg.norm(one.camera.l_b - other.camera.l_b) > 0.0
    alike = one.camera.R_bs[:, 2] @ other.camera.R_bs[:, 2] > _ALIKE
    shared = len(together(one.t_ns, other.t_ns)[0])
    return bool(apart and alike and shared >= _SHARED * min(len(one.t_ns), len(other.t_ns)))


def _pair(one: Eye, other: Eye) -> Eyes:
    rows, partners = together(one.t_ns, other.t_ns)
    if not len(rows):
        raise ConfigError(
            f"the images of {one.name!r} and {other.name!r} are never of one moment",
            where="--right",
            remedy="give the images of a pair the same stamps, or use one camera",
        )
    one, other = one.select(rows), other.select(partners)
    return Eyes(one, other) if is_left(one.camera, other.camera) else Eyes(other, one)


def together(a: TimeArray, b: TimeArray) -> tuple[IndexArray, IndexArray]:
    """Rows of two lists of stamps, in order, that are of one moment, one to one."""
    steps = [float(np.median(np.diff(t))) for t in (a, b) if len(t) > 1]
    reach = _TOGETHER * min(steps, default=0.0)
    after = np.clip(np.searchsorted(b, a), 1, max(len(b) - 1, 1))
    after = np.minimum(after, len(b) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(a - b[before]) <= np.abs(b[after] - a), before, after)
    rows = np.flatnonzero(np.abs(b[nearest] - a) <= reach)
    _, first = np.unique(nearest[rows], return_index=True)
    return rows[first], nearest[rows[first]]
