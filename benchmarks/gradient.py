"""The gradient of the light in simulation: nine clear skies, waves, and skies that the model does not describe.

    python benchmarks/gradient.py [--scenes 12] [--depth 5] [--wind 3] [--json] [--save]

1. A clear sky (CIE S 011 type 12) without noise or disc, in air: all of it, a quarter and half of it dark, the sun at
   30, 50 and 70 degrees from the zenith, the hidden sector in four places: the worst error of the plain form, the ring
   form and the result (the additive form).
2. Under waves: one image is the mean of 10, taken at 10 Hz by a 12-bit sensor; the sun's height not known. Heading RMSE
   and NEES (over the degrees of freedom) of azimuth and of direction.
3. Skies that are not f(angle from the sun) h(zenith angle): broken cloud, and a polarized sky through Fresnel, whole
   and with occluders: at most 1 degree, or refused.

The renderer is ``uwgraph.simulate``: it shares nothing with the estimator but the camera's calibration.
"""

from __future__ import annotations

from _bench import Figure, Row, finish, in_processes, parser

# isort: split
from dataclasses import replace

import numpy as np

from uwgraph.camera.model import Camera
from uwgraph.camera.sensor import Sensor
from uwgraph.simulate.exposure import auto_scale, expose
from uwgraph.simulate.render import Shot, render
from uwgraph.simulate.scene import OccluderSettings, Scene
from uwgraph.sun.gradient import GradientEstimate, estimate
from uwgraph.sun.observation import azimuth_in_level
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

UP = np.array([0.0, 0.0, -1.0])
SENSOR = Sensor(white=0.98 * 4095.0, gain=2.4, read_noise=3.0)
FRAMES = 10
CLEAR = Scene(sun=0.0, wind=0.0, vignetting=0.0)


def fisheye(view_deg: float, pixels: int = 256) -> Camera:
    f, c = pixels / np.radians(view_deg), (pixels - 1) / 2.0
    return Camera("fisheye", (f, f), (c, c), (pixels, pixels))


AIR, WATER = fisheye(160.0), fisheye(110.0)


def sun_at(azimuth: float, zenith_deg: float) -> FloatArray:
    z = np.radians(zenith_deg)
    return np.array([np.sin(z) * np.cos(azimuth), np.sin(z) * np.sin(azimuth), -np.cos(z)])


def azimuth_error(s_b: FloatArray, truth: FloatArray) -> float:
    d = np.degrees(azimuth_in_level(s_b, UP) - azimuth_in_level(truth, UP))
    return float((d + 180.0) % 360.0 - 180.0)


def look(scene: Scene, s: FloatArray, depth: float | None, seed: int, frames: int) -> GradientEstimate:
    """Render, expose, average and estimate."""
    camera, rng, mean = AIR if depth is None else WATER, np.random.default_rng(seed), 0.0
    scale = 0.0
    for i in range(frames):
        light = render(scene, Shot(camera, np.eye(3), s, depth, t_s=0.1 * i), seed)[..., 0]
        scale = scale or auto_scale(light, 4095.0)
        mean = mean + expose(light, SENSOR, scale, 12, rng) / frames
    sensor = replace(SENSOR, gain=frames * SENSOR.gain, read_noise=np.sqrt(frames) * SENSOR.read_noise)
    return estimate(mean, View(camera, n=1.0 if depth is None else scene.n), sensor)


def nine(hidden: float, zenith: float) -> Row:
    s = sun_at(1.0, zenith)
    light = render(CLEAR, Shot(AIR, np.eye(3), s))[..., 0]
    light = light * 3000.0 / np.quantile(light, 0.99)
    azimuth = azimuth_in_level(View(AIR).sky_rays(), UP).reshape(light.shape)
    worst = dict.fromkeys(("plain_azimuth", "plain_zenith", "ring_azimuth", "ring_zenith", "azimuth", "zenith"), 0.0)
    flags = set()
    for start in (0.0, 1.57, 3.14, 4.71) if hidden else (0.0,):
        dark = np.mod(azimuth - start, 2.0 * np.pi) < 2.0 * np.pi * hidden
        found = estimate(np.where(dark, 0.0, light), View(AIR), SENSOR)
        flags.update(found.observation.flags.names())
        for name, result in (("plain_", found.plain), ("ring_", found.ring), ("", found.fit)):
            heights = (np.degrees(np.arccos(np.clip(x @ UP, -1.0, 1.0))) for x in (result.s, s))
            errors = azimuth_error(result.s, s), next(heights) - next(heights)
            for key, error in zip(("azimuth", "zenith"), errors, strict=True):
                worst[name + key] = max(worst[name + key], abs(float(error)))
    return {"hidden": hidden, "sun_zenith": zenith, **worst, "flags": " ".join(sorted(flags))}


