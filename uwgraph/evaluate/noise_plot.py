"""One picture of an IMU's noise: the Allan deviation of every axis, and the terms that explain it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uwgraph.atomic import atomic_file
from uwgraph.dive.allan import model_variance
from uwgraph.dive.imu_noise import UNITS, WORDS, ImuNoise
from uwgraph.dive.noise_terms import SensorNoise

COLOURS = ("#1f5fa8", "#e8a33d", "#4b8f5a")
GREY = "#8a8a8a"
LABELS = {"Q": 0.2, "N": 0.5, "B": 0.7, "K": 1.0}
"""How far along its line a term is named: where it counts."""


def noise_plot(noise: ImuNoise, path: Path, title: str = "") -> None:
    """Write a PNG: gyro and accelerometer side by side, points measured, lines fitted, the terms in grey."""
    figure = Figure(figsize=(13, 5.5), layout="constrained")
    for axes, (name, sensor) in zip(figure.subplots(1, 2), (("gyro", noise.gyro), ("accel", noise.accel)), strict=True):
        _deviations(axes, sensor)
        axes.set_title(name, loc="left")
        axes.set(xlabel="averaging time [s]", ylabel=f"Allan deviation [{UNITS[name]['B']}]")
    still = f"still for {noise.duration_s:.0f} s from {noise.start_s:.0f} s on, {noise.rate_hz:.4g} Hz"
    figure.suptitle(f"{title}: {still}" if title else still, x=0.01, ha="left", fontsize=11)
    with atomic_file(path) as partial:
        figure.savefig(partial, dpi=110, format="png")


def _deviations(axes: Axes, sensor: SensorNoise) -> None:
    for letter, axis, colour in zip("xyz", sensor.axes, COLOURS, strict=True):
        tau_s = axis.allan.tau_s
        fitted = tau_s >= 0.99 * sensor.tau_min_s
        axes.loglog(tau_s, np.sqrt(axis.allan.variance), "o", ms=4, color=colour, label=letter)
        axes.loglog(tau_s[fitted], np.sqrt(axis.model[fitted]), "-", lw=1.2, color=colour)
    tau_s = sensor.axes[0].allan.tau_s
    for name, term in sensor.terms.items():
        if term.seen:
            line = term.value * np.sqrt(model_variance((name,), tau_s)[:, 0])
            axes.loglog(tau_s, line, "--", lw=0.9, color=GREY)
            at = round(LABELS[name] * (len(tau_s) - 1))
            axes.annotate(f"{name} {WORDS[name]} ", (tau_s[at], line[at]), color=GREY, size=8, ha="right", va="top")
    # the lines of the terms run on for ever: the picture is of what was measured
    measured = np.sqrt(np.concatenate([axis.allan.variance for axis in sensor.axes]))
    axes.set_ylim(0.5 * measured.min(), 2.0 * measured.max())
    axes.grid(which="both", alpha=0.25)
    axes.legend(loc="upper right", framealpha=0.9)
