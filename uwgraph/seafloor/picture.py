"""The map for people: the picture from above with track, closures, scale bar and north arrow, and the floor's depth."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from uwgraph.seafloor.links import Pairs
from uwgraph.seafloor.render import SeafloorMap
from uwgraph.types import FloatArray

TRACK, CLOSURE = "#ffd54a", "#ff4fa3"
_WIDEST_PX: Final = 1600
_PAPER: Final = 255 * 0.94


def map_picture(found: SeafloorMap, links: Pairs, path: Path, title: str = "") -> None:
    """Write a PNG."""
    raster = found.raster
    share = raster.height / raster.width
    beside = share > 0.6
    shape = (1, 2) if beside else (2, 1)
    size = (15.0, min(max(7.0 * share, 4.0), 14.0)) if beside else (13.0, max(22.0 * share, 5.0))
    figure = Figure(figsize=size, layout="constrained")
    above, depth = figure.subplots(*shape, sharex=True, sharey=True).ravel()
    above.imshow(_paper(found), extent=_extent(found), interpolation="antialiased")
    _track(above, found, links)
    _scale_bar(above, raster.pixel * raster.width)
    _north_arrow(above)
    depths, extent = _depths(found)
    low, high = np.nanquantile(depths, [0.005, 0.995]) if np.isfinite(depths).any() else (0.0, 1.0)
    shown = depth.imshow(depths, extent=extent, cmap="viridis_r", vmin=low, vmax=high, interpolation="nearest")
    figure.colorbar(shown, ax=depth, label="depth in n [m]", shrink=0.9)
    for axes in (above, depth):
        axes.set(xlabel="east [m]", ylabel="north [m]", xlim=_extent(found)[:2], ylim=_extent(found)[2:])
        axes.set_aspect("equal")
    above.legend(loc="lower left", fontsize=8, framealpha=0.85)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    figure.savefig(path, dpi=120, format="png")


def _extent(found: SeafloorMap) -> tuple[float, float, float, float]:
    raster = found.raster
    return (
        raster.east,
        raster.east + raster.pixel * raster.width,
        raster.north - raster.pixel * raster.height,
        raster.north,
    )


def _paper(found: SeafloorMap) -> FloatArray:
    """The canvas in red, green, blue on paper, at the size of a screen."""
    canvas = found.canvas
    share = min(1.0, _WIDEST_PX / max(canvas.shape[:2]))
    size = (max(round(canvas.shape[1] * share), 1), max(round(canvas.shape[0] * share), 1))
    small = cv2.resize(canvas, size, interpolation=cv2.INTER_AREA).astype(np.float64)
    cover = small[..., 3:] / 255.0
    rgb: FloatArray = (small[..., 2::-1] + _PAPER * (1.0 - cover)) / 255.0  # empty pixels are black: already weighted
    return np.clip(rgb, 0.0, 1.0)


def _track(axes: Axes, found: SeafloorMap, links: Pairs) -> None:
    ne = found.poses.p_n[:, :2]
    axes.plot(ne[:, 1], ne[:, 0], color=TRACK, lw=0.8, alpha=0.9, label=f"track, {len(ne)} keyframes")
    axes.plot(ne[0, 1], ne[0, 0], "o", color=TRACK, ms=5, mec="black", mew=0.5, label="start")
    if len(links):
        lines = LineCollection(list(ne[links][..., ::-1]), colors=CLOSURE, linewidths=0.7, alpha=0.8)
        lines.set_label(f"{len(links)} closures")
        axes.add_collection(lines)


def _scale_bar(axes: Axes, width_m: float) -> None:
    """A bar of a round length, about a fifth of the picture."""
    want = width_m / 5.0
    ten = 10.0 ** np.floor(np.log10(want))
    length = max(step * ten for step in (1.0, 2.0, 5.0) if step * ten <= want)
    share = length / width_m
    axes.plot([0.97 - share, 0.97], [0.05, 0.05], transform=axes.transAxes, color="black", lw=5, solid_capstyle="butt")
    axes.plot([0.97 - share, 0.97], [0.05, 0.05], transform=axes.transAxes, color="white", lw=3, solid_capstyle="butt")
    axes.text(
        0.97 - share / 2.0, 0.075, f"{length:g} m", transform=axes.transAxes, ha="center", va="bottom", bbox=_box()
    )


def _north_arrow(axes: Axes) -> None:
    axes.annotate(
        "N",
        xy=(0.97, 0.97),
        xytext=(0.97, 0.82),
        xycoords="axes fraction",
        textcoords="axes fraction",
        ha="center",
        va="top",
        fontsize=12,
        arrowprops={"arrowstyle": "-|>", "lw": 2.0, "color": "black"},
        bbox=_box(),
    )


def _box() -> dict[str, object]:
    return {"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none", "alpha": 0.8}


def _depths(found: SeafloorMap) -> tuple[FloatArray, tuple[float, float, float, float]]:
    """Mean down of the cloud's points in each of its cells (or several), NaN where there are none; and its extent."""
    p, raster = found.cloud.points_n, found.raster
    several = max(int(np.ceil(raster.pixel * max(raster.height, raster.width) / _WIDEST_PX / found.voxel)), 1)
    cell = found.voxel * several
    at = np.floor(p[:, :2] / cell).astype(np.intp)
    low, high = (at.min(axis=0), at.max(axis=0) + 1) if len(at) else (np.zeros(2, np.intp), np.ones(2, np.intp))
    rows, columns = high - low
    index = (high[0] - 1 - at[:, 0]) * columns + at[:, 1] - low[1]
    count = np.bincount(index, minlength=rows * columns)
    total = np.bincount(index, p[:, 2], minlength=rows * columns)
    depth = np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(rows, columns)
    return depth, (low[1] * cell, high[1] * cell, low[0] * cell, high[0] * cell)
