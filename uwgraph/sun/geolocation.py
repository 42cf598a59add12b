"""Latitude and longitude from directions of the sun over time.

One direction is two numbers and so a place; a day of them is a place with a covariance. A global grid of places finds
where to start, and a robust least squares on the sphere ends the search (Powell, Garnett, Marshall & Rizk, Science
Robotics 3, 2018). One degree of the sun is 111 km.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from uwgraph.errors import DataError
from uwgraph.frames import WGS84, R_n_local, wrap_pi
from uwgraph.sun.ephemeris import sun_azimuth_elevation, sun_direction_n
from uwgraph.sun.m_estimate import Estimate, Loss, grouped_cov, m_estimate, robust_cost
from uwgraph.sun.observation import SunObservation, azimuth_in_level, level_axes
from uwgraph.types import FloatArray, Origin, TimeArray

GRID_STEP: Final = np.radians(5.0)
GRID_SIGMA: Final = np.radians(3.0)
"""What a place of the grid may miss the sun by, rad."""
GRID_OBSERVATIONS: Final = 60
TOGETHER_NS: Final = 3600 * 10**9
"""Observations within an hour are taken to err together."""
AMBIGUOUS_BELOW: Final = 4.5
"""Difference of the costs (half a chi-square) that tells two places apart: three sigmas."""
APART: Final = np.radians(10.0)
"""Two places nearer than this are one."""
FREE_OFFSET: Final = np.radians(5.0)
"""Where the heading is not known better, the grid takes the offset that suits each place."""


class FixFlag(IntFlag):
    """Why a fix must not be used; 0 when it may."""

    AMBIGUOUS = 1
    """Another place explains the sun about as well."""
    UNCERTAIN = 2
    """A 1-sigma of 1000 km or more: the sun hardly moved, or the heading's offset is not known."""
    MISFIT = 4
    """The residuals are far above the stated noise."""
    NOT_CONVERGED = 8

    def names(self) -> tuple[str, ...]:
        """Lower-case names of the flags that are set."""
        return tuple(str(flag.name).lower() for flag in FixFlag if flag in self)


@dataclass(frozen=True, eq=False)
class Fix:
    """A place from the sun."""

    lat: float
    """Geodetic, rad."""
    lon: float
    cov_ne: FloatArray
    """Covariance north and east, m^2, shape (2, 2)."""
    heading_offset: float
    """Constant to be added to the given headings, beyond the declination, rad."""
    heading_offset_sigma: float
    residuals: FloatArray
    """Observed less predicted sun, across (growing azimuth) and along (growing elevation), in sigmas, shape (N, 2)."""
    used: TimeArray
    """Positions, in the sequence given, of the N observations that were used."""
    scale: float
    """Robust size of the residuals: 1 when the stated noise is right."""
    flags: FixFlag
    other: tuple[float, float] | None
    """Latitude and longitude [rad] of the second place, where two compete."""

    @property
    def ok(self) -> bool:
        return self.flags == 0


def locate(
    observations: Sequence[SunObservation],
    heading: ArrayLike,
    *,
    declination: float = 0.0,
    heading_sigma: float = 0.0,
    offset_sigma: float = 0.0,
    loss: Loss = "huber",
) -> Fix:
    """The place from which the sun was seen; flagged observations are left out.

    Parameters
    ----------
    heading : array_like, shape (N,)
        Of the bow at each observation, clockwise from north, rad.
    declination : float
        Of magnetic north, east positive, rad, where ``heading`` is magnetic.
    heading_sigma : float
        1-sigma of each heading, independent of the others, rad.
    offset_sigma : float
        1-sigma of a constant error of all headings, rad: 0 for none, infinite where it is not known at all. It is
        estimated along.

    Raises
    ------
    DataError
        When no observation can be used, or the headings do not match.
    """
    sights = _Sights.of(observations, heading, declination, heading_sigma, offset_sigma)
    fits = [sights.fit(start, loss) for start in sights.starts()]
    scale = min(fit.scale for fit in fits)
    cost = [float(robust_cost(fit.residuals, scale, loss)) for fit in fits]
    best, least = fits[int(np.argmin(cost))], min(cost)
    rivals = [f for f, c in zip(fits, cost, strict=True) if c - least < AMBIGUOUS_BELOW and _arc(f.x, best.x) > APART]

    lat, lon, offset = (float(value) for value in best.x)
    cov = grouped_cov(best, sights.hour)
    metres = np.diag(_radii(lat))
    cov_ne = metres @ cov[:2, :2] @ metres
    flags = FixFlag(0)
    if rivals:
        flags |= FixFlag.AMBIGUOUS
    if not np.linalg.eigvalsh(cov_ne)[-1] < 1e6**2 or np.linalg.matrix_rank(best.curvature) < len(cov):
        flags |= FixFlag.UNCERTAIN
    if best.scale > 5.0:
        flags |= FixFlag.MISFIT
    if not best.converged:
        flags |= FixFlag.NOT_CONVERGED
    return Fix(
        lat=lat,
        lon=lon,
        cov_ne=cov_ne,
        heading_offset=offset,
        heading_offset_sigma=float(np.sqrt(cov[2, 2])) if len(cov) == 3 else 0.0,
        residuals=best.residuals[: len(sights.t_ns)],
        used=sights.used,
        scale=best.scale,
        flags=flags,
        other=(float(rivals[0].x[0]), float(rivals[0].x[1])) if rivals else None,
    )


