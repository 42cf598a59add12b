"""Calibration of a polarimeter under a clear sky, from turns on the spot with known relative yaw and a known sun.

Every unit is tried on its own against the pattern of a Rayleigh sky (Strutt 1871): its orientation (direction and zero
of the angles), the gains of its photodiodes, the degree of polarization and the turns' heading constants. The unit's
intensity drops out reading by reading, so no model of the sky's radiance is needed. A unit that does not follow the
pattern is tried without each of its photodiodes in turn, in the sky that the sound units found; if that fails it is
faulty. Those that pass are then fitted together, light scattered twice included (Berry, Dennis & Lee 2004).

e-vectors cannot tell a unit that looks up from one that looks down with its angles counted the other way: it looks up.
Nor can they tell a turn to the right from one to the left that is seen in a mirror: the sense of the yaw must be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from uwgraph.errors import DataError
from uwgraph.sun.eigen import evenly
from uwgraph.sun.polarimeter import UP, Polarimeter, Readings
from uwgraph.types import BoolArray, FloatArray

_GRID: Final = np.radians(15.0)
_TILTS: Final = np.radians([10.0, 30.0, 50.0, 70.0])  # from the zenith
_FEW: Final = 80  # enough to find the right cell
_STARTS: Final = 3
_DOP: Final = 0.5  # where the search starts
_LEAST_READINGS: Final = 20
_LOOK_DOWN: Final = np.diag([1.0, -1.0, -1.0])
_GAUSSIAN: Final = 1.4826  # standard deviation over median of the absolute value


@dataclass(frozen=True)
class CalibrationSettings:
    """Settings of :func:`calibrate`."""

    error: float = 0.01
    """Departure of sound counts from the model over the intensity; those far above are outliers."""
    most_error: float = 0.02
    """The most that a unit in use may have, robust 1-sigma."""
    most_gain: float = 2.0
    """Most ratio between the gains of a unit's photodiodes."""
    dop: tuple[float, float] = (0.1, 1.0)
    """Greatest degree of polarization of a clear sky, 90 deg from the sun: least and most."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A polarimeter and how it was found."""

    polarimeter: Polarimeter
    headings: FloatArray
    """Heading less yaw of each turn, rad, shape (R,), on average 0: the body's axis is where the yaws say."""
    dop: float
    """Degree of polarization of the sky 90 deg from the sun, as the units see it."""
    notes: tuple[str, ...]
    """What was found wrong with each unit; empty for a sound one."""


@dataclass(frozen=True, eq=False)
class _Unit:
    """Readings of one unit that are neither repeated nor saturated, and what is believed of it."""

    counts: FloatArray
    """Less the dark ones, over their mean, shape (M, K)."""
    mean: FloatArray
    """That mean, shape (K,)."""
    bearing: FloatArray
    """Azimuth of the sun less yaw, shape (M,)."""
    zenith: FloatArray
    turn: np.ndarray[tuple[int], np.dtype[np.intp]]
    angles: FloatArray
    """Shape (K,)."""
    R_bu: FloatArray
    log_gains: FloatArray
    """Of ``counts``, sum 0, shape (K,)."""

    def at(self, p: FloatArray) -> _Unit:
        """With the orientation turned by p[:3] and the gains moved by p[3:]."""
        moved = self.log_gains + np.append(p[3:], -p[3:].sum())
        return replace(self, R_bu=self.R_bu @ Rotation.from_rotvec(p[:3]).as_matrix(), log_gains=moved)

    @property
    def parameters(self) -> int:
        return 2 + len(self.angles)

    @property
    def gains(self) -> FloatArray:
        g = np.exp(self.log_gains) * self.mean
        return np.asarray(g / np.exp(np.log(g).mean()))

    def thinned(self, count: int) -> _Unit:
        """With about ``count`` of the readings, evenly."""
        k = evenly(len(self.turn), count)
        return replace(self, counts=self.counts[k], bearing=self.bearing[k], zenith=self.zenith[k], turn=self.turn[k])

    def like(self, other: _Unit) -> _Unit:
        """These readings with the orientation, angles and gains of ``other``."""
        return replace(self, R_bu=other.R_bu, angles=other.angles, log_gains=other.log_gains)

    def upright(self) -> _Unit:
        if self.R_bu[:, 2] @ UP > 0.0:
            return self
        return replace(self, R_bu=self.R_bu @ _LOOK_DOWN, angles=-self.angles)


