"""Noise densities of an IMU from a recording at rest, for the rig: only what the recording shows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from uwgraph.dive.noise_terms import LEAST_FOR_WALK_S, MAX_INFLATION, SensorNoise, Term, sensor_noise
from uwgraph.dive.rig import ImuRig
from uwgraph.dive.stillness import longest_still
from uwgraph.errors import DataError
from uwgraph.types import Imu, TimeArray

UNITS: Final[Mapping[str, Mapping[str, str]]] = {
    "gyro": {"Q": "rad", "N": "rad/s/sqrt(Hz)", "B": "rad/s", "K": "rad/s^2/sqrt(Hz)"},
    "accel": {"Q": "m/s", "N": "m/s^2/sqrt(Hz)", "B": "m/s^2", "K": "m/s^3/sqrt(Hz)"},
}
WORDS: Final = {"Q": "quantisation", "N": "noise density", "B": "bias instability", "K": "bias walk"}
RIG_FIELDS: Final = {"N": "noise_density", "K": "bias_walk"}
"""The terms that the rig has a field for; the sensor's name goes before it."""

GAP_S: Final = 0.5
"""s; a longer gap (or one of five samples) ends a stretch."""
FEWEST: Final = 256
"""Samples that give an Allan variance to fit."""
GRAVITY: Final = (9.0, 10.6)
"""m/s^2, what an accelerometer reads at rest."""
LOST: Final = 0.01
"""Part of the samples that may be missing before it is told."""


@dataclass(frozen=True, eq=False)
class ImuNoise:
    """What a recording at rest tells of an IMU's noise."""

    rate_hz: float
    start_s: float
    """Where the still stretch begins, seconds from the first sample."""
    duration_s: float
    recorded_s: float
    """Length of all that was looked at."""
    gyro: SensorNoise
    accel: SensorNoise
    notes: tuple[str, ...]

    @property
    def fields(self) -> dict[str, Term]:
        """The term behind each field of :class:`~uwgraph.dive.rig.ImuRig` that a still recording can tell."""
        sensors = {"gyro": self.gyro, "accel": self.accel}
        return {
            f"{name}_{field}": noise.terms[term]
            for name, noise in sensors.items()
            for term, field in RIG_FIELDS.items()
        }

    def rig(self, rig: ImuRig) -> ImuRig:
        """The rig with what was seen; every other field stays as it is."""
        return rig.model_copy(update={name: term.value for name, term in self.fields.items() if term.seen})


def imu_noise(imu: Imu, where: str = "imu") -> ImuNoise:
    """Noise of the longest still stretch of a recording.

    Raises
    ------
    DataError
        When samples are out of order or not finite, nothing is still for long enough, an axis is dead, or the
        accelerometer does not read gravity.
    """
    _check_samples(imu, where)
    recorded_s = float(imu.t_ns[-1] - imu.t_ns[0]) * 1e-9 if len(imu) else 0.0
    still = _longest_still(imu)
    stretch = imu.select(still)
    if len(stretch) < FEWEST:
        found = f"only {len(stretch)} samples in a row" if len(stretch) else "nothing"
        raise DataError(
            f"{found} of these {recorded_s:.0f} s is still",
            where=where,
            remedy="record the IMU at rest: minutes for the noise densities, hours for the bias walks",
        )
    _check_sensors(stretch, where)
    rate_hz = _rate(stretch.t_ns)
    noise = {"gyro": sensor_noise(stretch.w_s, rate_hz), "accel": sensor_noise(stretch.f_s, rate_hz)}
    start_s = float((stretch.t_ns[0] - imu.t_ns[0]) * 1e-9)
    notes = tuple(_notes(stretch, rate_hz, noise))
    return ImuNoise(rate_hz, start_s, len(stretch) / rate_hz, recorded_s, noise["gyro"], noise["accel"], notes)


