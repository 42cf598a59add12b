"""How near the optical methods come to the Cramer-Rao bound of the same image and the same noise.

Polarization: an ideal sky (single scattering) in air, four channels with shot and read noise at three exposures. The
bound is that of the direction and of the light scattered twice, which is estimated beside it under the prior of the
settings, from each pixel's own noise of the angle of polarization. Pixels whose polarization is below three times its
noise have no part in either.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import _bench
import numpy as np
from _bench import Figure, Row
from polarization import POLARIZERS, WELL, fisheye
from scipy.interpolate import BSpline

from uwgraph.camera.sensor import Sensor
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate.exposure import auto_scale, behind_polarizer, expose
from uwgraph.simulate.render import Shot, render
from uwgraph.simulate.scene import Scene
from uwgraph.sun import gradient as light_gradient
from uwgraph.sun.eigen import jacobian, refine
from uwgraph.sun.evector import Unknowns, light_of, skylight
from uwgraph.sun.gradient_field import MAX_ZENITH
from uwgraph.sun.observation import up_from_tilt
from uwgraph.sun.polarization import Settings, estimate
from uwgraph.sun.stokes import StokesImage, from_channels
from uwgraph.sun.unknowns import derivatives
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

IDEAL = Scene(sky=12, neutral_deg=0.0, sun=0.0, wind=0.0, vignetting=0.0)
ZENITHS_DEG = (20, 40, 60, 80)
GAINS = (0.6, 2.5, 20.0)
"""Electrons per count: full wells of 2500 and 10 000 electrons, and eight exposures of the latter."""
LIMIT = 1.3


def polarization(zenith_deg: float, gain: float, images: int) -> Row:
    """RMSE of the direction over its bound, at one height of the sun and one exposure."""
    zenith = np.radians(zenith_deg)
    roll, pitch = np.radians([4.0, -3.0])
    camera = fisheye(128, np.radians(55.0))
    R_lb = matrix_from_rph(np.array([roll, pitch, 0.7]))
    s_l = np.array([np.sin(zenith), 0.0, -np.cos(zenith)])
    view = View(camera, up_from_tilt(roll, pitch), sun_zenith=zenith)
    sensor = Sensor(white=0.98 * WELL, gain=gain, read_noise=3.0)
    stokes = render(IDEAL, Shot(camera, R_lb, s_l))
    light = [behind_polarizer(stokes, float(beta)) for beta in POLARIZERS]
    scale = auto_scale(np.stack(light), WELL)
    s_b, errors = R_lb.T @ s_l, []
    for seed in range(images):
        rng = np.random.default_rng([seed, int(zenith_deg)])
        counts = [expose(x, sensor, scale, 12, rng) for x in light]
        errors.append(np.cross(estimate(from_channels(counts, POLARIZERS, sensor), view).observation.s_b, s_b))
    exact = from_channels([x * scale for x in light], POLARIZERS, sensor)
    bound = cramer_rao(exact, view, s_b)
    rmse = float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
    aop = float(np.degrees(np.median(exact.sigma_aop)))
    return {
        "method": "polarization",
        "sun zenith": zenith_deg,
        "AoP noise deg": aop,
        "rmse deg": np.degrees(rmse),
        "bound deg": np.degrees(bound),
        "rmse / bound": rmse / bound,
    }


def cramer_rao(exact: StokesImage, view: View, s_b: FloatArray) -> float:
    """Bound [rad] of the root mean square angle between direction and sun, of a noise-free image with its sigmas."""
    settings = Settings(dop_error=0.0)
    in_sky = view.sky_rays() @ view.up_b > np.cos(settings.max_zenith_air)
    significant = np.hypot(exact.Q, exact.U) > settings.least_significance * exact.sigma
    pixels = np.flatnonzero(in_sky & (significant & ~exact.saturated).ravel())
    above = skylight(light_of(exact, view, pixels, pixels, 0.0), view.up_b, view.n)
    sky = above.evectors(Unknowns())
    fit = refine(sky, s_b, view.up_b, settings.robust)
    J = jacobian(sky, fit, derivatives(above, sky, s_b, Unknowns(), in_water=False))
    information = (J.T / sky.sigma**2) @ J
    information[2, 2] += 1.0 / settings.prior.twice**2
    return float(np.sqrt(np.trace(np.linalg.inv(information)[:2, :2])))


def polarization_rows(images: int) -> list[Row]:
    return _bench.in_processes(polarization, [(z, gain, images) for gain in GAINS for z in ZENITHS_DEG])


def gradient(zenith_deg: float, gain: float, images: int) -> Row:
    """RMSE of the gradient's direction over its bound, at one height of the sun and one exposure."""
    zenith = np.radians(zenith_deg)
    camera = fisheye(256, np.radians(80.0))
    view = View(camera)
    sensor = Sensor(white=0.98 * WELL, gain=gain, read_noise=3.0)
    s = np.array([np.sin(zenith), 0.0, -np.cos(zenith)])
    radiance = render(IDEAL, Shot(camera, np.eye(3), s))[..., 0]
    scale = auto_scale(radiance, WELL, quantile=1.0)
    errors = []
    for seed in range(images):
        counts = expose(radiance, sensor, scale, 12, np.random.default_rng([seed, int(zenith_deg)]))
        errors.append(np.cross(light_gradient.estimate(counts, view, sensor).observation.s_b, s))
    unknown, known = gradient_bounds(view, s, radiance * scale, sensor)
    rmse = float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
    return {
        "method": "gradient",
        "sun zenith": zenith_deg,
        "electrons at most": 0.8 * WELL * gain,
        "rmse deg": np.degrees(rmse),
        "bound deg": np.degrees(unknown),
        "rmse / bound": rmse / unknown,
        "rmse / bound, sky known": rmse / known,
    }