@dataclass(frozen=True, eq=False)
class _Sky:
    dop: float
    twice: float
    headings: FloatArray

    @classmethod
    def of(cls, x: FloatArray) -> _Sky:
        turns = np.append(0.0, x[2:])
        return cls(float(x[0]), float(x[1]), turns - turns.mean())

    def vector(self) -> FloatArray:
        return np.concatenate([[self.dop, self.twice], self.headings[1:] - self.headings[0]])


@dataclass(frozen=True, eq=False)
class _Fit:
    units: list[_Unit]
    sky: _Sky
    errors: list[float]
    """Robust size of each unit's residuals."""
    cost: float


def calibrate(
    turns: Sequence[Readings],
    angles: FloatArray,
    *,
    saturation: float | None = None,
    dark: float = 0.0,
    noise: float = 1.0,
    settings: CalibrationSettings | None = None,
) -> Calibration:
    """Orientation, gains and faults of every unit.

    Parameters
    ----------
    turns : sequence of Readings
        Each over at least half a turn, under a clear sky.
    angles : shape (U, K)
        Nominal polarizer angles within each unit, rad, from any zero, in either sense.
    saturation, dark, noise
        In counts. Without ``saturation`` it is read off the plateau where all photodiodes of a unit agree.

    Raises
    ------
    DataError
        The turns are too short or of another layout, the sun is down, or no unit follows the pattern.
    """
    settings = settings or CalibrationSettings()
    _check(turns, angles)
    if saturation is None:
        saturation = plateau(np.concatenate([t.counts for t in turns]))
    cut = _Cut(turns, angles, saturation, dark)
    good, notes = np.zeros(angles.shape, dtype=np.bool_), ["a dead photodiode"] * len(angles)
    units: dict[int, _Unit] = {}
    skies: list[FloatArray] = []
    for u in range(len(angles)):
        readings = cut.unit(u, cut.alive[u])
        if readings is None:
            notes[u] = "dead or always saturated"
        elif cut.alive[u].all():
            fit = _alone(readings, len(turns), settings)
            notes[u] = _fault(fit, settings)
            if not notes[u]:
                units[u], good[u] = fit.units[0], True
                skies.append(fit.sky.vector())
    if not units:
        raise DataError(
            "no unit follows the pattern of a clear sky",
            where="turns",
            remedy="check the polarizer angles, time and place, and that the sky was clear",
        )
    sky = _Sky.of(np.median(skies, axis=0))
    for u in np.flatnonzero(~good.any(axis=1)).tolist():
        if (found := _without_one(cut, u, sky, settings)) is not None:
            units[u], good[u] = found
            notes[u] = f"photodiode {np.flatnonzero(~good[u])[0]} left out"
    together = _fit(list(units.values()), sky, np.ones(1 + len(turns), dtype=np.bool_), settings)
    R_bu, beta, gains = np.tile(np.eye(3), (len(angles), 1, 1)), angles.copy(), np.ones(angles.shape)
    error = np.full(len(angles), np.nan)
    for u, unit, unit_error in zip(units, together.units, together.errors, strict=True):
        R_bu[u], beta[u, good[u]], gains[u, good[u]], error[u] = unit.R_bu, unit.angles, unit.gains, unit_error
    polarimeter = Polarimeter(R_bu, beta, gains, good, saturation, error, together.sky.twice, dark, noise)
    return Calibration(polarimeter, together.sky.headings, together.sky.dop, tuple(notes))