def trial(scene: Scene, zenith: float, depth: float | None, seed: int, frames: int) -> Row:
    s = sun_at(np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi), zenith)
    o = look(scene, s, depth, seed, frames).observation
    d = o.s_b - s
    e = azimuth_error(o.s_b, s)
    return {
        "ok": o.ok,
        "error": e,
        "nees_azimuth": (e / np.degrees(o.azimuth_sigma)) ** 2,
        "nees": float(d @ o.information_b @ d) / 2.0,
        "sigma": float(np.degrees(o.azimuth_sigma)),
    }


def summary(name: str, zenith: str, trials: list[Row]) -> Row:
    used = [t for t in trials if t["ok"]]

    def mean(key: str) -> float:
        return float(np.mean([t[key] for t in used])) if used else float("nan")

    errors = np.array([t["error"] for t in used]) if used else np.zeros(1)
    return {
        "sky": name,
        "sun_zenith": zenith,
        "images": len(trials),
        "refused": len(trials) - len(used),
        "heading_rmse": float(np.sqrt((errors**2).mean())),
        "worst": float(np.abs(errors).max()),
        "sigma": mean("sigma"),
        "nees_azimuth": mean("nees_azimuth"),
        "nees": mean("nees"),
    }


def strange_skies() -> dict[str, tuple[Scene, float | None]]:
    calm = Scene(wind=0.0)
    hull = (OccluderSettings(share=0.4),)
    return {
        "air, cloud 20 %": (calm.model_copy(update={"clouds": 0.2}), None),
        "air, cloud 50 %": (calm.model_copy(update={"clouds": 0.5}), None),
        "air, cloud 80 %": (calm.model_copy(update={"clouds": 0.8}), None),
        "air, 40 % hidden": (calm.model_copy(update={"occluders": hull}), None),
        "3 m, polarized sky": (calm.model_copy(update={"sun": 0.0}), 3.0),
        "3 m, polarized sky, 40 % hidden": (calm.model_copy(update={"sun": 0.0, "occluders": hull}), 3.0),
        "3 m, cloud 30 %": (calm.model_copy(update={"clouds": 0.3}), 3.0),
        "3 m, cloud 60 %": (calm.model_copy(update={"clouds": 0.6}), 3.0),
    }


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--scenes", type=int, default=12, help="of waves, for each height of the sun")
    options.add_argument("--depth", type=float, default=5.0, help="m, of the waves' table")
    options.add_argument("--wind", type=float, default=3.0, help="m/s")
    args = options.parse_args()
    clear = [nine(hidden, zenith) for hidden in (0.0, 0.25, 0.5) for zenith in (30.0, 50.0, 70.0)]

    windy, waves = Scene(wind=args.wind), []
    for zenith in (30.0, 45.0, 60.0):
        tasks = [(windy, zenith, args.depth, seed, FRAMES) for seed in range(args.scenes)]
        waves.append(summary(f"{args.depth:g} m, wind {args.wind:g} m/s", f"{zenith:g}", in_processes(trial, tasks)))
    strange = []
    for name, (scene, depth) in strange_skies().items():
        tasks = [(scene, z, depth, seed, 1) for z in (30.0, 50.0, 70.0) for seed in range(4)]
        strange.append(summary(name, "30 50 70", in_processes(trial, tasks)))
    finish(
        args,
        "gradient",
        {"clear sky without noise, worst of four, deg": clear, "waves, deg": waves, "other skies, deg": strange},
        [
            Figure("clear sky, heading, deg", max(r["azimuth"] for r in clear), 0.1),
            Figure("clear sky, refused", float(sum(bool(r["flags"]) for r in clear)), 0.0),
            Figure("waves, heading RMSE, deg", max(r["heading_rmse"] for r in waves), 1.0),
            Figure("waves, refused", float(sum(r["refused"] for r in waves)), 0.0),
            Figure("waves, mean NEES of azimuth, at most", float(np.mean([r["nees_azimuth"] for r in waves])), 2.0),
            Figure("the same, at least", float(np.mean([r["nees_azimuth"] for r in waves])), 0.3, at_least=True),
            Figure("waves, mean NEES of direction", float(np.mean([r["nees"] for r in waves])), 2.0),
            *(Figure(f"worst heading, {r['sky']}, deg", r["worst"], 1.0) for r in strange),
        ],
    )


if __name__ == "__main__":
    main()
