"""Heading from the sun against depth: the same rendered scenes under water through every optical method.

    python benchmarks/sun_depth.py [--scenes 12] [--depths 2 5 10 20 40] [--waters coastal clear]
                                   [--plot FILE.png] [--json] [--save]

Each scene has its own sun (zenith angle 30 to 60 degrees), sea (wind 3 m/s, swell 0.5 m), heading, roll and pitch (up
to 5 degrees, known to 0.3), and is seen at every depth by a fisheye that looks up and by a camera that looks level, 12
bits each. The automatic exposure ends at 5 ms, about 20 times what the clear zenith in air needs: the deep gets dark. A
burst is ten frames in 1 s. The scattering method turns the level camera to four headings.

``refused`` is the share of images that the method's own flags turned down; ``all`` asks them not. vote, plain and ring
are stages of their method without flags or covariance of their own: they are refused where it is. The gradient takes
the sun's height from the almanac, so that its height errs by nothing. Heading errors hold the vertical's: a tilt of 0.3
degrees across the sun is 0.3 degrees of heading with the sun at 45.

The published figures are of other instruments in other conditions: no limit is set by them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from _bench import Row, finish, in_processes, parser  # isort: skip
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture
from numpy.typing import NDArray

from uwgraph.camera.file import CameraFile
from uwgraph.camera.model import Camera
from uwgraph.errors import DataError
from uwgraph.frames import matrix_from_rph, wrap_pi
from uwgraph.simulate import ImageModel, Scene, Shot, render
from uwgraph.simulate.exposure import auto_scale, expose, mosaic
from uwgraph.sun.estimate import estimate_sun
from uwgraph.sun.gradient import GradientEstimate
from uwgraph.sun.observation import SunObservation, azimuth_in_level, up_from_tilt
from uwgraph.sun.polarization import PolarizationEstimate
from uwgraph.sun.view import View
from uwgraph.types import FloatArray

WATERS = {"coastal": (0.398, 0.55), "clear": (0.151, 0.25), "harbour": (2.19, 0.83)}
"""Beam attenuation [1/m] and share of scattering in it (Petzold 1972)."""
TANK_DEG, AT_SEA_DEG, AT_SEA_M = 0.69, 4.07, 5.0
PUBLISHED: list[Row] = [
    {"published": "polarization, water tank", "depth_m": None, "heading_deg": TANK_DEG, "what": "upper bound"},
    {"published": "polarization, vehicle at sea", "depth_m": AT_SEA_M, "heading_deg": AT_SEA_DEG, "what": "1 sigma"},
]
"""J. Mar. Sci. Eng. 11(8), 1603, 2023."""
UPWARD = Camera("fisheye", f=(110.0, 110.0), c=(127.5, 127.5), size=(256, 256))
LEVEL = Camera("fisheye", f=(105.0, 105.0), c=(63.5, 63.5), size=(128, 128),
               R_bs=np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))  # fmt: skip
YAWS = np.radians([0.0, 90.0, 180.0, 270.0])
BURST_S = np.arange(10) / 10.0
LONGEST_EXPOSURE = 20.0
TILT, TILT_SIGMA = np.radians([5.0, 0.3])
MODEL = ImageModel(bits=12)
TOO_FEW = 0.5
"""Share refused from which on a method is drawn as given up."""


@dataclass(frozen=True, eq=False)
class Situation:
    """One vehicle under one sun; angles in rad."""

    scene: Scene
    seed: int
    depth: float
    rph: FloatArray
    """True roll, pitch and heading."""
    tilt_known: FloatArray
    """Roll and pitch as the vehicle knows them."""
    sun_azimuth: float
    sun_zenith: float

    @classmethod
    def draw(cls, water: str, depth: float, seed: int) -> Situation:
        """The same for all waters and depths."""
        rng = np.random.default_rng([seed, 8])
        wind_from, swell_from = rng.uniform(0.0, 360.0, 2)
        attenuation, albedo = WATERS[water]
        scene = Scene(
            wind=3.0, wind_from_deg=wind_from, swell_height=0.5, swell_from_deg=swell_from,
            attenuation=attenuation, albedo=albedo,
        )  # fmt: skip
        rph = np.array([*rng.uniform(-TILT, TILT, 2), rng.uniform(-np.pi, np.pi)])
        known = rph[:2] + TILT_SIGMA * rng.standard_normal(2)
        return cls(scene, seed, depth, rph, known, rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(30.0, 60.0)))

    @property
    def s_l(self) -> FloatArray:
        level = np.sin(self.sun_zenith)
        return np.array([level * np.cos(self.sun_azimuth), level * np.sin(self.sun_azimuth), -np.cos(self.sun_zenith)])

    def R_lb(self, yaw: float = 0.0) -> FloatArray:
        return matrix_from_rph(self.rph + np.array([0.0, 0.0, yaw]))

    def view(self, camera: Camera) -> View:
        return View(
            camera, up_from_tilt(*self.tilt_known), n=self.scene.n, tilt_sigma=TILT_SIGMA, sun_zenith=self.sun_zenith
        )

    def stokes(self, camera: Camera, yaw: float = 0.0, t_s: float = 0.0) -> FloatArray:
        return render(self.scene, Shot(camera, self.R_lb(yaw), self.s_l, self.depth, t_s=t_s), self.seed)


@dataclass(frozen=True)
class Heading:
    """What one method made of one situation."""

    method: str
    error: float
    """Rad; NaN where nothing was found."""
    flags: tuple[str, ...]
    nees: float = float("nan")
    """Of the direction, over its two degrees of freedom; NaN where the method has no covariance."""
    nees_heading: float = float("nan")
    height_error: float = float("nan")
    """Of the sun, rad."""
    is_stage: bool = False
    """Whether the flags are those of the method that was built on it."""


def headings(water: str, depth: float, seed: int) -> list[Heading]:
    """Every method on one situation."""
    now = Situation.draw(water, depth, seed)
    frames = [now.stokes(UPWARD, t_s=float(t)) for t in BURST_S]
    level = [now.stokes(LEVEL, float(yaw)) for yaw in YAWS]
    rng = np.random.default_rng([seed, int(1000 * depth), 9])
    light = recorded([f[..., 0] for f in frames], rng)
    polarized = recorded([mosaic(f) for f in frames], rng)
    horizon = recorded([mosaic(f) for f in level], rng)
    bare = CameraFile(UPWARD, MODEL.sensor)
    upward, ahead = (CameraFile(camera, MODEL.sensor, mosaic="sony") for camera in (UPWARD, LEVEL))
    view = now.view(UPWARD)
    found: list[Heading] = []
    for when, count in (("", 1), (", burst", len(BURST_S))):
        found += stages(now, estimate_sun(polarized[:count], upward, view), when)
        found += stages(now, estimate_sun(light[:count], bare, view), when)
    method = "scattering, 4 headings"
    try:
        scattered = estimate_sun(horizon, ahead, now.view(LEVEL), "scattering", YAWS)
    except DataError:  # no part of the image is lit
        return [*found, Heading(method, np.nan, ("dark",))]
    return [*found, judged(now, method, scattered.observation)]


def recorded(radiance: list[FloatArray], rng: np.random.Generator) -> list[NDArray[Any]]:
    """Counts of images taken with one exposure, which is set by the first."""
    sensor = MODEL.sensor
    scale = auto_scale(radiance[0], sensor.white, most=LONGEST_EXPOSURE * sensor.white)
    return [expose(x, sensor, scale, MODEL.bits, rng) for x in radiance]


def stages(now: Situation, found: Any, when: str) -> Iterator[Heading]:
    """The method's result after the stages it was built on."""
    sun = found.observation
    if isinstance(found, PolarizationEstimate):
        vote = found.solution.vote if found.solution is not None else None
        yield stage(now, "polarization vote" + when, vote.azimuth if vote is not None else np.nan, sun)
        yield judged(now, "polarization eigen" + when, sun)
    elif isinstance(found, GradientEstimate):
        for name, result in (("plain", found.plain), ("ring", found.ring)):
            azimuth = float(azimuth_in_level(result.s, sun.up_b)) if result is not None else np.nan
            yield stage(now, f"gradient {name}{when}", azimuth, sun)
        yield judged(now, "gradient chosen" + when, sun)


