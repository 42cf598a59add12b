"""A simulated compass of photodiodes under a Rayleigh sky: faults found, calibration and heading against the truth.

The simulation projects the field on each polarizer's axis in space; it shares no formula with the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.errors import DataError
from uwgraph.frames import wrap_pi
from uwgraph.sun.observation import SunFlag
from uwgraph.sun.polarimeter import Polarimeter, Readings, observe
from uwgraph.sun.polarimeter_calibration import calibrate, plateau

NOMINAL = np.radians([0.0, 45.0, 90.0, 135.0])
UNITS = 7
DEAD, BROKEN, TWINNED = 2, 4, 6
FULL = 11_000.0


@dataclass(frozen=True)
class Compass:
    """Units that look up at about 45 deg, all around; their gains differ."""

    R_bu: np.ndarray
    gains: np.ndarray

    @classmethod
    def random(cls, rng: np.random.Generator) -> Compass:
        turn = np.arange(UNITS) * 2.0 * np.pi / UNITS + rng.normal(0.0, 0.05, UNITS)
        tilt = np.pi - np.radians(45.0) + rng.normal(0.0, 0.05, UNITS)
        zero = rng.uniform(0.0, np.pi, UNITS)
        return cls(
            Rotation.from_euler("ZXZ", np.stack([turn, tilt, zero], axis=1)).as_matrix(),
            np.exp(rng.normal(0.0, 0.1, (UNITS, 4))),
        )

    def counts(self, s_b: np.ndarray, light: float = 3000.0, dop: float = 0.6) -> np.ndarray:
        """Noise-free counts (U, 4) for the sun at ``s_b``; the field is a x s, and the sun itself shines in."""
        out = np.empty((UNITS, 4))
        for u, R in enumerate(self.R_bu):
            a = R[:, 2]
            across = np.cross(a, s_b)
            sin2 = across @ across
            degree = dop * sin2 / (2.0 - sin2)
            axes = R[:, :2] @ np.stack([np.cos(NOMINAL), np.sin(NOMINAL)])
            intensity = light * (0.6 + 0.4 * (a @ s_b) ** 2) * (10.0 if a @ s_b > np.cos(np.radians(25.0)) else 1.0)
            out[u] = self.gains[u] * intensity * ((1.0 - degree) / 2.0 + degree * (across @ axes) ** 2 / sin2) * 2.0
        return out

    def turn(self, start: float, rng: np.random.Generator, samples: int = 90, noise: float = 0.004) -> Readings:
        """A full turn with faults: a dead photodiode, one that hardly sees, and a unit with two wires twice."""
        yaw = np.linspace(0.0, 2.0 * np.pi, samples)
        azimuth, zenith = np.full(samples, 4.3), np.radians(np.linspace(40.0, 41.0, samples))
        counts = np.array([self.counts(sun(A, z)) for A, z in zip(azimuth - yaw - start, zenith, strict=True)])
        counts *= 1.0 + rng.normal(0.0, noise, counts.shape)
        counts[:, DEAD, 1] = 7.0
        counts[:, BROKEN, 0] = 7500.0 + 0.1 * counts[:, BROKEN, 0]
        counts[:, TWINNED] = counts[:, TWINNED][:, [0, 0, 2, 2]]
        return Readings(np.arange(samples), np.minimum(counts, FULL), yaw, azimuth, zenith)

    def known(self) -> Polarimeter:
        """As calibrated without error."""
        every = np.ones((UNITS, 4), dtype=bool)
        return Polarimeter(
            self.R_bu, np.tile(NOMINAL, (UNITS, 1)), self.gains, every, 0.9 * FULL, np.full(UNITS, 1e-3), noise=0.01
        )


def sun(azimuth: float, zenith: float) -> np.ndarray:
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), -np.cos(zenith)])


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


@pytest.fixture(scope="module")
def compass():
    return Compass.random(np.random.default_rng(5))


@pytest.fixture(scope="module")
def calibrated(compass):
    rng = np.random.default_rng(6)
    return calibrate([compass.turn(0.03, rng), compass.turn(-0.03, rng)], np.tile(NOMINAL, (UNITS, 1)))


def test_faults_are_found(calibrated):
    found = calibrated.polarimeter
    expected = np.ones((UNITS, 4), dtype=bool)
    expected[DEAD, 1] = expected[BROKEN, 0] = False
    expected[TWINNED] = False
    np.testing.assert_array_equal(found.good, expected)
    assert 0.85 * FULL < found.saturation < FULL
    assert [bool(note) for note in calibrated.notes] == [u in (DEAD, BROKEN, TWINNED) for u in range(UNITS)]
    assert np.isnan(found.error[TWINNED])


def test_calibration_recovers_the_compass(compass, calibrated):
    found = calibrated.polarimeter
    use = found.in_use
    assert angle(found.directions_b, compass.R_bu[:, :, 2])[use].max() < 0.5
    zero = (
        found.R_bu
        @ np.stack([np.cos(found.angles[:, 2]), np.sin(found.angles[:, 2]), np.zeros(UNITS)], axis=1)[..., None]
    )
    truth = compass.R_bu @ np.array([np.cos(NOMINAL[2]), np.sin(NOMINAL[2]), 0.0])
    assert np.abs(np.degrees(np.arccos(np.clip(np.abs((zero[..., 0] * truth).sum(axis=1)), 0.0, 1.0))))[use].max() < 0.5
    ratio = np.where(found.good, found.gains / compass.gains, np.nan)[use]
    np.testing.assert_allclose(
        ratio / np.nanmean(ratio, axis=1)[:, None], np.where(np.isnan(ratio), np.nan, 1.0), atol=5e-3
    )
    np.testing.assert_allclose(calibrated.headings, [0.03, -0.03], atol=np.radians(0.1))
    assert calibrated.dop == pytest.approx(0.6, abs=0.02)
    assert found.twice == pytest.approx(0.0, abs=0.01)
    assert np.nanmax(found.error) < 0.008


def test_heading_of_another_turn(compass, calibrated):
    turn = compass.turn(0.4, np.random.default_rng(7))
    found = [
        observe(calibrated.polarimeter, c, sun_zenith=z) for c, z in zip(turn.counts, turn.sun_zenith, strict=True)
    ]
    ok = np.array([o.ok for o in found])
    assert ok.mean() > 0.95
    error = np.array(
        [wrap_pi(o.heading(A) - y - 0.4) for o, A, y in zip(found, turn.sun_azimuth, turn.yaw, strict=True)]
    )
    sigma = np.array([o.azimuth_sigma for o in found])
    assert np.degrees(np.sqrt(np.mean(error[ok] ** 2))) < 0.5
    assert 0.1 < np.mean((error[ok] / sigma[ok]) ** 2) < 2.0


def test_the_sense_of_the_polarizers_is_free(compass):
    sound = [0, 1, 3, 5]
    turn = compass.turn(0.0, np.random.default_rng(6))
    turn = replace(turn, counts=turn.counts[:, sound])
    mirrored = calibrate([turn], np.tile(1.0 - NOMINAL, (4, 1))).polarimeter
    assert mirrored.good.all()
    assert angle(mirrored.directions_b, compass.R_bu[sound, :, 2]).max() < 0.5


@settings(max_examples=40, deadline=None)
@given(
    azimuth=st.floats(-np.pi, np.pi),
    zenith=st.floats(0.4, 1.4),
    tilt=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    turned=st.floats(-0.2, 0.2),
)
def test_direction_without_noise(compass, azimuth, zenith, tilt, turned):
    up_b = np.array([tilt[0], tilt[1], -1.0])
    up_b /= np.linalg.norm(up_b)
    lean = Rotation.align_vectors(up_b[None], np.array([[0.0, 0.0, -1.0]]))[0]
    s_b = lean.apply(sun(azimuth, zenith))
    found = observe(compass.known(), np.minimum(compass.counts(s_b), FULL), turned, up_b, sun_zenith=zenith)
    s_now = Rotation.from_rotvec(turned * up_b).apply(s_b)
    assert angle(found.s_b, s_now) < 0.01
    assert not found.flags & ~(SunFlag.UNCERTAIN | SunFlag.AMBIGUOUS)


def test_counts_that_do_not_repeat_are_of_their_sample(compass):
    turn = compass.turn(0.0, np.random.default_rng(9), samples=12)
    np.testing.assert_array_equal(turn.turned, 0.0)


def test_repeated_counts_are_carried():
    counts = np.array([5.0, 5.0, 6.0, 6.0, 6.0, 7.0])[:, None, None] * np.ones((1, 1, 4))
    yaw = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    turn = Readings(np.arange(6), counts, yaw, np.zeros(6), np.ones(6))  # read every third sample or so
    np.testing.assert_array_equal(turn.fresh[:, 0], [False, False, True, False, False, True])
    np.testing.assert_allclose(turn.read_yaw[:, 0], [0.0, 0.0, 0.15, 0.15, 0.15, 0.45])
    np.testing.assert_allclose(turn.turned[:, 0], [0.0, 0.1, 0.05, 0.15, 0.25, 0.05])


S_B = sun(1.0, 0.8)
BAD = {
    "saturated": (lambda c: np.full_like(c, FULL), SunFlag.SATURATED),
    "black": (np.zeros_like, SunFlag.DARK),
    "overcast": (lambda c: c * 0.0 + 2000.0, SunFlag.UNPOLARIZED),
    "one photodiode of each unit covered": (lambda c: c * np.array([1.0, 0.2, 1.0, 1.0]), SunFlag.MISFIT),
    "not read": (lambda c: c * np.nan, SunFlag.SMALL_WINDOW),
}


@pytest.mark.parametrize(("spoil", "flag"), BAD.values(), ids=BAD.keys())
def test_no_direction_from(compass, spoil, flag):
    known = replace(compass.known(), gains=np.ones((UNITS, 4)), noise=1.0)
    even = replace(compass, gains=np.ones((UNITS, 4)))
    found = observe(known, spoil(np.minimum(even.counts(S_B), FULL)), sun_zenith=0.8)
    assert flag in found.flags
    assert np.isnan(found.s_b).all()


def test_a_covered_unit_has_no_say(compass):
    counts = np.minimum(compass.counts(S_B), FULL)
    counts[5, 0] *= 0.3
    found = observe(compass.known(), counts, sun_zenith=0.8)
    assert found.ok
    assert angle(found.s_b, S_B) < 0.01


def test_night_and_a_wrong_place_are_flagged(compass):
    counts = np.minimum(compass.counts(S_B), FULL)
    assert SunFlag.NIGHT in observe(compass.known(), counts, sun_zenith=1.7).flags
    assert SunFlag.ZENITH_DISAGREES in observe(compass.known(), counts, sun_zenith=1.2).flags


def test_the_plateau():
    rng = np.random.default_rng(0)
    counts = rng.uniform(1000.0, 4000.0, (200, 3, 4))
    assert plateau(counts) == np.inf
    counts[:40, 1] = FULL
    assert plateau(counts) == pytest.approx(0.9 * FULL)


def test_errors_say_what_is_wrong(compass):
    rng = np.random.default_rng(8)
    turn = compass.turn(0.0, rng)
    angles = np.tile(NOMINAL, (UNITS, 1))
    with pytest.raises(DataError, match="no turn"):
        calibrate([], angles)
    with pytest.raises(DataError, match="photodiodes"):
        calibrate([turn], angles[:5])
    with pytest.raises(DataError, match="turned by 113 deg only"):
        calibrate([replace(turn, yaw=turn.yaw * np.pi / 10.0)], angles)
    with pytest.raises(DataError, match="sun was down"):
        calibrate([replace(turn, sun_zenith=turn.sun_zenith + 1.0)], angles)
    with pytest.raises(DataError, match="no unit follows"):
        calibrate([replace(turn, counts=rng.normal(2000.0, 20.0, turn.counts.shape))], angles)
    with pytest.raises(DataError, match="this very compass"):
        observe(compass.known(), turn.counts[0, :5])
