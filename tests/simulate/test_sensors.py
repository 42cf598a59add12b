"""Each sensor against geometry worked out by hand, and its noise against what its rig states."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.dive.rig import DepthRig, DvlRig, FixesRig, HeadingRig
from uwgraph.errors import DataError
from uwgraph.frames import geodetic_from_ned, matrix_from_rph, ned_from_geodetic, wrap_pi
from uwgraph.simulate import DepthModel, DvlModel, GnssModel, HeadingModel, SunModel
from uwgraph.simulate.noise import Noise
from uwgraph.simulate.sensors import (
    DvlErrors,
    measure_depth,
    measure_dvl,
    measure_fixes,
    measure_heading,
    measure_sun,
)
from uwgraph.sun import sun_direction_n
from uwgraph.types import Origin

ORIGIN = Origin(lat=0.75, lon=0.13)
NOON_NS = 1_725_966_000_000_000_000  # 2024-09-10T11:00:00Z
SILENT = Noise.of(0, "nobody", silent=True)
NO_ERRORS = DvlErrors(0.0, np.zeros(3))


@dataclass(frozen=True)
class SteadyTurn:
    """Constant attitude rate about the body's z axis from a fixed attitude, constant velocity in n."""

    origin: Origin = ORIGIN
    start_ns: int = NOON_NS
    duration_s: float = 100.0
    place: tuple[float, float, float] = (30.0, -40.0, 12.0)
    v_n: tuple[float, float, float] = (1.0, 0.5, 0.1)
    rph: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: float = 0.0

    def position(self, t):
        return np.array(self.place) + t[:, None] * np.array(self.v_n)

    def velocity(self, t):
        return np.tile(self.v_n, (len(t), 1))

    def attitude(self, t):
        about_z = np.stack([0 * t, 0 * t, self.turn * t], axis=-1)
        return matrix_from_rph(self.rph) @ matrix_from_rph(about_z)

    def angular_rate(self, t):
        return np.tile([0.0, 0.0, self.turn], (len(t), 1))


def test_dvl_by_hand():
    """Heading east at 1 m/s north: velocity to port. A DVL 2 m ahead in a turn of 0.1 rad/s moves 0.2 m/s sideways."""
    motion = SteadyTurn(v_n=(1.0, 0.0, 0.0), rph=(0.0, 0.0, np.pi / 2), turn=0.1)
    rig = DvlRig(translation_m=(2.0, 0.0, 0.0), rotation_deg=(0.0, 0.0, 90.0), scale=1.25)
    dvl = measure_dvl(motion, DvlModel(rig=rig), NO_ERRORS, SILENT)
    v_b = np.array([0.0, -1.0 + 0.2, 0.0])
    v_s = np.array([v_b[1], -v_b[0], 0.0]) / 1.25
    np.testing.assert_allclose(dvl.v_s[0], v_s, atol=1e-12)
    np.testing.assert_allclose(dvl.v_s[0] @ rig.R_bs.T * rig.scale, v_b, atol=1e-12)


def test_dvl_scale_and_misalignment_have_the_stated_size():
    rig = DvlRig(scale_sigma=0.004, misalignment_sigma_deg=0.3)
    drawn = [DvlErrors.draw(rig, Noise.of(seed, "dvl calibration")) for seed in range(2000)]
    assert np.std([d.scale for d in drawn]) == pytest.approx(0.004, rel=0.07)
    np.testing.assert_allclose(np.std([d.misalignment for d in drawn], axis=0), np.radians(0.3), rtol=0.07)
    motion = SteadyTurn(v_n=(1.0, 0.0, 0.0))
    dvl = measure_dvl(motion, DvlModel(), DvlErrors(0.01, np.array([0.0, 0.0, 0.02])), SILENT)
    np.testing.assert_allclose(dvl.v_s[0], np.array([np.cos(0.02), -np.sin(0.02), 0.0]) / 1.01, atol=1e-12)


def test_dvl_noise_outliers_and_lost_bottom():
    motion = SteadyTurn(duration_s=4000.0)
    model = DvlModel(outlier_fraction=0.05, outlier_sigma=2.0, lost_s=((100.0, 160.0),), losses_per_hour=20.0)
    dvl = measure_dvl(motion, model, NO_ERRORS, Noise.of(4, "dvl"))
    expected = motion.velocity(np.zeros(1))[0]
    t = dvl.t_s
    assert not dvl.valid[(t >= 100.0) & (t < 160.0)].any()
    np.testing.assert_array_equal(dvl.v_s[~dvl.valid], 0.0)
    lost_at_random = 1.0 - dvl.valid.mean() - 60.0 / 4000.0
    assert 0.02 < lost_at_random < 0.11, "22 losses of 10 s on average in 4000 s: 0.055"
    residual = (dvl.v_s - expected)[dvl.valid]
    outlier = np.abs(residual).max(axis=1) > 0.06
    assert outlier.mean() == pytest.approx(0.05, abs=0.006)
    assert residual[outlier].std() == pytest.approx(2.0, rel=0.1)
    assert residual[~outlier].std() == pytest.approx(model.rig.sigma, rel=0.02)