def stage(now: Situation, method: str, azimuth_b: float, sun: SunObservation) -> Heading:
    """A heading from an azimuth of the sun in the levelled body, with the flags of the final observation."""
    return Heading(method, float(wrap_pi(now.sun_azimuth - azimuth_b - now.rph[2])), sun.flags.names(), is_stage=True)


def judged(now: Situation, method: str, sun: SunObservation) -> Heading:
    """A heading with its covariance against the truth."""
    error = float(wrap_pi(sun.heading(now.sun_azimuth) - now.rph[2]))
    s_b = now.R_lb().T @ now.s_l
    nees = float(s_b @ sun.information_b @ s_b) / 2.0
    sigma = np.hypot(sun.azimuth_sigma, TILT_SIGMA / np.tan(now.sun_zenith))
    height_error = sun.elevation - (np.pi / 2.0 - now.sun_zenith)
    return Heading(method, error, sun.flags.names(), nees, (error / sigma) ** 2, height_error)


def summary(water: str, depth: float, method: str, found: list[Heading]) -> Row:
    """One row of the table."""
    error = np.degrees([h.error for h in found])
    kept = [not h.flags for h in found]
    found_at_all = error[np.isfinite(error)]
    accepted = [h for h in found if not h.flags]
    return {
        "water": water,
        "depth_m": depth,
        "method": method,
        "images": len(found),
        "refused": 1.0 - float(np.mean(kept)),
        "rmse_deg": rms(error[kept]),
        "median_deg": median(np.abs(error[kept])),
        "rmse_all_deg": rms(found_at_all),
        "median_all_deg": median(np.abs(found_at_all)),
        "height_rmse_deg": round(rms(np.degrees([h.height_error for h in accepted])), 9),
        "nees/2": mean([h.nees for h in accepted]),
        "nees_heading": mean([h.nees_heading for h in accepted]),
    }


def rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2))) if len(x) else float("nan")


def median(x: FloatArray) -> float:
    return float(np.median(x)) if len(x) else float("nan")


def mean(x: list[float]) -> float:
    return float(np.mean(x)) if x else float("nan")


def refusals(found: dict[tuple[str, float], list[list[Heading]]]) -> list[Row]:
    """Which flags turned how many images down."""
    rows = []
    for (water, depth), scenes in found.items():
        for same in zip(*scenes, strict=True):
            raised = [flag for h in same for flag in h.flags]
            if raised and not same[0].is_stage:
                counts = ", ".join(f"{flag} {raised.count(flag)}" for flag in sorted(set(raised)))
                rows.append({"water": water, "depth_m": depth, "method": same[0].method, "flags": counts})
    return rows


def draw(rows: list[Row], waters: list[str], file: Path) -> None:
    """Heading RMSE against depth, one panel for each water; hollow where most images were refused."""
    picture = Picture(figsize=(6.5 * len(waters), 5.5), layout="constrained")
    axes = picture.subplots(1, len(waters), sharey=True, squeeze=False)[0]
    for ax, water in zip(axes, waters, strict=True):
        panel(ax, [r for r in rows if r["water"] == water])
        ax.set_title(f"{water} water, c = {WATERS[water][0]:g} /m")
    axes[0].set_ylabel("heading RMSE [deg], images not refused (hollow: most were)")
    axes[-1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    picture.savefig(file, dpi=130)


COLOURS = {"polarization": "#1f5fa8", "gradient": "#d1722b", "scattering": "#3a8a4d"}
DEGREES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
DASHES = {"eigen": "-", "chosen": "-", "vote": ":", "plain": ":", "ring": "--"}


def panel(ax: Axes, rows: list[Row]) -> None:
    for method in dict.fromkeys(r["method"] for r in rows):
        mine = [r for r in rows if r["method"] == method]
        depth, rmse = (np.array([r[key] for r in mine]) for key in ("depth_m", "rmse_deg"))
        family, stage_ = method.split(",")[0].partition(" ")[::2]
        burst = "burst" in method
        style: dict[str, Any] = {
            "color": COLOURS[family],
            "linestyle": DASHES.get(stage_, "-"),
            "alpha": 1.0 if burst else 0.45,
        }
        ax.plot(depth, rmse, linewidth=2.0 if burst else 1.2, label=method, **style)
        given_up = np.array([r["refused"] for r in mine]) >= TOO_FEW
        for mask, face in ((given_up, "white"), (~given_up, COLOURS[family])):
            ax.plot(depth[mask], rmse[mask], "o", markersize=5, markerfacecolor=face, markeredgecolor=COLOURS[family])
    ax.axhline(TANK_DEG, color="#555555", linewidth=0.8, linestyle="-.", label="published: tank")
    ax.plot(AT_SEA_M, AT_SEA_DEG, "k*", markersize=11, label="published: at sea, 5 m")
    ax.set(xscale="log", yscale="log", xlabel="depth [m]")
    ticks = sorted({r["depth_m"] for r in rows})
    ax.set_xticks(ticks, [f"{d:g}" for d in ticks])
    ax.set_yticks(DEGREES, [f"{e:g}" for e in DEGREES])
    ax.minorticks_off()
    ax.grid(alpha=0.3)


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--scenes", type=int, default=12, help="for each water and depth")
    arguments.add_argument("--depths", type=float, nargs="+", default=[2.0, 5.0, 10.0, 20.0, 40.0], help="m")
    arguments.add_argument("--waters", nargs="+", choices=list(WATERS), default=["coastal", "clear"])
    arguments.add_argument("--plot", type=Path, help="write a PNG")
    args = arguments.parse_args()
    cases = [(water, depth) for water in args.waters for depth in args.depths]
    results = iter(in_processes(headings, [(*case, seed) for case in cases for seed in range(args.scenes)]))
    found = {case: [next(results) for _ in range(args.scenes)] for case in cases}
    rows = [
        summary(water, depth, same[0].method, list(same))
        for (water, depth), scenes in found.items()
        for same in zip(*scenes, strict=True)
    ]
    if args.plot:
        draw(rows, args.waters, args.plot)
    tables: dict[str, list[Row]] = {"heading from the sun under water": rows, "published": PUBLISHED}
    if why := refusals(found):
        tables["flags"] = why
    finish(args, "sun_depth", tables)


if __name__ == "__main__":
    main()
