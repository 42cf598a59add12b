"""Polarization in simulation: heading error from e-vectors, behind occluders, and from under water.

1. 20 000 e-vectors over +-35 deg, noise and outliers of random angle; the sun 20 to 88 deg from the zenith.
2. Rendered images in air, camera tilted by up to 10 deg (known), part of the sky behind bodies of four shapes that are
   unpolarized, polarized at random in patches, or polarized as by a false sun. The sky has neutral points.
3. Rendered images through the surface from 2 m, whole and with a sector hidden, calm and with waves.

Refused images (flags) count as refused, not as errors; "worst" is the largest error of those that were not refused.
"""

from __future__ import annotations

import argparse
import itertools

import _bench
import numpy as np
from _bench import Figure, Row

from uwgraph.camera.model import Camera
from uwgraph.camera.sensor import Sensor
from uwgraph.frames import matrix_from_rph, wrap_pi
from uwgraph.simulate.exposure import auto_scale, behind_polarizer, expose
from uwgraph.simulate.render import Shot, render
from uwgraph.simulate.scene import OccluderSettings, Scene
from uwgraph.sun.eigen import Evectors, from_azimuth, solve
from uwgraph.sun.observation import SunObservation, azimuth_in_level, up_from_tilt
from uwgraph.sun.polarization import estimate
from uwgraph.sun.stokes import from_channels
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

UP = np.array([0.0, 0.0, -1.0])
ZENITHS_DEG = (20, 40, 60, 80, 88)
NOISES = ((0.0, 0.0, 0.01), (1.0, 0.0, 0.03), (2.0, 0.0, 0.05), (4.0, 0.0, 0.10), (2.0, 0.5, 0.05), (4.0, 0.8, 0.30))
"""AoP noise [deg], share of random angles, limit of the mean heading error [deg]."""
SHARES = ((0.4, 0.3), (0.6, 0.5), (0.8, 1.0))
"""Share of the sky that is hidden, limit of the median heading error [deg]."""
SHAPES = ("sector", "hull", "wall", "canopy")
CLUTTERS = ("none", "random", "false_sun")
POLARIZERS = np.radians([0.0, 45.0, 90.0, 135.0])
SENSOR = Sensor(white=4000.0, gain=2.5, read_noise=3.0)
WELL = 4096.0
CLEAR, COASTAL = 1e-6, 0.398
"""Beam attenuation, 1/m."""


def evectors(rng: np.random.Generator, zenith: float, noise: float, random: float, count: int = 20_000) -> tuple[
    Evectors, FloatArray
]:  # fmt: skip
    """E-vectors over +-35 deg about the zenith, and the sun; ``noise`` [rad], ``random`` the share of outliers."""
    s_b = from_azimuth(rng.uniform(-np.pi, np.pi), zenith, UP)
    height, turn = rng.uniform(np.cos(np.radians(35.0)), 1.0, count), rng.uniform(-np.pi, np.pi, count)
    flat = np.sqrt(1.0 - height**2)
    a_b = np.stack([flat * np.cos(turn), flat * np.sin(turn), -height], axis=1)
    e_b = np.cross(a_b, s_b)
    e_b /= np.linalg.norm(e_b, axis=1)[:, None]
    angle = noise * rng.standard_normal(count)
    outlier = rng.random(count) < random
    angle[outlier] = rng.uniform(-np.pi / 2.0, np.pi / 2.0, int(outlier.sum()))
    e_b = np.cos(angle)[:, None] * e_b + np.sin(angle)[:, None] * np.cross(a_b, e_b)
    return Evectors(a_b, e_b, np.full(count, max(noise, 1e-4)), np.arange(count)), s_b


def heading_errors(noise_deg: float, random: float, zenith_deg: float, seeds: int) -> tuple[FloatArray, FloatArray]:
    """Heading errors [deg] of the estimate and of the vote alone, shape (seeds,) each."""
    errors = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, int(zenith_deg), int(10 * noise_deg), int(100 * random)])
        sky, s_b = evectors(rng, np.radians(zenith_deg), np.radians(noise_deg), random)
        found = solve(sky, UP, np.radians(zenith_deg))
        assert found.vote is not None
        azimuths = np.array([azimuth_in_level(found.fit.s_b, UP), found.vote.azimuth])
        errors.append(np.degrees(wrap_pi(azimuths - azimuth_in_level(s_b, UP))))
    estimate_, voted = np.array(errors).T
    return estimate_, voted


def fisheye(side: int, half_field: float) -> Camera:
    f = side / 2.0 / half_field
    return Camera("fisheye", (f, f), ((side - 1) / 2.0, (side - 1) / 2.0), (side, side))


def photograph(
    camera: Camera, scene: Scene, zenith: float, tilt: float, depth: float | None, seed: int
) -> tuple[SunObservation, float, FloatArray]:
    """The observation of one rendered image, its heading error [rad], and the true direction (3,)."""
    rng = np.random.default_rng(seed)
    roll, pitch = rng.uniform(-tilt, tilt, 2)
    heading, azimuth = rng.uniform(-np.pi, np.pi, 2)
    R_lb = matrix_from_rph(np.array([roll, pitch, heading]))
    s_l = np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), -np.cos(zenith)])
    stokes = render(scene, Shot(camera, R_lb, s_l, depth=depth), seed=seed)
    light = [behind_polarizer(stokes, float(beta)) for beta in POLARIZERS]
    scale = auto_scale(np.stack(light), WELL)
    counts = [expose(x, SENSOR, scale, 12, rng) for x in light]
    n = 1.0 if depth is None else scene.n
    view = View(camera, up_from_tilt(roll, pitch), n=n, sun_zenith=zenith)
    found = estimate(from_channels(counts, POLARIZERS, SENSOR), view).observation
    return found, float(wrap_pi(found.heading(azimuth) - heading)), R_lb.T @ s_l


