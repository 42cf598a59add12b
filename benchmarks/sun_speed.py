"""Speed of the optical methods against a yardstick timed in the same run, with the configuration of the accuracy lines.

Polarization: a 2448 x 2048 16-bit Sony mosaic, bins of 8 x 8 cells (19 584 pixels, all of which are used; kappa and
the candidates are found on some thousand of them), camera geometry cached. The yardstick is polanalyser's
demosaicking, Stokes vectors and angle of polarization alone.

Gradient: a 1024 x 1024 16-bit image with its own vertical, binned to 64 x 64 pixels, all of which are used, camera
geometry cached. The yardstick is one cv2.GaussianBlur (sd 3) and two cv2.Sobel of the same image as floats.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable

import _bench
import numpy as np
from _bench import Figure, Row

from uwgraph.camera.model import Camera
from uwgraph.camera.sensor import Sensor
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate.exposure import auto_scale, expose, mosaic
from uwgraph.simulate.render import Shot, render
from uwgraph.simulate.scene import Scene
from uwgraph.sun import gradient as light_gradient
from uwgraph.sun.mosaic import from_mosaic
from uwgraph.sun.observation import up_from_tilt
from uwgraph.sun.polarization import estimate
from uwgraph.sun.view import View

REPEATS = 15


def side_by_side(ours: Callable[[], object], yardstick: Callable[[], object]) -> tuple[float, float]:
    """Median seconds of both, taken in turns so that a busy machine is as busy for both."""
    ours(), yardstick()
    pairs = [(_bench.timed(ours)[0], _bench.timed(yardstick)[0]) for _ in range(REPEATS)]
    a, b = zip(*pairs, strict=True)
    return statistics.median(a), statistics.median(b)


def polarization(depth: float | None) -> Row:
    """A mosaic to an observation, in air or under water."""
    import cv2
    import polanalyser

    cv2.setNumThreads(1)
    size, zenith, roll, pitch = (2448, 2048), np.radians(50.0), 0.05, -0.04
    f = size[1] / 2.0 / np.radians(50.0)
    camera = Camera("fisheye", (f, f), ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0), size)
    scene = Scene(wind=0.0, sun=0.0)
    s_l = np.array([np.sin(zenith), 0.0, -np.cos(zenith)])
    radiance = mosaic(render(scene, Shot(camera, matrix_from_rph(np.array([roll, pitch, 1.0])), s_l, depth=depth)))
    sensor = Sensor(white=65_000.0, gain=10_000.0 / 65_535.0, read_noise=3.0)
    raw = expose(radiance, sensor, auto_scale(radiance, 65_000.0), 16, np.random.default_rng(0))
    view = View(camera, up_from_tilt(roll, pitch), n=1.0 if depth is None else scene.n, sun_zenith=zenith)

    def ours() -> object:
        return estimate(from_mosaic(raw, sensor=sensor), view)

    def yardstick() -> object:
        stokes = polanalyser.calcStokes(polanalyser.demosaicing(raw, polanalyser.COLOR_PolarMono), ANALYSERS)
        return polanalyser.cvtStokesToAoLP(stokes)

    ANALYSERS = [polanalyser.polarizer(angle) for angle in np.radians([0.0, 45.0, 90.0, 135.0])]
    mine, theirs = side_by_side(ours, yardstick)
    where = "in air" if depth is None else f"{depth:g} m deep"
    return {"method": f"polarization, {where}", "ms": 1e3 * mine, "yardstick ms": 1e3 * theirs, "ratio": theirs / mine}


def gradient(depth: float | None) -> Row:
    """An image to an observation, in air or under water."""
    import cv2

    cv2.setNumThreads(1)
    size = (1024, 1024)
    f = size[0] / np.radians(160.0 if depth is None else 110.0)
    camera = Camera("fisheye", (f, f), ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0), size)
    scene = Scene(wind=0.0)
    s_l = np.array([np.sin(0.9), 0.0, -np.cos(0.9)])
    radiance = render(scene, Shot(camera, np.eye(3), s_l, depth=depth))[..., 0]
    sensor = Sensor(white=0.98 * 4095.0, gain=2.4, read_noise=3.0)
    image = expose(radiance, sensor, auto_scale(radiance, 4095.0), 12, np.random.default_rng(0))
    as_float = image.astype(np.float32)
    tilts = iter(np.random.default_rng(1).normal(0.0, 0.01, (REPEATS + 1, 2)))

    def ours() -> object:
        view = View(camera, up_from_tilt(*next(tilts)), n=1.0 if depth is None else scene.n)
        return light_gradient.estimate(image, view, sensor)

    def yardstick() -> object:
        smooth = cv2.GaussianBlur(as_float, (0, 0), 3.0)
        return cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)

    mine, theirs = side_by_side(ours, yardstick)
    where = "in air" if depth is None else f"{depth:g} m deep"
    return {"method": f"gradient, {where}", "ms": 1e3 * mine, "yardstick ms": 1e3 * theirs, "ratio": theirs / mine}


def main() -> None:
    args: argparse.Namespace = _bench.parser(__doc__).parse_args()
    rows = [polarization(None), polarization(2.0)]
    figures = [
        Figure(f"times faster than polanalyser: {row['method']}", row["ratio"], 4.0, at_least=True) for row in rows
    ]
    gradients = [gradient(None), gradient(2.0)]
    figures += [Figure(f"times the yardstick: {row['method']}", 1.0 / row["ratio"], 5.0) for row in gradients]
    rows += gradients
    _bench.finish(args, "sun_speed", {"speed": rows}, figures)


if __name__ == "__main__":
    main()
