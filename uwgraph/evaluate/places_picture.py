"""One picture of the places of a dive: its track with the closures across it, and the pairs of images behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uwgraph.atomic import atomic_file
from uwgraph.camera.eyes import Eye
from uwgraph.types import FloatArray, RelativePoses, TimeArray

TAKEN, REFUSED, BLUE = "#2a8a4a", "#c0392b", "#1f5fa8"
PAIRS: Final = 6
"""Pairs of images that are shown."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Two images of a closure, as they are."""

    row: int
    """Of the closures."""
    before: NDArray[Any]
    after: NDArray[Any]


def shown_pairs(closures: RelativePoses, eye: Eye, count: int = PAIRS) -> list[Pair]:
    """Closures worth a look, with their images: accepted ones spread over the dive, then refused ones."""
    rows = {int(t): k for k, t in enumerate(eye.t_ns)}
    pairs = []
    for row in _worth_a_look(closures, count):
        before, after = (rows.get(int(t[row])) for t in (closures.from_ns, closures.t_ns))
        if before is not None and after is not None:
            pairs.append(Pair(row, eye.read(before), eye.read(after)))
    return pairs


def _worth_a_look(closures: RelativePoses, count: int) -> list[int]:
    """Accepted ones spread over the dive, then refused ones with the most matches."""
    accepted, refused = np.flatnonzero(closures.accepted), np.flatnonzero(~closures.accepted)
    refused = refused[np.argsort(-closures.inliers[refused], kind="stable")]
    room = max(count - min(len(refused), count // 3), 0)
    spread = accepted[np.unique(np.linspace(0, len(accepted) - 1, min(room, len(accepted))).astype(int))]
    rows: list[int] = [*spread.tolist(), *refused.tolist()][:count]
    return rows


def places_picture(
    t_ns: TimeArray,
    p_n: FloatArray,
    closures: RelativePoses,
    nodes_ns: TimeArray,
    pairs: Sequence[Pair],
    path: Path,
    title: str = "",
) -> None:
    """Write a PNG.

    Parameters
    ----------
    t_ns, p_n : arrays
        The track: stamps, shape (K,), and positions in n, shape (K, 3), m.
    closures : RelativePoses
        Green where accepted, red where refused although some points agreed.
    nodes_ns : array
        When the places of the topological map were first seen, shape (M,).
    pairs : sequence of Pair
        Images to show beside.
    """
    figure = Figure(figsize=(14, 7.5), layout="constrained")
    grid = figure.add_gridspec(max((len(pairs) + 1) // 2, 1), 3, width_ratios=(1.5, 1.0, 1.0))
    _track(figure.add_subplot(grid[:, 0]), t_ns, p_n, closures, nodes_ns)
    for number, pair in enumerate(pairs):
        _pair(figure.add_subplot(grid[number // 2, 1 + number % 2]), pair, closures, t_ns[0])
    taken = int(closures.accepted.sum())
    counts = f"{taken} closures, {len(closures) - taken} refused, {len(nodes_ns)} places"
    figure.suptitle("   ".join(filter(None, (title, counts))), x=0.01, ha="left", fontsize=11)
    with atomic_file(path) as partial:
        figure.savefig(partial, dpi=110, format="png")


def _track(axes: Axes, t_ns: TimeArray, p_n: FloatArray, closures: RelativePoses, nodes_ns: TimeArray) -> None:
    def east_north(times: TimeArray) -> FloatArray:
        return np.stack([np.interp(times, t_ns, p_n[:, column]) for column in (1, 0)], axis=-1)

    track = east_north(t_ns)
    axes.plot(track[:, 0], track[:, 1], color=BLUE, lw=0.9, zorder=1)
    doubtful = ~closures.accepted & (closures.inliers > 0)  # candidates with nothing in common are no news
    for mask, colour, width in ((doubtful, REFUSED, 0.4), (closures.accepted, TAKEN, 1.0)):
        ends = np.stack([east_north(closures.from_ns[mask]), east_north(closures.t_ns[mask])], axis=1)
        axes.add_collection(LineCollection(list(ends), colors=colour, linewidths=width, zorder=2))
    nodes = east_north(nodes_ns)
    axes.scatter(nodes[:, 0], nodes[:, 1], s=9, color="black", zorder=3, label="places")
    axes.plot([], [], color=TAKEN, label="closures")
    axes.plot([], [], color=REFUSED, label="refused")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="east [m]", ylabel="north [m]")
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize=8, framealpha=0.9)


def _pair(axes: Axes, pair: Pair, closures: RelativePoses, start_ns: np.int64) -> None:
    before, after = (_colour(image) for image in (pair.before, pair.after))
    height = min(before.shape[0], after.shape[0])
    axes.imshow(np.concatenate([before[:height], np.full((height, 8, 3), 255, np.uint8), after[:height]], axis=1))
    axes.set_axis_off()
    k = pair.row
    seconds = [(t - start_ns) * 1e-9 for t in (closures.from_ns[k], closures.t_ns[k])]
    verdict = "" if closures.accepted[k] else "refused: "
    axes.set_title(
        f"{seconds[0]:.0f} s, {seconds[1]:.0f} s: {closures.inliers[k]} points\n{verdict}{closures.reason[k]}"[:120],
        fontsize=7,
        color=TAKEN if closures.accepted[k] else REFUSED,
    )


def _colour(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Red, green, blue of an image in file order, stretched to what a screen shows."""
    rgb = image[..., ::-1] if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    low, high = np.quantile(rgb, [0.005, 0.995])
    return np.asarray(np.clip((rgb - low) / max(high - low, 1.0) * 255.0, 0.0, 255.0), dtype=np.uint8)