def gradient_bounds(view: View, s: FloatArray, counts: FloatArray, sensor: Sensor) -> tuple[float, float]:
    """Bounds [rad] of the direction with the sky's two functions unknown, and with them known up to the exposure."""
    d = view.sky_rays()
    used = d @ view.up_b > np.cos(MAX_ZENITH)
    d, y = d[used], counts.ravel()[used]
    weight = y**2 / sensor.variance(y)
    across = np.array([0.0, 1.0, 0.0])
    J = np.stack([_moved(d, s, t) for t in (np.cross(across, s), across)], axis=1)
    zenith, gamma = np.arccos(np.clip(d @ view.up_b, -1.0, 1.0)), np.arccos(np.clip(d @ s, -1.0, 1.0))
    splines = np.concatenate([_splines(gamma), _splines(zenith)[:, 1:]], axis=1)
    return _bound(J, weight, splines), _bound(J, weight, np.ones((len(y), 1)))


def _moved(d: FloatArray, s: FloatArray, tangent: FloatArray, step: float = 1e-5) -> FloatArray:
    """Derivative of ln of the radiance as the sun moves along ``tangent``."""
    ahead, behind = (np.log(IDEAL.sky_at(s + h * tangent, 0, 0.0).background(d)[:, 0]) for h in (step, -step))
    return (ahead - behind) / (2.0 * step)


def _splines(x: FloatArray, pieces: int = 12) -> FloatArray:
    low, high = float(x.min()), float(x.max())
    knots = np.concatenate([[low] * 3, np.linspace(low, high, pieces + 1), [high] * 3])
    return np.asarray(BSpline.design_matrix(x, knots, 3).toarray())


def _bound(J: FloatArray, weight: FloatArray, nuisance: FloatArray) -> float:
    root = np.sqrt(weight)[:, None]
    J = root * J
    left = J - root * nuisance @ np.linalg.lstsq(root * nuisance, J, rcond=None)[0]
    return float(np.sqrt(np.trace(np.linalg.inv(left.T @ left))))


def gradient_rows(images: int) -> list[Row]:
    return _bench.in_processes(gradient, [(z, gain, images) for gain in GAINS for z in (30, 45, 60)])


def plot(rows: list[Row], path: Path) -> None:
    """RMSE against bound, one line for each method."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.0, 5.0))
    for method in sorted({row["method"] for row in rows}):
        own = [row for row in rows if row["method"] == method]
        axes.loglog([r["bound deg"] for r in own], [r["rmse deg"] for r in own], "o", label=method)
    ends = np.array(axes.get_xlim())
    axes.loglog(ends, ends, "k-", lw=0.8, label="bound")
    axes.loglog(ends, LIMIT * ends, "k--", lw=0.8, label=f"{LIMIT} times the bound")
    axes.set(xlabel="Cramer-Rao bound of the direction [deg]", ylabel="RMSE [deg]")
    axes.legend()
    figure.savefig(path, dpi=150, bbox_inches="tight")


def main() -> None:
    parser = _bench.parser(__doc__)
    parser.add_argument("--images", type=int, default=50, help="noise draws for each cell")
    parser.add_argument("--plot", type=Path, help="also draw RMSE against bound into this file")
    args: argparse.Namespace = parser.parse_args()
    tables = {"polarization": polarization_rows(args.images), "gradient": gradient_rows(args.images)}
    rows = [row for table in tables.values() for row in table]
    worst = {row["method"]: max(r["rmse / bound"] for r in rows if r["method"] == row["method"]) for row in rows}
    figures = [Figure(f"rmse / bound, {method}", value, LIMIT) for method, value in worst.items()]
    if args.plot:
        plot(rows, args.plot)
    _bench.finish(args, "efficiency", tables, figures)


if __name__ == "__main__":
    main()