def plateau(counts: FloatArray) -> float:
    """Counts from which on photodiodes are saturated, of ``counts`` (N, U, K); infinite where none ever was.

    Polarizers at different angles pass the same near the top of the range only if there is no more range.
    """
    top = float(np.quantile(counts, 0.995))
    return 0.9 * top if np.mean(counts.min(axis=2) > 0.95 * top) > 0.01 else float("inf")


def _check(turns: Sequence[Readings], angles: FloatArray) -> None:
    """Raise where the turns cannot tell."""
    for r, turn in enumerate(turns):
        where = f"turn {r + 1}"
        if turn.counts.shape[1:] != angles.shape:
            raise DataError(
                f"the counts have {turn.counts.shape[1:]} units and photodiodes, the angles {angles.shape}",
                where=where,
                remedy="give one polarizer angle for each photodiode",
            )
        if np.ptp(turn.yaw) < np.pi:
            raise DataError(
                f"the body turned by {np.degrees(np.ptp(turn.yaw)):.0f} deg only",
                where=where,
                remedy="calibrate from turns of at least 180 deg, better 360",
            )
        if turn.sun_zenith.max() > np.radians(85.0):
            raise DataError("the sun was down", where=where, remedy="check time and place")
    if not turns:
        raise DataError("there is no turn", where="turns", remedy="give at least one recording")


@dataclass(frozen=True, eq=False)
class _Cut:
    """Takes the readings of single units out of the turns."""

    turns: Sequence[Readings]
    angles: FloatArray
    saturation: float
    dark: float

    @property
    def alive(self) -> BoolArray:
        """Photodiodes whose counts are above dark and change, shape (U, K)."""
        counts = np.concatenate([t.counts for t in self.turns])
        return np.asarray((np.ptp(counts, axis=0) > 0.0) & (counts.mean(axis=0) > self.dark))

    def unit(self, u: int, use: BoolArray) -> _Unit | None:
        """Unit ``u`` through photodiodes ``use`` (K,); None where too few of them or of its readings are left."""
        kept = [t.fresh[:, u] & (t.counts[:, u, use] < self.saturation).all(axis=1) for t in self.turns]
        if use.sum() < 3 or sum(k.sum() for k in kept) < _LEAST_READINGS:
            return None
        pairs = list(zip(self.turns, kept, strict=True))
        counts = np.concatenate([t.counts[k, u][:, use] for t, k in pairs]) - self.dark
        mean = counts.mean(axis=0)
        return _Unit(
            counts / mean,
            mean,
            bearing=np.concatenate([(t.sun_azimuth - t.read_yaw[:, u])[k] for t, k in pairs]),
            zenith=np.concatenate([t.sun_zenith[k] for t, k in pairs]),
            turn=np.repeat(np.arange(len(self.turns)), [k.sum() for k in kept]),
            angles=self.angles[u, use],
            R_bu=np.eye(3),
            log_gains=np.zeros(int(use.sum())),
        )


def _alone(unit: _Unit, turns: int, settings: CalibrationSettings) -> _Fit:
    """The unit in a sky of its own, scattered once."""
    free = np.arange(1 + turns) != 1
    return _searched(unit, _Sky(_DOP, 0.0, np.zeros(turns)), free, settings)


def _without_one(cut: _Cut, u: int, sky: _Sky, settings: CalibrationSettings) -> tuple[_Unit, BoolArray] | None:
    """Unit ``u`` without the photodiode that is to blame, in a known sky; None where that does not help."""
    found: list[tuple[float, _Unit, BoolArray]] = []
    for k in range(cut.angles.shape[1]):
        use = np.arange(cut.angles.shape[1]) != k
        readings = cut.unit(u, use) if cut.alive[u, use].all() else None
        if readings is None:
            continue
        fit = _searched(readings, sky, np.zeros(len(sky.vector()), dtype=np.bool_), settings)
        if not _fault(fit, settings):
            found.append((fit.errors[0], fit.units[0], use))
    return min(found, key=lambda f: f[0])[1:] if found else None


