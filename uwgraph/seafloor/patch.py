"""One keyframe's piece of the floor, anchored to its keyframe.

A patch is a regular grid of points over the keyframe's texture (its image, rectified and colour-corrected). The points
stay in the body frame of the keyframe's moment: a better solution moves the patch, and nothing is measured again.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from uwgraph.errors import DataError
from uwgraph.types import BoolArray, FloatArray

MAX_NODES: Final = 4_000_000
MAX_TEXTURE: Final = 20_000_000
_MAX_BYTES: Final = 200_000_000
_SHAPES: Final = {"points_b": 3, "sigma": 2, "common": 0, "measured": 2, "jpeg": 1}
_KINDS: Final = {"points_b": "f", "sigma": "f", "common": "f", "measured": "b", "jpeg": "u"}
_JPEG: Final = [cv2.IMWRITE_JPEG_QUALITY, 92]

Colours = NDArray[np.uint8]
"""Shape (H, W, 3): blue, green, red."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A grid of points of the floor and the texture that it carries."""

    t_ns: int
    """The keyframe's moment."""
    points_b: NDArray[np.float32]
    """In the body frame of that moment, shape (rows, columns, 3), m; NaN where the floor was not seen."""
    sigma: NDArray[np.float32]
    """1-sigma along the line of sight, shape (rows, columns), m; NaN as the points."""
    common: float
    """1-sigma that all keyframes have in common, such as the roughness of a floor that is taken as a plane, m."""
    measured: BoolArray
    """False where a point only carries the texture over a gap in the measurements, shape (rows, columns)."""
    texture: Colours
    """The image, shape (rows * step, columns * step, 3): every point is the centre of a block of step x step pixels."""

    @property
    def file(self) -> str:
        """Name of the patch's file."""
        return f"{self.t_ns}.npz"

    def points_n(self, R_nb: FloatArray, p_n: FloatArray) -> FloatArray:
        """The points in n with the keyframe at a pose, shape (rows, columns, 3), m."""
        points: FloatArray = self.points_b.astype(np.float64) @ R_nb.T + p_n
        return points

    def pixels_n(self, R_nb: FloatArray, p_n: FloatArray) -> FloatArray:
        """Where every pixel of the texture lies in n with the keyframe at a pose, shape (H, W, 3), m."""
        rows, columns = self.sigma.shape
        step = self.texture.shape[0] // rows
        points = self.points_n(R_nb, p_n) - p_n
        wide = np.pad(points, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")  # goes on beyond the edge
        full = cv2.resize(wide, ((columns + 2) * step, (rows + 2) * step), interpolation=cv2.INTER_LINEAR)
        return np.asarray(full[step:-step, step:-step] + p_n, dtype=np.float64)

    def node_colours(self) -> FloatArray:
        """The texture around each node, shape (rows, columns, 3)."""
        rows, columns = self.sigma.shape
        small: FloatArray = cv2.resize(self.texture, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float64)
        return small


def write_patch(folder: Path, patch: Patch) -> None:
    """Write one patch into a folder, under its own name."""
    done, jpeg = cv2.imencode(".jpg", patch.texture, _JPEG)
    assert done
    np.savez(
        folder / patch.file,
        points_b=patch.points_b.astype(np.float32),
        sigma=patch.sigma.astype(np.float32),
        common=np.float64(patch.common),
        measured=patch.measured,
        jpeg=jpeg.ravel(),
    )


def read_patch(path: Path) -> Patch:
    """Read one patch back.

    Raises
    ------
    DataError
        When the file is missing, damaged, too large, or no patch.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _MAX_BYTES:
                raise _no_patch(path, "is too large")
        with np.load(path, allow_pickle=False) as arrays:
            values = {name: arrays[name] for name in _SHAPES}
        t_ns = int(path.stem)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
        raise _no_patch(path, f"is no patch of a map ({str(error)[:80]})") from error
    texture = _decoded(path, values)
    points, sigma, measured = values["points_b"], values["sigma"], values["measured"]
    rows, columns = sigma.shape
    good = points.shape == (rows, columns, 3) and measured.shape == sigma.shape and 4 <= sigma.size <= MAX_NODES
    step = texture.shape[0] // max(rows, 1)
    if not good or min(rows, columns) < 2 or texture.shape[:2] != (rows * step, columns * step):
        raise _no_patch(path, "holds arrays that do not fit together")
    seen = np.isfinite(points).all(axis=2) & (np.abs(np.nan_to_num(points)) < 1e6).all(axis=2) & (sigma > 0.0)
    return Patch(
        t_ns,
        np.where(seen[..., None], points, np.nan).astype(np.float32),
        np.where(seen, sigma, np.nan).astype(np.float32),
        float(np.clip(np.nan_to_num(values["common"]), 0.0, 1e3)),
        measured & seen,
        texture,
    )


def _decoded(path: Path, values: dict[str, Any]) -> Colours:
    for name, array in values.items():
        if array.ndim != _SHAPES[name] or array.dtype.kind != _KINDS[name]:
            raise _no_patch(path, f"holds no usable {name}")
    try:
        texture = cv2.imdecode(values["jpeg"].astype(np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise _no_patch(path, "holds no usable texture") from error
    if texture is None or texture.shape[0] * texture.shape[1] > MAX_TEXTURE:
        raise _no_patch(path, "holds no usable texture")
    return np.asarray(texture, dtype=np.uint8)


def _no_patch(path: Path, problem: str) -> DataError:
    return DataError(problem, where=str(path), remedy="make the map again from the dive")
