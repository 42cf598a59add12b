"""Places from suns: accuracy, covariance, unknown headings, second places, what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.errors import DataError
from uwgraph.frames import wrap_pi
from uwgraph.sun.ephemeris import sun_azimuth_elevation
from uwgraph.sun.geolocation import FixFlag, locate
from uwgraph.sun.information import rank2
from uwgraph.sun.m_estimate import Loss
from uwgraph.sun.observation import GOOD, SunFlag, SunObservation, level_axes, up_from_tilt

MIDSUMMER_NS = 1_781_913_600 * 10**9  # 20 June 2026
HOUR_NS = 3600 * 10**9
LOSSES: tuple[Loss, ...] = ("l1", "l2", "huber", "soft_l1")


def observed(t, azimuth_b, elevation, sigma, rng=None, flags=GOOD):
    """The sun at an azimuth from the bow, in a body that rolls and pitches, with noise across and along."""
    up_b = up_from_tilt(0.1, -0.05)
    bow, starboard, up = level_axes(up_b)
    s = np.cos(elevation) * (np.cos(azimuth_b) * bow + np.sin(azimuth_b) * starboard) + np.sin(elevation) * up
    E = np.stack([np.cos(azimuth_b) * starboard - np.sin(azimuth_b) * bow, np.zeros(3)], axis=1)
    E[:, 1] = np.cross(E[:, 0], s)
    if rng is not None:
        s = s + E @ (sigma * rng.standard_normal(2))
        s /= np.linalg.norm(s)
    information, cov = rank2(E, np.diag(np.square(sigma)))
    return SunObservation(int(t), s, information, cov, "scattering", 1.0, flags, up_b)


def day_at(lat, lon, rng=None, sigma=(1.0, 1.0), step_h=0.5, hours=24.0, start_ns=MIDSUMMER_NS, least_deg=8.0):
    """Observations over a day and the true headings."""
    t = start_ns + np.arange(0, hours, step_h) * HOUR_NS
    azimuth, elevation = sun_azimuth_elevation(t, lat, lon)
    lit = elevation > np.radians(least_deg)
    heading = (np.random.default_rng(1) if rng is None else rng).uniform(-np.pi, np.pi, int(lit.sum()))
    suns = [
        observed(*row, np.radians(sigma), rng)
        for row in zip(t[lit], azimuth[lit] - heading, elevation[lit], strict=True)
    ]
    return suns, heading


def error_km(fix, lat, lon):
    return 6371.0 * np.array([fix.lat - lat, float(wrap_pi(fix.lon - lon)) * np.cos(lat)])


@settings(max_examples=12, deadline=None)
@given(lat=st.floats(-1.3, 1.1), lon=st.floats(-3.14, 3.14), loss=st.sampled_from(LOSSES))
def test_exact_without_noise(lat, lon, loss):
    suns, heading = day_at(lat, lon, step_h=1.0)
    if len(suns) < 3:
        return
    fix = locate(suns, heading, loss=loss)
    assert np.linalg.norm(error_km(fix, lat, lon)) < 0.1
    assert fix.ok
    assert fix.heading_offset == 0.0
    assert len(fix.used) == len(suns) == len(fix.residuals)


@pytest.mark.parametrize("loss", ["huber", "l1"])
def test_covariance_is_that_of_the_errors(loss):
    nees, miss = [], []
    for seed in range(14):
        rng = np.random.default_rng(seed)
        lat, lon = rng.uniform(-0.9, 0.9), rng.uniform(-np.pi, np.pi)
        suns, heading = day_at(lat, lon, rng, sigma=(1.0, 1.5))
        fix = locate(suns, heading + np.radians(0.5) * rng.standard_normal(len(heading)),
                     heading_sigma=np.radians(0.5), loss=loss)  # fmt: skip
        d = 1e3 * error_km(fix, lat, lon)
        nees.append(d @ np.linalg.solve(fix.cov_ne, d) / 2.0)
        miss.append(np.linalg.norm(d) / 1e3)
    assert 0.4 < np.mean(nees) < 1.6
    assert np.median(miss) < 61.0


def test_constant_heading_error_is_found():
    rng = np.random.default_rng(3)
    suns, heading = day_at(0.6, 1.0, rng)
    offset = np.radians(25.0)
    free = locate(suns, heading - offset, offset_sigma=np.inf)
    assert free.ok
    assert abs(free.heading_offset - offset) < 4.0 * free.heading_offset_sigma
    assert np.degrees(free.heading_offset_sigma) < 2.0
    assert np.linalg.norm(error_km(free, 0.6, 1.0)) < 150.0
    known = locate(suns, heading - offset, declination=offset)
    assert known.cov_ne[1, 1] < free.cov_ne[1, 1]
    ignored = locate(suns, heading - offset)
    assert np.linalg.norm(error_km(ignored, 0.6, 1.0)) > 500.0


def test_a_prior_on_the_offset_lies_between():
    suns, heading = day_at(0.6, 1.0, np.random.default_rng(4))
    none, some, free = (locate(suns, heading, offset_sigma=np.radians(x)) for x in (0.0, 0.5, np.inf))
    assert none.cov_ne[1, 1] < some.cov_ne[1, 1] < free.cov_ne[1, 1]
    assert some.heading_offset_sigma < np.radians(0.55)


def test_wrong_suns_are_outvoted():
    rng = np.random.default_rng(5)
    suns, heading = day_at(0.6, 1.0, rng)
    spoilt = list(suns)
    for i in range(0, len(suns), 6):
        spoilt[i] = observed(suns[i].t_ns, rng.uniform(-3, 3), rng.uniform(0.2, 1.2), np.radians([1.0, 1.0]))

    def pulled_km(loss):
        fixes = [locate(some, heading, loss=loss) for some in (suns, spoilt)]
        return float(np.linalg.norm(np.subtract(*(error_km(fix, 0.6, 1.0) for fix in fixes))))

    assert max(map(pulled_km, ("l1", "huber", "soft_l1"))) < 80.0
    assert pulled_km("l2") > 300.0


def test_flagged_suns_and_missing_headings_are_left_out():
    suns, heading = day_at(0.6, 1.0, np.random.default_rng(6))
    spoilt = [*suns, observed(suns[0].t_ns, 0.0, 1.5, np.radians([0.01, 0.01]), flags=SunFlag.MISFIT), suns[1]]
    fix, plain = locate(spoilt, [*heading, 0.0, np.nan]), locate(suns, heading)
    assert (fix.lat, fix.lon) == (plain.lat, plain.lon)
    np.testing.assert_array_equal(fix.used, np.arange(len(suns)))


def test_one_sun_is_a_place_or_two():
    """Zenith angle and azimuth fix the place on a circle, up to a mirror image: the true place is one of the two."""
    for lat, lon in ((0.6, 1.0), (-0.3, -2.0), (0.1, 0.4)):
        suns, heading = day_at(lat, lon, step_h=1.0, sigma=(0.3, 0.3))
        for i in (0, len(suns) // 2):
            fix = locate(suns[i : i + 1], heading[i : i + 1])
            near = np.linalg.norm(error_km(fix, lat, lon)) < 20.0
            if not near:
                assert FixFlag.AMBIGUOUS in fix.flags
                assert fix.other is not None
                assert np.degrees(np.abs(np.array(fix.other) - [lat, lon]).max()) < 0.2


def test_a_short_time_with_unknown_offset_is_not_confident():
    suns, heading = day_at(
        0.6, 1.0, np.random.default_rng(7), hours=0.6, step_h=0.1, start_ns=MIDSUMMER_NS + 6 * HOUR_NS
    )
    assert len(suns) > 4
    fix = locate(suns, heading, offset_sigma=np.inf)
    d = 1e3 * error_km(fix, 0.6, 1.0)
    assert not fix.ok or d @ np.linalg.solve(fix.cov_ne, d) < 12.0


def test_suns_that_contradict_each_other_are_a_misfit():
    suns, heading = day_at(0.6, 1.0, np.random.default_rng(8), sigma=(0.2, 0.2))
    rng = np.random.default_rng(9)
    fix = locate(suns, heading + np.radians(15.0) * rng.standard_normal(len(heading)))
    assert FixFlag.MISFIT in fix.flags
    assert fix.flags.names()[0] in ("ambiguous", "misfit", "uncertain")


def test_across_the_date_line_and_near_the_pole():
    for lat, lon in ((0.2, np.pi - 1e-3), (1.45, 0.5)):
        suns, heading = day_at(lat, lon, np.random.default_rng(10), sigma=(0.5, 0.5))
        assert np.linalg.norm(error_km(locate(suns, heading), lat, lon)) < 60.0


def test_nothing_to_work_with():
    suns, heading = day_at(0.6, 1.0, hours=12.0, step_h=1.0)
    with pytest.raises(DataError, match="no observation"):
        locate([], [])
    with pytest.raises(DataError, match="headings"):
        locate(suns, heading[:-1])
    with pytest.raises(DataError, match="flags"):
        locate(suns, np.full(len(suns), np.nan))
