"""The errors of every estimator's attitude as direction sensors see them: the sun, and headings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from uwgraph.evaluate.entries import Contest
from uwgraph.evaluate.people import people
from uwgraph.frames import R_n_local, geodetic_from_ned, wrap_pi
from uwgraph.sun.ephemeris import sun_axes, sun_azimuth_elevation
from uwgraph.types import FloatArray, Heading, Solution, Sun, TimeArray

S = TypeVar("S", Sun, Heading)


@dataclass(frozen=True, eq=False)
class Directions:
    """One angle, as estimated less as measured."""

    name: str
    """Of the angle: sun azimuth, sun elevation, heading."""
    t_ns: TimeArray
    """Shape (N,)."""
    sigma_deg: float | None
    """Median of the stated 1-sigma; None where it is not stated."""
    residual_deg: list[FloatArray]
    """Shape (N,), one array per entry; NaN beyond its stamps. The estimate's error less the sensor's."""


def directions(contest: Contest) -> list[Directions]:
    """Azimuth and elevation of the sun and headings, where the dive has them; flagged suns are left out.

    Of the sun it is the measured direction, turned by the estimate's attitude, less the almanac's; of a heading the
    estimated less the measured one. An estimate that points 1 deg too far clockwise has residuals about +1 deg.
    """
    dive = contest.dive
    if not contest.entries or dive.imu is None or (dive.sun is None and dive.heading is None):
        return []
    from uwgraph.graph.prepare import prepare  # loads gtsam, which who only exports or imports can do without

    prepared = prepare(dive)
    found = []
    if prepared.sun is not None:
        sun = prepared.sun.select((prepared.sun.flags == 0) & np.isfinite(prepared.sun.s_b).all(axis=1))
        found += _of_sun(contest, sun) if len(sun) else []
    if prepared.heading is not None:
        found.append(_of_heading(contest, prepared.heading))
    return found


def _of_sun(contest: Contest, sun: Sun) -> list[Directions]:
    columns = _residuals(contest, sun, sun_residual, columns=4)
    information = np.concatenate([each[:, 2:] for each in columns])
    return [
        Directions(name, sun.t_ns, _sigma(information[:, column]), [each[:, column] for each in columns])
        for column, name in enumerate(("sun azimuth", "sun elevation"))
    ]


def _sigma(information: FloatArray) -> float | None:
    """Median 1-sigma in deg of informations in rad^-2; None where there are none."""
    known = information[np.isfinite(information)]
    middle = np.median(known) if len(known) else 0.0
    return float(np.degrees(1.0 / np.sqrt(middle))) if middle > 0.0 else None


def _of_heading(contest: Contest, heading: Heading) -> Directions:
    def residual(at: Solution, seen: Heading) -> FloatArray:
        return np.degrees(wrap_pi(people(at).rph[:, 2] - seen.heading))[:, None]

    residuals = _residuals(contest, heading, residual, columns=1)
    sigma = float(np.degrees(np.median(heading.sigma)))
    return Directions("heading", heading.t_ns, sigma, [each[:, 0] for each in residuals])


def _residuals(
    contest: Contest, stream: S, residual: Callable[[Solution, S], FloatArray], columns: int
) -> list[FloatArray]:
    """Residuals (N, columns) of every entry; NaN beyond its stamps."""
    from uwgraph.graph import resample

    found = []
    for entry in contest.entries:
        solution = entry.judged.solution
        out = np.full((len(stream), columns), np.nan)
        inside = (stream.t_ns >= solution.t_ns[0]) & (stream.t_ns <= solution.t_ns[-1])
        if len(solution) > 1 and inside.any():
            seen = stream.select(inside)
            out[inside] = residual(resample(contest.dive, solution, seen.t_ns), seen)
        found.append(out)
    return found


def sun_residual(at: Solution, sun: Sun) -> FloatArray:
    """By the attitudes of ``at``, shape (N, 4).

    Azimuth and elevation less the almanac's, deg, and the information that the sensor states of either, rad^-2.
    """
    lat, lon, _ = geodetic_from_ned(at.origin, at.p_n)
    R_lb = np.swapaxes(R_n_local(at.origin, lat, lon), -1, -2) @ at.R_nb
    azimuth, elevation = sun_azimuth_elevation(at.t_ns, lat, lon)
    s_l = np.einsum("nij,nj->ni", R_lb, sun.s_b)
    clockwise = wrap_pi(np.arctan2(s_l[:, 1], s_l[:, 0]) - azimuth)
    upward = np.arctan2(-s_l[:, 2], np.hypot(s_l[:, 0], s_l[:, 1])) - elevation
    information_l = R_lb @ sun.information_b @ np.swapaxes(R_lb, 1, 2)
    _, across_l, upward_l = sun_axes(azimuth, elevation)
    moved_l = (across_l * np.cos(elevation)[:, None], upward_l)  # of the direction, by a radian of either angle
    information = [np.einsum("ni,nij,nj->n", axis, information_l, axis) for axis in moved_l]
    return np.column_stack([np.degrees(clockwise), np.degrees(upward), *information])