def _check_samples(imu: Imu, where: str) -> None:
    if (np.diff(imu.t_ns) <= 0).any():
        raise DataError("stamps are not in order", where=f"{where}: t_ns", remedy="sort the samples by time")
    if not (np.isfinite(imu.f_s).all() and np.isfinite(imu.w_s).all()):
        raise DataError("samples are not finite", where=where, remedy="remove the rows, or repair them")


def _longest_still(imu: Imu) -> slice:
    """The longest still stretch of samples without a gap."""
    steps = np.diff(imu.t_ns)
    if not len(steps):
        return slice(0, 0)
    cuts = np.flatnonzero(steps > max(GAP_S * 1e9, 5.0 * float(np.median(steps)))) + 1
    best = slice(0, 0)
    for first, stop in pairwise([0, *cuts.tolist(), len(imu)]):
        if stop - first > max(best.stop - best.start, 1):
            piece = imu.select(slice(first, stop))
            still = longest_still(piece, _rate(piece.t_ns))
            best = max(best, slice(first + still.start, first + still.stop), key=lambda s: s.stop - s.start)
    return best


def _rate(t_ns: TimeArray) -> float:
    return (len(t_ns) - 1) / (float(t_ns[-1] - t_ns[0]) * 1e-9)


def _check_sensors(stretch: Imu, where: str) -> None:
    for name, values in (("w", stretch.w_s), ("f", stretch.f_s)):
        for axis, column in zip("xyz", values.T, strict=True):
            if np.ptp(column) == 0.0:
                raise DataError(
                    f"never changes from {column[0]:g}",
                    where=f"{where}: {name}_{axis}",
                    remedy="the axis is dead, left out, or too coarse to show any noise",
                )
    norm = float(np.linalg.norm(stretch.f_s.mean(axis=0)))
    if not GRAVITY[0] < norm < GRAVITY[1]:
        raise DataError(
            f"the accelerometer reads {norm:.4g} m/s^2 at rest",
            where=where,
            remedy="specific force is in m/s^2, gravity included",
        )


def _notes(stretch: Imu, rate_hz: float, noise: Mapping[str, SensorNoise]) -> Iterator[str]:
    """What was done to the signals, and what to bear in mind."""
    duration_s = len(stretch) / rate_hz
    steps = np.diff(stretch.t_ns)
    lost = float(np.mean(steps > 1.5 * np.median(steps)))
    if lost > LOST:
        yield f"{lost:.1%} of the samples are missing: the densities come out too high by about half that"
    if duration_s < LEAST_FOR_WALK_S:
        yield f"{duration_s:.0f} s are too short for a bias walk: {LEAST_FOR_WALK_S:.0f} s at least, better hours"
    for name, sensor in noise.items():
        yield from (f"{name}: {line}" for line in _sensor_notes(sensor, UNITS[name]["B"], duration_s, rate_hz))


def _sensor_notes(sensor: SensorNoise, unit: str, duration_s: float, rate_hz: float) -> Iterator[str]:
    drift = duration_s * max((axis.trend for axis in sensor.axes), key=abs)
    yield f"a linear trend of at most {drift:.2g} {unit} over the stretch was removed (temperature, tilting)"
    if sensor.inflation > MAX_INFLATION:
        yield "the Allan deviation is no sum of noise terms, nothing is taken from it: it vibrates, or was touched"
        return
    if sensor.tau_min_s * rate_hz > 1.5:
        yield f"averaging times below {sensor.tau_min_s:.2g} s left out: the sensor's filter, or vibration"
    if sensor.model_error > 0.0:
        yield f"the terms explain the Allan deviation to {sensor.model_error / 2.0:.1%} only; the sigmas include it"
    if sensor.inflation > 1.0:
        yield f"the terms do not quite explain the Allan deviation: sigmas times {sensor.inflation:.1f}"
    if sensor.terms["B"].seen:
        yield f"bias instability of {sensor.terms['B'].value:.2g} {unit}: the rig has a walk for the bias only"
