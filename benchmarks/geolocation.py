"""Where a vehicle is, from the polarization of the water over one day.

    python benchmarks/geolocation.py [--latitudes 10 35 60] [--days 12] [--json] [--save]

Every half hour that the sun is above 10 degrees, a camera looks around the horizon at 36 headings. The light it sees is
simulated: the sun's, whose beam the waves throw about, and skylight besides, both scattered once, with polarization
lost to multiple scattering and the camera's own diattenuation and offset. AoP noise is 2 degrees, the headings are good
to 0.5 degrees each and 0.3 degrees in common. The fit knows only the sun's beam. What it misses is learnt on other days
at a known place, 30 degrees north. The same data go through all losses, with and without the learnt correction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from _bench import Figure, Row, finish, in_processes, parser  # isort: skip
import numpy as np

from uwgraph.frames import wrap_pi
from uwgraph.simulate.sky import CIE_SKIES
from uwgraph.sun.ephemeris import sun_azimuth_elevation
from uwgraph.sun.geolocation import Fix, locate
from uwgraph.sun.residual_model import ResidualModel
from uwgraph.sun.scattering import aop, dolp, scattered_stokes
from uwgraph.sun.scattering_fit import fit_sun, learn_residuals
from uwgraph.sun.sweep import Sweep
from uwgraph.types import FloatArray

LOSSES: tuple[Literal["l1", "l2", "huber"], ...] = ("l1", "l2", "huber")
DEFAULT = ("huber", True)
PUBLISHED_KM = 61.0
LEARNT_AT, LEARNT_DAYS = (np.radians(30.0), np.radians(-60.0)), (20, 80, 140, 200, 260, 320)
VIEWS = np.radians(np.arange(0.0, 360.0, 10.0))
N_WATER = 1.34
NOISE, HEADING_SIGMA, OFFSET_SIGMA, WAVES = np.radians([2.0, 0.5, 0.3, 0.7])
NEW_YEAR_NS = 1_767_225_600 * 10**9  # 2026
DAY_NS = 86_400 * 10**9
EARTH_M = 6_371_000.0


@dataclass(frozen=True)
class Water:
    """What a day's light has besides the sun's beam."""

    skylight: float
    """Diffuse light from the whole sky over the sun's, on a surface that faces it, with the sun in the zenith."""
    max_dolp: float
    diattenuation: float = 0.02
    """Of the camera, along the horizontal."""
    offset: float = float(np.radians(0.7))
    """Of the analyser's axis, rad."""

    @classmethod
    def of(cls, rng: np.random.Generator) -> Water:
        return cls(skylight=0.15 * rng.uniform(0.8, 1.25), max_dolp=rng.uniform(0.65, 0.8))

    def aop_dolp(self, azimuth: float, zenith: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """AoP and degree of polarization at VIEWS, under a sun at ``azimuth`` (from the bow) and ``zenith``."""
        around = azimuth + WAVES * rng.standard_normal() / np.sin(zenith), zenith + WAVES * rng.standard_normal()
        S = scattered_stokes(*around, VIEWS, 0.0, N_WATER, self.max_dolp)
        sky_azimuth, sky_zenith, share = skylight(azimuth, zenith)
        diffuse = scattered_stokes(sky_azimuth, sky_zenith, VIEWS, 0.0, N_WATER, self.max_dolp)
        S = S + self.skylight / np.sqrt(np.cos(zenith)) * np.einsum("k,knj->nj", share, diffuse)
        S[:, 1] += self.diattenuation * S[:, 0]
        return aop(S) + self.offset + NOISE * rng.standard_normal(len(VIEWS)), dolp(S)


def skylight(azimuth: float, zenith: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions (K, 1) of a sky that is clear (CIE type 12), and their shares (K,) of its light."""
    z, a = (x.ravel() for x in np.meshgrid(np.radians(np.arange(5.0, 90.0, 10.0)), np.radians(np.arange(0, 360, 20.0))))
    gamma = np.arccos(np.cos(z) * np.cos(zenith) + np.sin(z) * np.sin(zenith) * np.cos(a))
    share = CIE_SKIES[12].relative_radiance(np.cos(z), gamma, zenith) * np.sin(z)
    return (azimuth + a)[:, None], z[:, None], share / share.sum()


def sweeps_of(day: int, lat: float, lon: float, rng: np.random.Generator) -> tuple[list[Sweep], FloatArray, FloatArray]:
    """A day's sweeps, the true headings, and the sun's true azimuth and zenith angle, (N, 2)."""
    t_ns = NEW_YEAR_NS + day * DAY_NS + np.arange(0, DAY_NS, 1_800 * 10**9)
    azimuth, elevation = sun_azimuth_elevation(t_ns, lat, lon)
    lit = elevation > np.radians(10.0)
    heading = rng.uniform(-np.pi, np.pi, int(lit.sum()))
    water = Water.of(rng)
    sweeps = []
    for t, a, e, h in zip(t_ns[lit], azimuth[lit], elevation[lit], heading, strict=True):
        angles, degrees = water.aop_dolp(a - h, np.pi / 2 - e, rng)
        sigma = np.full(len(VIEWS), NOISE)
        sweeps.append(Sweep(VIEWS, np.zeros(len(VIEWS)), angles, sigma, degrees, n=N_WATER, t_ns=int(t)))
    return sweeps, heading, np.stack([azimuth[lit], np.pi / 2 - elevation[lit]], axis=1)


def learnt() -> ResidualModel:
    rng = np.random.default_rng(1)
    sweeps, suns = [], []
    for day in LEARNT_DAYS:
        seen, heading, sun = sweeps_of(day, *LEARNT_AT, rng)
        sweeps += seen
        suns += [(float(a - h), float(z)) for (a, z), h in zip(sun, heading, strict=True)]
    return learn_residuals(sweeps, suns)


def one_day(correction: ResidualModel, latitude_deg: float, seed: int) -> list[Row]:
    """The errors of one day by every loss, with and without the correction."""
    rng = np.random.default_rng([seed, round(10 * latitude_deg)])
    lat, lon = np.radians(latitude_deg), rng.uniform(-np.pi, np.pi)
    day = int(rng.integers(80, 266)) if abs(latitude_deg) > 50.0 else int(rng.integers(0, 365))
    sweeps, heading, suns = sweeps_of(day, lat, lon, rng)
    measured = heading + HEADING_SIGMA * rng.standard_normal(len(heading)) + OFFSET_SIGMA * rng.standard_normal()
    rows = []
    for loss in LOSSES:
        for corrected in (False, True):
            fits = [fit_sun(s, loss=loss, residual_model=correction if corrected else None) for s in sweeps]
            observed = [fit.observation for fit in fits]
            fix = locate(observed, measured, heading_sigma=HEADING_SIGMA, offset_sigma=OFFSET_SIGMA, loss=loss)
            turn = wrap_pi([o.azimuth_b + h for o, h in zip(observed, heading, strict=True)] - suns[:, 0])
            lift = np.array([np.pi / 2 - o.elevation for o in observed]) - suns[:, 1]
            rows.append(
                {"latitude": latitude_deg, "loss": loss, "corrected": corrected, "refused": not fix.ok}
                | errors(fix, lat, lon)
                | {"azimuth_deg": float(np.degrees(np.median(np.abs(turn))))}
                | {"zenith_deg": float(np.degrees(np.median(np.abs(lift))))}
            )
    return rows


def errors(fix: Fix, lat: float, lon: float) -> dict[str, Any]:
    d = EARTH_M * np.array([fix.lat - lat, float(wrap_pi(fix.lon - lon)) * np.cos(lat)])
    return {"error_km": float(np.hypot(*d)) / 1e3, "nees_2": float(d @ np.linalg.solve(fix.cov_ne, d)) / 2.0}


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--latitudes", type=float, nargs="+", default=[10.0, 35.0, 60.0], help="degrees")
    options.add_argument("--days", type=int, default=12, help="days at each latitude, each at another longitude")
    args = options.parse_args()
    correction = learnt()
    days = in_processes(one_day, [(correction, lat, seed) for lat in args.latitudes for seed in range(args.days)])
    every = [row for rows in days for row in rows]
    table: list[Row] = []
    figures: list[Figure] = []
    for latitude in args.latitudes:
        for loss in LOSSES:
            for corrected in (False, True):
                mine = [r for r in every if (r["latitude"], r["loss"], r["corrected"]) == (latitude, loss, corrected)]
                column = {key: np.array([r[key] for r in mine]) for key in mine[0]}
                table.append(
                    {
                        "latitude_deg": latitude,
                        "loss": loss,
                        "correction": "learnt" if corrected else "none",
                        "median_km": float(np.median(column["error_km"])),
                        "p90_km": float(np.quantile(column["error_km"], 0.9)),
                        "nees_2_mean": float(column["nees_2"].mean()),
                        "nees_2_median": float(np.median(column["nees_2"])),
                        "sun_azimuth_deg": float(np.median(column["azimuth_deg"])),
                        "sun_zenith_deg": float(np.median(column["zenith_deg"])),
                        "refused": int(column["refused"].sum()),
                    }
                )
                if (loss, corrected) == DEFAULT:
                    at = f"at {latitude:g} deg"
                    figures.append(Figure(f"median position error {at} [km]", table[-1]["median_km"], PUBLISHED_KM))
                    figures.append(Figure(f"NEES / 2 {at}, mean", table[-1]["nees_2_mean"], 1.5))
    finish(args, "geolocation", {"one day": table}, figures)


if __name__ == "__main__":
    main()