def rendered_errors(scene: Scene, depth: float | None, tilt_deg: float, seeds: list[int]) -> list[tuple[float, ...]]:
    """(heading error [deg], refused, NEES of the direction, NEES of the azimuth) of images; the sun 30 to 70 deg."""
    camera = fisheye(128, np.radians(60.0 if depth is None else 48.0))
    rows = []
    for seed in seeds:
        zenith = np.radians((30.0, 50.0, 70.0)[seed % 3])
        sun, error, s_b = photograph(camera, scene, zenith, np.radians(tilt_deg), depth, seed)
        nees = float(s_b @ sun.information_b @ s_b) / 2.0
        rows.append((np.degrees(error), float(not sun.ok), nees, (error / sun.azimuth_sigma) ** 2))
    return rows


def summary(rows: list[tuple[float, ...]]) -> Row:
    errors, refused, nees, nees_azimuth = np.array(rows).T
    kept = refused == 0.0
    row: Row = {"images": len(rows), "refused": float(refused.mean())}
    if not kept.any():
        return row | dict.fromkeys(("median deg", "rmse deg", "worst deg", "nees/2", "nees azimuth"))
    e = np.abs(errors[kept])
    return row | {
        "median deg": float(np.median(e)),
        "rmse deg": float(np.sqrt(np.mean(e**2))),
        "worst deg": float(e.max()),
        "nees/2": float(nees[kept].mean()),
        "nees azimuth": float(nees_azimuth[kept].mean()),
    }


def noise_table(seeds: int) -> tuple[list[Row], list[Figure]]:
    tasks = [(noise, random, zenith, seeds) for noise, random, _ in NOISES for zenith in ZENITHS_DEG]
    found = dict(zip(tasks, _bench.in_processes(heading_errors, tasks), strict=True))
    rows: list[Row] = []
    figures = []
    for noise, random, limit in NOISES:
        means = {z: float(np.abs(found[noise, random, z, seeds][0]).mean()) for z in ZENITHS_DEG}
        voted = max(float(np.abs(found[noise, random, z, seeds][1]).mean()) for z in ZENITHS_DEG)
        name = f"{noise:g} deg" + (f" + {random:.0%} random" if random else "")
        rows.append({"AoP noise": name} | {f"sun {z}": e for z, e in means.items()} | {"vote alone, worst": voted})
        figures.append(Figure(f"mean heading error in deg, {name}", max(means.values()), limit))
    return rows, figures


def occluder_table(images: int) -> tuple[list[Row], list[Figure]]:
    cases = list(itertools.product([share for share, _ in SHARES], CLUTTERS, SHAPES))
    tasks = []
    for share, clutter, shape in cases:
        body = OccluderSettings(shape=shape, share=share, clutter=clutter, brightness=0.5, dop=0.5)
        tasks.append((Scene(wind=0.0, occluders=(body,)), None, 10.0, list(range(images))))
    results = dict(zip(cases, _bench.in_processes(rendered_errors, tasks), strict=True))
    rows: list[Row] = []
    figures = []
    for share, limit in SHARES:
        for clutter in CLUTTERS:
            all_shapes = [r for shape in SHAPES for r in results[share, clutter, shape]]
            rows.append({"hidden": f"{share:.0%}", "polarized": clutter} | summary(all_shapes))
        kept = [abs(r[0]) for c, rs in results.items() if c[0] == share for r in rs if not r[1]]
        figures.append(Figure(f"median heading error in deg, {share:.0%} hidden", float(np.median(kept)), limit))
    return rows, figures


def surface_table(images: int) -> list[Row]:
    """Clear water shows whether the surface is undone; what coastal water scatters into the view is not modelled."""
    sector = (OccluderSettings(shape="sector", share=0.4, brightness=0.05),)
    cases = [(0.0, CLEAR), *itertools.product((0.0, 3.0, 6.0), (COASTAL,))]
    cases_and_windows = list(itertools.product(cases, ((), sector)))
    tasks = [
        (Scene(wind=wind, occluders=hidden, sun=0.0, attenuation=c), 2.0, 4.0, list(range(images)))
        for (wind, c), hidden in cases_and_windows
    ]
    results = _bench.in_processes(rendered_errors, tasks)
    return [
        {"wind m/s": wind, "attenuation 1/m": c, "window": "40% hidden" if hidden else "whole"} | summary(rows)
        for ((wind, c), hidden), rows in zip(cases_and_windows, results, strict=True)
    ]


def main() -> None:
    parser = _bench.parser(__doc__)
    parser.add_argument("--seeds", type=int, default=100, help="skies for each cell of the first table")
    parser.add_argument("--images", type=int, default=6, help="images for each shape and clutter, and 2x under water")
    args: argparse.Namespace = parser.parse_args()
    noise, figures = noise_table(args.seeds)
    occluders, more = occluder_table(args.images)
    tables = {
        "mean heading error in deg, 20 000 e-vectors": noise,
        "rendered, occluders, tilt up to 10 deg": occluders,
        "rendered from under water": surface_table(2 * args.images),
    }
    _bench.finish(args, "polarization", tables, [*figures, *more])


if __name__ == "__main__":
    main()
