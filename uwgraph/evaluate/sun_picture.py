"""One picture of one image: the sun found in it, what spoke for it, and what is left over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from uwgraph.atomic import atomic_file
from uwgraph.camera.refraction import refract
from uwgraph.sun.estimate import Estimate
from uwgraph.sun.gradient import GradientEstimate
from uwgraph.sun.observation import SunObservation, level_axes
from uwgraph.sun.polarization import PolarizationEstimate
from uwgraph.sun.scattering_fit import ScatteringFit
from uwgraph.sun.surface import to_water
from uwgraph.sun.view import View
from uwgraph.types import BoolArray, FloatArray

BLUE, GREY, SUN = "#1f5fa8", "#8a8a8a", "#e8a33d"


def sun_picture(found: Estimate, view: View, path: Path, title: str = "") -> None:
    """Write a PNG of an estimate; ``view`` is that of the camera as it is, before binning."""
    figure = Figure(figsize=(15, 5.2), layout="constrained")
    grid = figure.add_gridspec(1, 3)
    if isinstance(found, ScatteringFit):
        _sweep(figure.add_subplot(grid[0, :2]), found)
        _histogram(figure.add_subplot(grid[0, 2]), np.degrees(found.residuals))
    else:
        picture = figure.add_subplot(grid[0, 0])
        if isinstance(found, PolarizationEstimate):
            _image(picture, np.log(np.maximum(found.image.I, 1e-3)), _used(found), view)
            _vote(figure.add_subplot(grid[0, 1], projection="polar"), found)
            _residuals(figure.add_subplot(grid[0, 2]), _polarization_residuals(found), view, "deg")
        else:
            _image(picture, found.light.log_l, found.light.good, view)
            _gradients(figure.add_subplot(grid[0, 1]), found, view)
            _residuals(figure.add_subplot(grid[0, 2]), _gradient_residuals(found), view, "%")
        _mark(picture, found.observation, view)
    figure.suptitle(_headline(title, found.observation), x=0.01, ha="left", fontsize=11)
    with atomic_file(path) as partial:
        figure.savefig(partial, dpi=110, format="png")


def _headline(title: str, sun: SunObservation) -> str:
    doubts = ", ".join(sun.flags.names())
    verdict = f"not to be used: {doubts}" if doubts else "no doubts"
    if not np.isfinite(sun.s_b).all():
        return f"{title}   {sun.method}: no sun found; {verdict}"
    azimuth, sigma = np.degrees(sun.azimuth_b) % 360.0, np.degrees(sun.azimuth_sigma)
    return (
        f"{title}   {sun.method}: {azimuth:.2f} +- {sigma:.2f} deg from the bow, "
        f"{np.degrees(sun.elevation):.1f} deg high; quality {sun.quality:.2f}; {verdict}"
    )


def _extent(view: View) -> tuple[float, float, float, float]:
    width, height = view.camera.size
    return (-0.5, width - 0.5, height - 0.5, -0.5)


def _image(axes: Axes, log_light: FloatArray, used: BoolArray, view: View) -> None:
    """The logarithm of the light, dimmed where it is not used."""
    seen = log_light[used] if used.any() else log_light[np.isfinite(log_light)]
    low, high = np.quantile(seen, [0.005, 0.995]) if seen.size else (0.0, 1.0)
    axes.imshow(log_light, cmap="gray", vmin=low, vmax=high, extent=_extent(view))
    axes.imshow(np.where(used, np.nan, 0.0), cmap="cool", alpha=0.25, extent=_extent(view))
    axes.set(title="ln light; tinted: not used", xlabel="column", ylabel="row")


def _mark(axes: Axes, sun: SunObservation, view: View) -> None:
    """Where the sun, and its rival, would be in the image."""
    for s_b, style, label in ((sun.s_b, "o", "sun"), (sun.other_b, "x", "second mode")):
        if s_b is None or not np.isfinite(s_b).all():
            continue
        uv = pixel_of(s_b, view)
        axes.plot(uv[0], uv[1], style, color=SUN, ms=12, mfc="none", mew=2, label=label)
    axes.set(xlim=_extent(view)[:2], ylim=_extent(view)[2:])
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right")


def pixel_of(s_b: FloatArray, view: View) -> FloatArray:
    """Pixel (u, v) at which a direction in the sky is seen; it may lie outside the image."""
    ray = s_b[None]
    if view.in_water:
        ray = to_water(ray, view.up_b, view.n)
    ray = ray @ view.camera.R_bs
    if view.in_water and view.camera.port == "flat":
        ray = refract(ray, np.array([0.0, 0.0, 1.0]), 1.0 / view.n)
    uv: FloatArray = view.camera.project(ray)[0]
    return uv


def _used(found: PolarizationEstimate) -> BoolArray:
    used = np.zeros(found.image.I.size, dtype=np.bool_)
    used[found.pixels] = True
    return used.reshape(found.image.I.shape)


def _vote(axes: Axes, found: PolarizationEstimate) -> None:
    assert isinstance(axes, PolarAxes)
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_title("votes for the sun's azimuth, from the bow")
    axes.set_yticks([])
    vote = found.solution.vote if found.solution is not None else None
    if vote is None or not len(vote.modes):
        axes.set_title("no vote: it takes time and place")
        return
    count = len(vote.histogram)
    centres = (np.arange(count) + 0.5) * 2.0 * np.pi / count - np.pi
    axes.bar(centres, vote.histogram, width=2.0 * np.pi / count, color=BLUE)
    axes.plot([vote.azimuth] * 2, [0.0, float(vote.histogram.max())], color=SUN, lw=2)


def _polarization_residuals(found: PolarizationEstimate) -> FloatArray:
    """Angle of each e-vector against the model, degrees, as an image."""
    left = np.full(found.image.I.size, np.nan)
    if found.solution is not None:
        left[found.pixels] = np.degrees(np.arcsin(np.clip(found.solution.fit.residual, -1.0, 1.0)))
    return left.reshape(found.image.I.shape)


def _gradients(axes: Axes, found: GradientEstimate, view: View) -> None:
    """Directions in which the light grows, on a chart of the sky with the bow up and starboard to the right."""
    axes.set(title="where the light grows (chart: bow up, starboard right)", aspect="equal", xticks=[], yticks=[])
    field = found.field
    if field is None:
        return
    bow, starboard, up = level_axes(view.up_b)
    every = slice(None, None, max(1, len(field.a) // 400))
    a, g = field.a[every], field.g[every]
    zenith = np.arccos(np.clip(a @ up, -1.0, 1.0)) / np.maximum(np.hypot(a @ bow, a @ starboard), 1e-9)
    x, y = zenith * (a @ starboard), zenith * (a @ bow)
    size = np.maximum(np.linalg.norm(g, axis=1), 1e-9)
    axes.quiver(x, y, g @ starboard / size, g @ bow / size, color=BLUE, scale=40, width=0.003)
    s = found.observation.s_b
    if np.isfinite(s).all():
        theta, azimuth = np.arccos(np.clip(s @ up, -1.0, 1.0)), np.arctan2(s @ starboard, s @ bow)
        axes.plot(theta * np.sin(azimuth), theta * np.cos(azimuth), "o", color=SUN, ms=12, mfc="none", mew=2)


def _gradient_residuals(found: GradientEstimate) -> FloatArray:
    """ln light less the fitted sky, in per cent, as an image."""
    left = np.full(found.light.log_l.shape, np.nan)
    if found.fit is not None:
        left[found.light.good] = 100.0 * found.fit.residual
    return left


def _residuals(axes: Axes, left: FloatArray, view: View, unit: str) -> None:
    spread = float(np.nanquantile(np.abs(left), 0.95)) if np.isfinite(left).any() else 1.0
    drawn = axes.imshow(left, cmap="RdBu_r", vmin=-spread, vmax=spread, extent=_extent(view))
    axes.set(title=f"residuals [{unit}]", xlabel="column", ylabel="row")
    axes.figure.colorbar(drawn, ax=axes, shrink=0.8)


def _sweep(axes: Axes, found: ScatteringFit) -> None:
    sweep = found.sweep
    azimuth = np.degrees(sweep.azimuth) % 360.0
    measured = np.degrees(np.mod(sweep.aop + np.pi / 2.0, np.pi) - np.pi / 2.0)
    axes.plot(azimuth, measured, ".", color=GREY, label="measured")
    model = np.degrees(np.mod(sweep.aop - found.residuals + np.pi / 2.0, np.pi) - np.pi / 2.0)
    axes.plot(azimuth, model, ".", color=BLUE, ms=3, label="model")
    axes.set(title="angle of polarization", xlabel="view azimuth from the bow [deg]", ylabel="[deg]", xlim=(0, 360))
    axes.legend()


def _histogram(axes: Axes, left: FloatArray) -> None:
    axes.hist(left, bins=40, color=BLUE)
    axes.set(title="residuals [deg]", xlabel="[deg]")
