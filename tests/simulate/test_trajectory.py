"""The truth agrees with itself, with an independent integrator, and with the ellipsoid."""

import numpy as np
import pymap3d
import pytest
from pymap3d.vincenty import vdist
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from uwgraph.dive.rig import ImuRig
from uwgraph.errors import ConfigError
from uwgraph.frames import R_n_local, earth_rate_n, geodetic_from_ned, gravity_n, rph_from_matrix
from uwgraph.simulate import SimulationSettings, trajectory_of
from uwgraph.simulate.imu import ideal_imu
from uwgraph.simulate.plan import smoothstep

PATTERNS = ["lawnmower", "patrol", "helix", "transit"]


def motion(pattern: str = "lawnmower", duration_s: float = 400.0, **settings):
    return trajectory_of(SimulationSettings(pattern=pattern, duration_s=duration_s, **settings), seed=3)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_derivatives_agree_with_finite_differences(pattern):
    m = motion(pattern)
    t = np.random.default_rng(0).uniform(1.0, 399.0, 500)
    h = 1e-3
    np.testing.assert_allclose(m.velocity(t), (m.position(t + h) - m.position(t - h)) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(m.acceleration(t), (m.velocity(t + h) - m.velocity(t - h)) / (2 * h), atol=1e-6)
    step = Rotation.from_matrix(m.attitude(t - h)).inv() * Rotation.from_matrix(m.attitude(t + h))
    np.testing.assert_allclose(m.angular_rate(t), step.as_rotvec() / (2 * h), atol=1e-7)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_no_steps_in_acceleration_or_attitude_rate(pattern):
    m = motion(pattern, surface_at_end=pattern != "helix", duration_s=600.0)
    t = np.arange(0.0, 600.0, 0.01)
    assert np.abs(np.diff(m.acceleration(t), axis=0)).max() / 0.01 < 0.6  # m/s^3
    assert np.abs(np.diff(m.angular_rate(t), axis=0)).max() / 0.01 < 0.3  # rad/s^2


def test_specific_force_and_rate_drive_an_integrator_along_the_truth():
    """Strapdown equations on the rotating Earth in the Earth's own axes, by DOP853, from the inertial truth alone."""
    m = motion(duration_s=200.0)
    w_ie = earth_rate_n(m.origin)

    def derivative(t, y):
        p, v, q = y[:3], y[3:6], Rotation.from_quat(y[6:])
        f_b, w_b = m.inertial(np.array([t]))
        a = q.apply(f_b[0]) + gravity_n(m.origin, p) - 2.0 * np.cross(w_ie, v)
        x, y_, z = w_b[0] - q.apply(w_ie, inverse=True)
        omega = np.array([[0, z, -y_, x], [-z, 0, x, y_], [y_, -x, 0, z], [-x, -y_, -z, 0]])
        return np.concatenate([v, a, 0.5 * omega @ y[6:]])

    start, end = 60.0, 120.0
    q0 = Rotation.from_matrix(m.attitude(np.array([start]))[0]).as_quat()
    y0 = np.concatenate([m.position(start), m.velocity(start), q0])
    run = solve_ivp(derivative, (start, end), y0, method="DOP853", rtol=1e-11, atol=1e-12, max_step=0.25)
    y = run.y[:, -1]
    assert np.linalg.norm(y[:3] - m.position(end)) < 1e-3
    assert np.linalg.norm(y[3:6] - m.velocity(end)) < 1e-5
    turn = Rotation.from_matrix(m.attitude(np.array([end]))[0]).inv() * Rotation.from_quat(
        y[6:] / np.linalg.norm(y[6:])
    )
    assert turn.magnitude() < 1e-7


def test_samples_are_means_over_their_interval():
    m = motion(duration_s=100.0)
    imu = ideal_imu(m, ImuRig(), 10.0)
    fine = (np.arange(2000) + 0.5) / 2000 * 0.1
    for i in (0, 511, 999):
        f, w = m.inertial(i * 0.1 + fine)
        np.testing.assert_allclose(imu.f_s[i], f.mean(axis=0), atol=1e-9)
        np.testing.assert_allclose(imu.w_s[i], w.mean(axis=0), atol=1e-10)
    assert imu.t_ns[0] == m.start_ns + 100_000_000


def test_imu_at_rest_feels_gravity_and_the_earth():
    m = motion("transit", 40.0, surface_time_s=100.0, waves=0.0, current=(0.0, 0.0), heading_deg=0.0)
    f_b, w_b = m.inertial(np.array([10.0]))
    np.testing.assert_allclose(f_b[0], [0.0, 0.0, -np.linalg.norm(gravity_n(m.origin, m.position(10.0)))], atol=1e-6)
    np.testing.assert_allclose(w_b[0], earth_rate_n(m.origin), atol=1e-12)


def test_transit_of_20_km_keeps_depth_and_course_on_the_ellipsoid():
    m = motion("transit", 14_000.0, waves=0.0, current=(0.0, 0.0), heading_deg=70.0)
    t = np.linspace(300.0, 14_000.0, 2000)
    p = m.position(t)
    lat, lon, height = pymap3d.enu2geodetic(p[:, 1], p[:, 0], -p[:, 2], m.origin.lat, m.origin.lon, 0.0, deg=False)
    assert np.hypot(p[-1, 0], p[-1, 1]) > 20_000.0
    np.testing.assert_allclose(-height, 20.0, atol=1e-6)
    assert p[-1, 2] > 20.0 + 31.0, "the sea falls away under the plane of n: 31 m at 20 km"
    # vehicle x axis, course over ground and the geodesic's azimuth, all against local north
    R_lb = np.swapaxes(R_n_local(m.origin, lat, lon), -1, -2) @ m.attitude(t)
    heading = rph_from_matrix(R_lb)[:, 2]
    v_l = np.einsum("nji,nj->ni", R_n_local(m.origin, lat, lon), m.velocity(t))
    np.testing.assert_allclose(heading, np.arctan2(v_l[:, 1], v_l[:, 0]), atol=2e-5)
    _, back = vdist(np.degrees(lat[-1]), np.degrees(lon[-1]), np.degrees(m.origin.lat), np.degrees(m.origin.lon))
    assert np.degrees(heading[-1]) == pytest.approx(back - 180.0, abs=2e-3)
    np.testing.assert_allclose(rph_from_matrix(R_lb)[:, :2], 0.0, atol=1e-6)


def test_current_is_held_by_crabbing():
    m = motion("transit", 300.0, waves=0.0, heading_deg=30.0, current=(0.3, -0.4))
    v = m.velocity(np.array([280.0]))[0]
    assert np.degrees(np.arctan2(v[1], v[0])) == pytest.approx(30.0, abs=0.01)
    v_b = m.attitude(np.array([280.0]))[0].T @ v
    assert abs(v_b[1]) > 0.3, "the DVL sees the sideslip"


def test_patrol_comes_back_to_its_track_in_a_current():
    p = motion("patrol", 1800.0, leg_length_m=60.0, line_spacing_m=30.0).position(np.arange(100.0, 1800.0))[:, :2]
    first, later = p[:250], p[800:]
    apart = np.linalg.norm(first[:, None] - later[None], axis=2).min(axis=1)
    assert apart.max() < 2.0  # half a second of way each, and the wobble
    assert np.ptp(p, axis=0).min() > 30.0


def test_patrol_that_the_current_closes_is_refused():
    with pytest.raises(ConfigError, match="no rectangle"):
        motion("patrol", 600.0, leg_length_m=2.0, line_spacing_m=2.0, current=(-0.9, -0.6))


def test_lawnmower_covers_an_area_and_helix_turns():
    t = np.arange(60.0, 1200.0)
    p = motion("lawnmower", 1200.0).position(t)
    R = np.array([[np.cos(np.pi / 6), np.sin(np.pi / 6)], [-np.sin(np.pi / 6), np.cos(np.pi / 6)]])
    along, across = (p[:, :2] @ R.T).T
    assert 150.0 < np.ptp(along) < 300.0
    assert 100.0 < np.ptp(across) < 400.0
    h = motion("helix", 1200.0, depth=40.0)
    assert abs(h.rph_n(1200.0)[2] - h.rph_n(60.0)[2]) > 2 * np.pi * 7
    _, _, height = geodetic_from_ned(h.origin, h.position(np.array([1200.0])))
    assert height[0] == pytest.approx(-40.0, abs=0.5)


def test_smoothstep_is_flat_at_its_ends():
    x = np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
    np.testing.assert_allclose(smoothstep(x), [0, 0, 0.5, 1, 1], atol=1e-14)
    assert smoothstep(np.array([1e-3]))[0] < 1.3e-13
