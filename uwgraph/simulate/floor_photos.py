"""Photographs of real sea floors as a stock of texture: evenly lit, and without what is no floor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.camera.images import read_image
from uwgraph.errors import DataError
from uwgraph.simulate.floor_noise import Single

SUFFIXES: Final = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
MOST_PIXELS: Final = 30_000_000
"""Of all photos together, as they are kept: half a gigabyte."""
_SMALLEST: Final = 32
_LONGEST: Final = 5.0
"""Of height over width."""
_GAMMA: Final = 2.2
_MEAN_ALBEDO: Final = 0.2
_LIGHT_SIZE: Final = 0.18
"""Share of the photo's width over which its light changes."""
_GLARE: Final = 2.5
_BRIGHT_FLOOR: Final = 0.95
"""What is brighter than this quantile by the factor above is no floor: a cable, a lamp, metal."""
_ROOM_M: Final = 0.2
"""Radius of floor around a centre."""
_EDGE_M: Final = 0.08
"""Over which a photo fades at the border of its floor."""
_DARKEST: Final = 0.12
"""Of the brightest light: what is darker is noise."""


@dataclass(frozen=True, eq=False)
class Photo:
    """One photograph as reflectance."""

    texture: Single
    """Blue, green, red, and how far it is floor (0 to 1), shape (H, W, 4)."""
    centres: NDArray[np.int32]
    """Pixels (column, row) around which there is floor, shape (N, 2)."""


def read_photos(folder: Path, width_m: float, pixel_m: float) -> tuple[Photo, ...]:
    """The photographs of a folder in the order of their names, up to :data:`MOST_PIXELS`, in pixels of ``pixel_m``.

    Raises
    ------
    DataError
        When there is none, one cannot be read, or none shows floor that is free of cables and the like.
    """
    if not folder.is_dir():
        raise DataError("there is no such folder", where=str(folder), remedy="name a folder of photographs")
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES)
    if not files:
        raise DataError(f"holds no photographs ({', '.join(SUFFIXES)})", where=str(folder), remedy="check the folder")
    photos, kept = [], 0
    for file in files:
        photos.append(_photo(file, width_m, pixel_m))
        kept += photos[-1].texture[..., 0].size
        if kept > MOST_PIXELS:
            break
    usable = tuple(photo for photo in photos if len(photo.centres))
    if not usable:
        raise DataError(
            f"no photograph shows {2.0 * _ROOM_M:g} m of floor without glaring or dark objects",
            where=str(folder),
            remedy="give others, or a larger photo_width_m",
        )
    return usable


def _photo(file: Path, width_m: float, pixel_m: float) -> Photo:
    image = read_image(file)
    height, width = image.shape[:2]
    if min(height, width) < _SMALLEST or height > _LONGEST * width:
        raise DataError(f"has {width} x {height} pixels", where=str(file), remedy="give a photograph")
    full = float(np.iinfo(image.dtype).max)
    image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    scale = width_m / (pixel_m * width)
    size = (max(round(width * scale), 8), max(round(height * scale), 8))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC)
    linear = (np.asarray(small, dtype=np.float32) / np.float32(full)) ** np.float32(_GAMMA)
    light, floor = _light(linear.mean(axis=2))
    even = linear / np.maximum(light, 0.5 * _DARKEST * light.max())[..., None]
    colour = np.array([even[..., k][floor].mean() if floor.any() else 1.0 for k in range(3)], dtype=np.float32)
    grey = np.array([0.94, 1.0, 1.06], dtype=np.float32) * np.float32(_MEAN_ALBEDO)
    albedo = np.clip(even * (grey / np.maximum(colour, 1e-6)), 0.0, 0.9)
    framed = np.pad(floor.astype(np.uint8), 1)
    free = cv2.distanceTransform(framed, cv2.DIST_L2, 3)[1:-1, 1:-1]
    share = np.clip(free * np.float32(pixel_m / _EDGE_M), 0.0, 1.0)
    centres = np.argwhere(free * pixel_m > _ROOM_M)[:, ::-1]
    return Photo(np.dstack([albedo, share]).astype(np.float32), centres.astype(np.int32))


def _light(brightness: Single) -> tuple[Single, NDArray[np.bool_]]:
    """The light that fell on the floor, and where floor is seen: neither glaring nor too dark to tell."""
    bright = cv2.GaussianBlur(brightness, (0, 0), 1.5)
    glare = bright > _GLARE * float(np.quantile(bright[::4, ::4], _BRIGHT_FLOOR))
    reach = max(round(0.04 * brightness.shape[1]), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    floor = cv2.dilate(_long(glare, reach), disc) == 0
    light = np.exp(_mean_over(np.log(brightness + np.float32(1e-4)), floor))
    return light, floor & (light > _DARKEST * light.max())


def _long(mask: NDArray[np.bool_], extent: int) -> NDArray[np.uint8]:
    """The connected parts that reach over ``extent`` pixels or more: shells and pebbles are floor."""
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    kept = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) >= extent
    kept[0] = False
    return np.asarray(kept[label], dtype=np.uint8)


def _mean_over(values: Single, where: NDArray[np.bool_]) -> Single:
    """Weighted mean around each pixel, made on a coarse grid."""
    size = (values.shape[1], values.shape[0])
    coarse = (max(size[0] // 8, 1), max(size[1] // 8, 1))
    total, weight = (
        cv2.GaussianBlur(
            cv2.resize(plane, coarse, interpolation=cv2.INTER_AREA), (0, 0), _LIGHT_SIZE * coarse[0],
            borderType=cv2.BORDER_REFLECT,
        )
        for plane in (values * where, where.astype(np.float32))
    )  # fmt: skip
    return np.asarray(cv2.resize(total / np.maximum(weight, 1e-3), size, interpolation=cv2.INTER_CUBIC), np.float32)