def _fault(fit: _Fit, settings: CalibrationSettings) -> str:
    """What speaks against the only unit of a fit; empty where nothing does."""
    gains = fit.units[0].gains
    if fit.errors[0] > settings.most_error:
        return f"faulty: {fit.errors[0]:.1%} of the intensity off the pattern"
    if gains.max() > settings.most_gain * gains.min():
        return f"faulty: gains differ by a factor of {gains.max() / gains.min():.1f}"
    if not settings.dop[0] < fit.sky.dop < settings.dop[1]:
        return f"faulty: degree of polarization {fit.sky.dop:.2f} at 90 deg from the sun"
    return ""


def _searched(unit: _Unit, sky: _Sky, free: BoolArray, settings: CalibrationSettings) -> _Fit:
    """The best fit, by way of the best cells of a grid over orientations and a few of the readings."""
    few = unit.thinned(_FEW)
    cells = _orientations()
    most = 10.0 * settings.error
    costs = [np.minimum(np.abs(_residuals(replace(few, R_bu=R), sky)), most).sum() for R in cells]
    tried = [_fit([replace(few, R_bu=cells[i])], sky, free, settings) for i in np.argsort(costs)[:_STARTS]]
    best = min(tried, key=lambda fit: fit.cost)
    return _fit([unit.like(best.units[0])], best.sky, free, settings)


def _orientations() -> FloatArray:
    """Of units that look up, on a grid, shape (G, 3, 3)."""
    azimuth, tilt, zero = np.arange(0.0, 2.0 * np.pi, _GRID), np.pi - _TILTS, np.arange(0.0, np.pi, _GRID)
    grid = np.stack(np.meshgrid(azimuth, tilt, zero, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(Rotation.from_euler("ZXZ", grid).as_matrix())


def _fit(units: list[_Unit], sky: _Sky, free: BoolArray, settings: CalibrationSettings) -> _Fit:
    """Robust least squares over the units and the ``free`` ones of the sky's numbers."""
    ends = np.cumsum([u.parameters for u in units])

    def at(p: FloatArray) -> tuple[list[_Unit], _Sky]:
        x = sky.vector()
        x[free] += p[ends[-1] :]
        return [u.at(q) for u, q in zip(units, np.split(p, ends), strict=False)], _Sky.of(x)

    def residuals(p: FloatArray) -> FloatArray:
        moved, above = at(p)
        return np.concatenate([_residuals(u, above).ravel() for u in moved])

    start = np.zeros(ends[-1] + free.sum())
    found = least_squares(residuals, start, loss="soft_l1", f_scale=settings.error, x_scale="jac", ftol=1e-5)
    best, above = at(found.x)
    errors = [float(_GAUSSIAN * np.median(np.abs(_residuals(u, above)))) for u in best]
    return _Fit([u.upright() for u in best], above, errors, float(found.cost))


def _residuals(unit: _Unit, sky: _Sky) -> FloatArray:
    """Counts over gain and intensity, less the pattern, shape (M, K); the intensity suits each reading."""
    azimuth = unit.bearing - sky.headings[unit.turn]
    level = np.sin(unit.zenith)
    s_b = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), -np.cos(unit.zenith)], axis=1)
    x, y, z = (s_b @ unit.R_bu).T
    Q, U = _axis(-y, x) * sky.dop / (1.0 + z * z)  # normal to the sun and the line of sight: sin^2 / (1 + cos^2)
    Q2, U2 = _axis(*(UP @ unit.R_bu)[:2]) * sky.twice
    beta = 2.0 * unit.angles
    pattern = 1.0 + (Q + Q2)[:, None] * np.cos(beta) + (U + U2)[:, None] * np.sin(beta)
    light = unit.counts / np.exp(unit.log_gains)
    intensity = (light * pattern).sum(axis=1) / (pattern**2).sum(axis=1)
    return np.asarray(light / intensity[:, None] - pattern)


def _axis(x: FloatArray, y: FloatArray) -> FloatArray:
    """(Q, U) of light polarized along (x, y), as strong as its square."""
    return np.stack([x * x - y * y, 2.0 * x * y])
