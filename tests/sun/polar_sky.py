"""Ideal skies for the tests of polarization: e-vectors and images, made without the code under test."""

from __future__ import annotations

import numpy as np

from uwgraph.camera.model import Camera
from uwgraph.camera.sensor import Sensor
from uwgraph.frames import matrix_from_rph
from uwgraph.simulate.exposure import auto_scale, behind_polarizer, expose
from uwgraph.simulate.render import Shot, render
from uwgraph.simulate.scene import Scene
from uwgraph.sun.eigen import Evectors
from uwgraph.sun.observation import up_from_tilt
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

UP = np.array([0.0, 0.0, -1.0])
CLEAR = Scene(neutral_deg=0.0, sun=0.0, wind=0.0, vignetting=0.0)
SENSOR = Sensor(white=4000.0, gain=2.5, read_noise=3.0)
POLARIZERS = np.radians([0.0, 45.0, 90.0, 135.0])


def sun_at(azimuth: float, zenith: float) -> FloatArray:
    """Unit vector in a level NED or FRD frame; azimuth from x towards y, rad."""
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), -np.cos(zenith)])


def evectors(
    rng: np.random.Generator,
    s_b: FloatArray,
    noise: float,
    count: int = 4000,
    half_field: float = 0.6,
    random: float = 0.0,
) -> Evectors:
    """E-vectors about the zenith of a level body, with Gaussian noise [rad] and a share of random angles."""
    height, turn = rng.uniform(np.cos(half_field), 1.0, count), rng.uniform(-np.pi, np.pi, count)
    flat = np.sqrt(1.0 - height**2)
    a_b = np.stack([flat * np.cos(turn), flat * np.sin(turn), -height], axis=1)
    e_b = np.cross(a_b, s_b)
    e_b /= np.linalg.norm(e_b, axis=1)[:, None]
    angle = np.where(
        rng.random(count) < random, rng.uniform(-1.5708, 1.5708, count), noise * rng.standard_normal(count)
    )
    e_b = np.cos(angle)[:, None] * e_b + np.sin(angle)[:, None] * np.cross(a_b, e_b)
    return Evectors(a_b, e_b, np.full(count, max(noise, 1e-4)), np.arange(count))


def fisheye(side: int = 96, half_field_deg: float = 50.0, **more: object) -> Camera:
    f = side / 2.0 / np.radians(half_field_deg)
    return Camera("fisheye", (f, f), ((side - 1) / 2.0,) * 2, (side, side), **more)  # type: ignore[arg-type]


def photograph(
    camera: Camera,
    rph: tuple[float, float, float],
    s_n: FloatArray,
    scene: Scene = CLEAR,
    depth: float | None = None,
    seed: int | None = 0,
) -> tuple[list[np.ndarray], View]:
    """Four channels (0, 45, 90, 135 deg) of a rendered sky, and the view; ``seed`` None for no noise."""
    stokes = render(scene, Shot(camera, matrix_from_rph(np.array(rph)), s_n, depth=depth), seed=seed or 0)
    light = [behind_polarizer(stokes, float(beta)) for beta in POLARIZERS]
    scale = auto_scale(np.stack(light), 4096.0)
    rng = None if seed is None else np.random.default_rng(seed)
    n = 1.0 if depth is None else scene.n
    view = View(camera, up_from_tilt(*rph[:2]), n=n, sun_zenith=float(np.arccos(-s_n[2])))
    return [expose(x, SENSOR, scale, 12, rng) for x in light], view