@dataclass(frozen=True, eq=False)
class _Sights:
    """Suns in local axes, as far as the headings go."""

    t_ns: TimeArray
    azimuth: FloatArray
    """From north, by the headings given, rad."""
    elevation: FloatArray
    whitener: FloatArray
    """Inverse square root of the covariance across and along, shape (N, 2, 2)."""
    offset_sigma: float
    used: TimeArray

    @classmethod
    def of(
        cls,
        observations: Sequence[SunObservation],
        heading: ArrayLike,
        declination: float,
        heading_sigma: float,
        offset_sigma: float,
    ) -> _Sights:
        heading = np.atleast_1d(np.asarray(heading, dtype=np.float64))
        if heading.shape != (len(observations),):
            raise DataError(
                f"{heading.size} headings for {len(observations)} observations",
                where="heading",
                remedy="give one heading for each observation",
            )
        usable = [o.ok and o.t_ns > 0 and bool(np.isfinite(heading[i])) for i, o in enumerate(observations)]
        used = np.flatnonzero(usable)
        if not len(used):
            raise DataError(
                "no observation can be used: all are flagged, or have no time or heading",
                where="sun observations",
                remedy="look at the flags",
            )
        chosen = [o for o, use in zip(observations, usable, strict=True) if use]
        azimuth = np.array([azimuth_in_level(o.s_b, o.up_b) for o in chosen]) + heading[used] + declination
        elevation = np.array([o.elevation for o in chosen])
        cov = np.array([_across_along(o) for o in chosen])
        cov[:, 0, 0] += (heading_sigma * np.cos(elevation)) ** 2
        whitener = np.linalg.inv(np.linalg.cholesky(cov))
        return cls(np.array([o.t_ns for o in chosen]), azimuth, elevation, whitener, offset_sigma, used)

    @property
    def hour(self) -> NDArray[np.intp]:
        """Number of the hour of each observation."""
        return np.asarray((self.t_ns - self.t_ns.min()) // TOGETHER_NS, dtype=np.intp)

    def residuals(self, places: Sequence[FloatArray]) -> FloatArray:
        """Whitened, shape (K, N, 2), of places (latitude, longitude, heading offset); the last row is the prior."""
        x = np.array(places)
        lat, lon, offset = x[:, :1], x[:, 1:2], x[:, 2:]
        shape = (len(x), len(self.t_ns))
        t = np.broadcast_to(self.t_ns, shape).ravel()
        azimuth, elevation = sun_azimuth_elevation(t, np.repeat(lat, shape[1]), np.repeat(lon, shape[1]))
        r = _sphere_difference(azimuth.reshape(shape), elevation.reshape(shape), self.azimuth + offset, self.elevation)
        r = np.einsum("nij,knj->kni", self.whitener, r)
        if 0.0 < self.offset_sigma < np.inf:
            prior = np.concatenate([offset / self.offset_sigma, np.zeros_like(offset)], axis=1)
            r = np.concatenate([r, prior[:, None]], axis=1)
        return r

    def fit(self, start: FloatArray, loss: Loss) -> Estimate[FloatArray]:
        return m_estimate(self.residuals, _moved, start, 3 if self.offset_sigma > 0.0 else 2, loss, step=1e-4)

    def starts(self, count: int = 4) -> list[FloatArray]:
        """The best places of a global grid that are lower than their neighbours, best first."""
        thin = np.unique(np.linspace(0, len(self.t_ns) - 1, GRID_OBSERVATIONS).astype(np.intp))
        lat, lon = _grid()
        there = Origin(lat=0.0, lon=0.0)
        s_n = sun_direction_n(there, self.t_ns[thin], 0.0, 0.0, refraction=False)
        s = np.einsum("nj,mjk->mnk", s_n, R_n_local(there, lat, lon))
        azimuth, elevation = np.arctan2(s[..., 1], s[..., 0]), -np.arcsin(np.clip(s[..., 2], -1.0, 1.0))
        offset = np.zeros(len(lat))
        if self.offset_sigma > FREE_OFFSET:
            offset = np.angle(np.sum(np.exp(1j * (azimuth - self.azimuth[thin])), axis=1))
        r = _sphere_difference(azimuth, elevation, self.azimuth[thin] + offset[:, None], self.elevation[thin])
        sigma = np.sqrt(1.0 / np.linalg.norm(self.whitener[thin], axis=(1, 2)) ** 2 + GRID_SIGMA**2)
        cost = np.sum(np.linalg.norm(r, axis=-1) / sigma, axis=1)
        xyz = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
        _, near = cKDTree(xyz).query(xyz, 9)
        lowest = np.flatnonzero(cost <= cost[near].min(axis=1))
        best = lowest[np.argsort(cost[lowest])][:count]
        return [np.array([lat[i], lon[i], offset[i]]) for i in best]


def _across_along(o: SunObservation) -> FloatArray:
    """Covariance (2, 2) of the sun across (growing azimuth) and along (growing elevation)."""
    bow, starboard, _ = level_axes(o.up_b)
    azimuth = o.azimuth_b
    across = np.cos(azimuth) * starboard - np.sin(azimuth) * bow
    along = np.cross(across, o.s_b)
    T = np.stack([across, along])
    cov: FloatArray = T @ o.cov_b @ T.T
    return cov


def _sphere_difference(
    azimuth_0: FloatArray, elevation_0: FloatArray, azimuth: FloatArray, elevation: FloatArray
) -> FloatArray:
    """The arc from one direction to another, across and along at the first, rad, shape (..., 2)."""
    turn = azimuth - azimuth_0
    across = np.cos(elevation) * np.sin(turn)
    along = np.sin(elevation) * np.cos(elevation_0) - np.cos(elevation) * np.sin(elevation_0) * np.cos(turn)
    ahead = np.sin(elevation) * np.sin(elevation_0) + np.cos(elevation) * np.cos(elevation_0) * np.cos(turn)
    chord = np.hypot(across, along)
    stretch = np.where(chord > 1e-9, np.arctan2(chord, ahead) / np.maximum(chord, 1e-9), 1.0)
    return np.stack([across * stretch, along * stretch], axis=-1)


def _moved(x: FloatArray, d: FloatArray) -> FloatArray:
    """A place moved by radians north and east, and the heading offset by its own."""
    lat, lon, offset = x
    p = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    p = p + d[0] * north + d[1] * east
    turned = float(wrap_pi(offset + d[2])) if len(d) == 3 else offset
    return np.array([np.arctan2(p[2], np.hypot(p[0], p[1])), np.arctan2(p[1], p[0]), turned])


def _arc(a: FloatArray, b: FloatArray) -> float:
    """Angle between two places, rad."""
    return float(np.linalg.norm(_sphere_difference(a[1], a[0], b[1], b[0])))


def _grid() -> tuple[FloatArray, FloatArray]:
    """Latitudes and longitudes spread evenly over the Earth (Fibonacci lattice)."""
    count = round(4.0 * np.pi / GRID_STEP**2)
    i = np.arange(count) + 0.5
    return np.arcsin(1.0 - 2.0 * i / count), np.asarray(wrap_pi(np.pi * (1.0 + np.sqrt(5.0)) * i))


def _radii(lat: float) -> FloatArray:
    """Radii of curvature of the ellipsoid north and east, m."""
    e2 = float(WGS84.first_eccentricity) ** 2
    east = WGS84.semimajor_axis / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
    return np.array([east * (1.0 - e2) / (1.0 - e2 * np.sin(lat) ** 2), east])