def test_depth_is_of_the_sensor_and_noisy_as_stated():
    motion = SteadyTurn(rph=(0.0, np.radians(30.0), 0.0), v_n=(0.0, 0.0, 0.0), duration_s=2000.0)
    rig = DepthRig(translation_m=(2.0, 0.0, 0.0), sigma=0.05)
    _, _, height = geodetic_from_ned(ORIGIN, motion.position(np.zeros(1)))
    exact = measure_depth(motion, DepthModel(rig=rig), SILENT)
    np.testing.assert_allclose(exact.depth, -height[0] - 1.0, atol=1e-4)  # nose up: the bow is 1 m higher
    noisy = measure_depth(motion, DepthModel(rig=rig), Noise.of(1, "depth"))
    assert (noisy.depth - exact.depth).std() == pytest.approx(0.05, rel=0.03)


def test_fixes_come_only_with_the_antenna_above_water():
    motion = SteadyTurn(place=(0.0, 0.0, 0.0), v_n=(0.0, 0.0, 0.1))
    model = GnssModel(rig=FixesRig(translation_m=(-0.5, 0.0, -0.75), sigma=2.0))
    fixes = measure_fixes(motion, model, SILENT)
    assert fixes.t_s[-1] == 7.0, "0.75 m of mast at 0.1 m/s"
    p_n = ned_from_geodetic(ORIGIN, fixes.lat, fixes.lon, fixes.height)
    np.testing.assert_allclose(p_n, motion.position(fixes.t_s) + model.rig.l_b, atol=1e-6)
    np.testing.assert_allclose(fixes.cov_n[0], 4.0 * np.eye(3))
    assert len(measure_fixes(SteadyTurn(), model, SILENT)) == 0


def test_heading_is_against_the_local_meridian():
    """11 km east of the origin at 43 N the meridians have converged by 0.09 deg."""
    motion = SteadyTurn(place=(0.0, 11_000.0, 0.0), rph=(0.0, 0.0, 1.0), v_n=(0.0, 0.0, 0.0), duration_s=3000.0)
    exact = measure_heading(motion, HeadingModel(), SILENT)
    lat, lon, _ = geodetic_from_ned(ORIGIN, motion.position(np.zeros(1)))
    convergence = (lon[0] - ORIGIN.lon) * np.sin(0.5 * (lat[0] + ORIGIN.lat))
    assert exact.heading[0] - 1.0 == pytest.approx(convergence, rel=0.02)
    noisy = measure_heading(motion, HeadingModel(rig=HeadingRig(sigma_deg=0.5)), Noise.of(2, "heading"))
    assert np.degrees((noisy.heading - exact.heading).std()) == pytest.approx(0.5, rel=0.05)
    np.testing.assert_allclose(noisy.sigma, np.radians(0.5))


@given(
    rph=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-3.0, 3.0)),
    sigmas=st.tuples(st.floats(0.1, 2.0), st.floats(0.1, 2.0)),
)
@settings(max_examples=20, deadline=None)
def test_sun_noise_is_what_its_information_states(rph, sigmas):
    motion = SteadyTurn(rph=rph, v_n=(0.0, 0.0, 0.0), duration_s=1000.0)
    model = SunModel(azimuth_sigma_deg=sigmas[0], elevation_sigma_deg=sigmas[1])
    sun = measure_sun(motion, model, Noise.of(7, "sun"))
    t = sun.t_s
    lat, lon, _ = geodetic_from_ned(ORIGIN, motion.position(t))
    s_b = np.einsum("nji,nj->ni", motion.attitude(t), sun_direction_n(ORIGIN, sun.t_ns, lat, lon))
    chi2 = np.einsum("ni,nij,nj->n", s_b, sun.information_b, s_b)
    assert chi2.mean() == pytest.approx(2.0, abs=0.3)
    np.testing.assert_allclose(np.linalg.norm(sun.s_b, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", sun.information_b, sun.s_b), 0.0, atol=1e-6)
    assert (np.linalg.matrix_rank(sun.information_b, tol=1.0) == 2).all()
    projector = np.einsum("nij,njk->nik", sun.information_b, sun.cov_b)
    np.testing.assert_allclose(projector, np.eye(3) - np.einsum("ni,nj->nij", sun.s_b, sun.s_b), atol=1e-9)


def test_sun_azimuth_noise_is_the_heading_noise():
    motion = SteadyTurn(v_n=(0.0, 0.0, 0.0), duration_s=3000.0)
    exact = measure_sun(motion, SunModel(), SILENT)
    sun = measure_sun(motion, SunModel(azimuth_sigma_deg=0.5, elevation_sigma_deg=0.2), Noise.of(3, "sun"))
    azimuth = wrap_pi(np.arctan2(sun.s_b[:, 1], sun.s_b[:, 0]) - np.arctan2(exact.s_b[:, 1], exact.s_b[:, 0]))
    elevation = np.arcsin(sun.s_b[:, 2]) - np.arcsin(exact.s_b[:, 2])
    assert np.degrees(azimuth.std()) == pytest.approx(0.5, rel=0.05)
    assert np.degrees(elevation.std()) == pytest.approx(0.2, rel=0.05)


def test_no_sun_at_night():
    with pytest.raises(DataError, match="below 5 deg"):
        measure_sun(SteadyTurn(start_ns=NOON_NS + 12 * 3600 * 10**9), SunModel(), SILENT)


def test_time_offset_brings_the_stamps_back():
    model = DepthModel(rig=DepthRig(time_offset_s=0.37))
    depth = measure_depth(SteadyTurn(), model, SILENT)
    assert depth.t_ns[0] + model.rig.time_offset_ns == NOON_NS


def test_a_single_fix_is_still_an_array():
    fixes = measure_fixes(SteadyTurn(place=(5.0, 6.0, -1.0), duration_s=0.5), GnssModel(), SILENT)
    assert fixes.lat.shape == fixes.lon.shape == fixes.height.shape == (1,)
