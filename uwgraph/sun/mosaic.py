"""Division-of-focal-plane mosaics: every 2 x 2 pixels see through four polarizers.

Bins are sums over raw pixels, without demosaicking: a bin of 8 x 8 cells has the same four channels as one cell, and
the half cell by which they are displaced is taken out with the image's own slope.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uwgraph.camera.sensor import Sensor
from uwgraph.errors import ConfigError, DataError
from uwgraph.sun.stokes import StokesImage, analyser_matrix, stokes_of_means
from uwgraph.types import BoolArray, FloatArray

Layout = tuple[float, float, float, float]
"""Polarizer angles [deg] of a cell, row by row, from image x towards y."""

LAYOUTS: Final[dict[str, Layout]] = {
    "sony": (90.0, 45.0, 135.0, 0.0),
    "sony-rotated-180": (0.0, 135.0, 45.0, 90.0),
    "sony-mirrored-columns": (135.0, 90.0, 0.0, 45.0),
    "sony-mirrored-rows": (45.0, 0.0, 90.0, 135.0),
}
"""Sony's IMX250MZR, IMX253MZR, IMX264MZR (Lucid, FLIR, Basler, ...), also with the readout reversed in the camera: a
mirror changes the place of a polarizer in the cell and the sense of its angle."""


def layout(name: str) -> Layout:
    """A layout by its name, or of four angles in degrees row by row, such as ``"0,45,135,90"``.

    Raises
    ------
    ConfigError
        Neither a known name nor four angles that tell the polarization.
    """
    if name in LAYOUTS:
        return LAYOUTS[name]
    try:
        first, second, third, fourth = (float(part) for part in name.split(","))
        analyser_matrix(np.radians([first, second, third, fourth]))
    except (ValueError, DataError):
        raise ConfigError(
            f"{name!r} is no mosaic layout",
            where="mosaic",
            remedy=f"one of {', '.join(LAYOUTS)}, or four angles in degrees row by row, such as 90,45,135,0",
        ) from None
    return first, second, third, fourth


def from_mosaic(
    raw: NDArray[Any],
    cell: Layout = LAYOUTS["sony"],
    sensor: Sensor | None = None,
    gains: ArrayLike | None = None,
    cells: int = 8,
) -> StokesImage:
    """Stokes image of a raw mosaic (H, W) of 8 to 16 bits, in bins of ``cells`` x ``cells`` cells.

    ``sensor`` is a plain guess from the image where not given; ``gains`` are those of the cell's pixels, row by row.

    Raises
    ------
    DataError
        An image that is no mosaic: colours, or less than a bin.
    """
    if raw.ndim != 2 or min(raw.shape) < 2 * cells:
        raise DataError(
            f"an image of shape {raw.shape} is no mosaic",
            where="polarization mosaic",
            remedy=f"give the raw image of the sensor, (rows, columns), at least {2 * cells} pixels along each side",
        )
    sensor = sensor or Sensor.of(raw)
    means = _registered(_cell_means(raw, cells), cells)
    saturated = _saturated(raw, sensor, cells)
    return stokes_of_means(means, saturated, np.radians(cell), sensor, gains, 2 * cells, cells**2)


def _cell_means(raw: NDArray[Any], cells: int) -> FloatArray:
    """Means of the four channels, row by row of the cell, shape (4, h, w)."""
    h, w = (extent // (2 * cells) for extent in raw.shape)
    cut = raw[: h * 2 * cells, : w * 2 * cells]
    two_rows = np.ascontiguousarray(cut).reshape(h, cells, -1)  # both rows of a cell, one behind the other
    sums = np.add.reduce(two_rows, axis=1, dtype=np.float32).reshape(h, 2, w, cells, 2)
    means = sums.sum(axis=3, dtype=np.float64).transpose(1, 3, 0, 2).reshape(4, h, w) / cells**2
    return np.asarray(means, dtype=np.float64)


def _registered(means: FloatArray, cells: int) -> FloatArray:
    """The channels moved from where their pixels are, half a pixel off the cell's centre, to the centre."""
    if min(means.shape[1:]) < 2:
        return means
    d_row, d_col = np.gradient(means.mean(axis=0))
    step = 0.5 / (2 * cells)  # in bins
    signs = ((-1, -1), (-1, 1), (1, -1), (1, 1))
    shares = means.mean(axis=(1, 2)) / max(float(means.mean()), 1e-12)
    shift = [share * step * (r * d_row + c * d_col) for (r, c), share in zip(signs, shares, strict=True)]
    return np.asarray(means - np.stack(shift))


def _saturated(raw: NDArray[Any], sensor: Sensor, cells: int) -> BoolArray:
    """Bins with a saturated pixel."""
    side = 2 * cells
    h, w = (extent // side for extent in raw.shape)
    if raw.max() < sensor.white:
        return np.zeros((h, w), dtype=np.bool_)
    cut = raw[: h * side, : w * side]
    highest = cut.reshape(h, side, -1).max(axis=1).reshape(h, w, side).max(axis=2)
    return sensor.saturated(highest)
