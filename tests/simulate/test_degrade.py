"""Simulated sensors on dives that bring a reference of their own, simulated and real."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uwgraph.dive.readers import guess_reader
from uwgraph.errors import DataError
from uwgraph.frames import matrix_from_rph, wrap_pi
from uwgraph.simulate import (
    GRADES,
    DvlModel,
    SimulationSettings,
    add_depth,
    add_dvl,
    add_fixes,
    add_sun,
    add_sun_heading,
    degrade_imu,
    simulate,
    trajectory_of,
)
from uwgraph.simulate.replay import ReferenceMotion

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
SETTINGS = SimulationSettings(duration_s=300.0, truth_rate_hz=5.0, grade="noise_free", lat_deg=60.0)


@pytest.fixture(scope="module")
def dive():
    return simulate(SETTINGS, seed=2)


def real(name: str):
    if not (DATA / name).is_dir():
        pytest.skip(f"no {DATA / name}: set UWGRAPH_DATA to the folder of the recordings")
    reader, _ = guess_reader(DATA / name)
    return reader.read(DATA / name)


def test_reference_motion_is_close_to_the_motion_it_came_from(dive):
    """At 5 Hz: cubic interpolation of periods of 4 s and more."""
    motion, back = trajectory_of(SETTINGS, seed=2), ReferenceMotion.of(dive)
    t = np.random.default_rng(0).uniform(1.0, 299.0, 1000)
    np.testing.assert_allclose(back.position(t), motion.position(t), atol=1e-5)
    np.testing.assert_allclose(back.velocity(t), motion.velocity(t), atol=2e-4)
    np.testing.assert_allclose(back.attitude(t), motion.attitude(t), atol=1e-4)
    np.testing.assert_allclose(back.angular_rate(t), motion.angular_rate(t), atol=1e-3)


def test_reference_without_velocity_still_moves(dive):
    blind = replace(dive, reference=replace(dive.reference, v_n=np.full_like(dive.reference.v_n, np.nan)))
    t = np.linspace(1.0, 299.0, 500)
    np.testing.assert_allclose(ReferenceMotion.of(blind).velocity(t), ReferenceMotion.of(dive).velocity(t), atol=2e-3)


def test_degraded_imu_is_worse_by_what_the_rig_states(dive):
    worse = degrade_imu(dive, "mems", seed=3)
    added = worse.imu.w_s - dive.imu.w_s
    mems = GRADES["mems"].rig
    assert added.std(axis=0) == pytest.approx(mems.gyro_noise_density * 10.0, rel=0.05)
    assert worse.rig.imu.gyro_bias_sigma == pytest.approx(np.hypot(mems.gyro_bias_sigma, 1e-7))
    assert worse.rig.dvl == dive.rig.dvl
    assert worse.provenance["simulated"]["imu"].startswith("simulated: errors added")
    np.testing.assert_array_equal(worse.imu.t_ns, dive.imu.t_ns)
    np.testing.assert_array_equal(degrade_imu(dive, "mems", seed=3).imu.w_s, worse.imu.w_s)
    biases = [(degrade_imu(dive, "mems", seed=s).imu.w_s - dive.imu.w_s).mean(axis=0) for s in range(12)]
    assert np.std(biases) == pytest.approx(mems.gyro_bias_sigma, rel=0.4)


def test_added_streams_agree_with_the_reference(dive):
    bare = replace(dive, dvl=None, depth=None, fixes=None, sun=None)
    full = add_sun_heading(bare, 0.5, 1.0, seed=4)
    for add in (add_sun, add_dvl, add_depth, add_fixes):
        full = add(full, seed=4)
    assert set(full.provenance["simulated"]) == {"heading", "sun", "dvl", "depth", "fixes"}
    assert all(text.startswith("simulated: ") for text in full.provenance["simulated"].values())
    np.testing.assert_allclose(full.depth.depth.mean(), dive.depth.depth.mean(), atol=0.01)
    np.testing.assert_allclose(full.sun.s_b, dive.sun.s_b, atol=0.06)
    assert len(full.fixes) == len(dive.fixes)
    error = wrap_pi(full.heading.heading - np.interp(full.heading.t_s, dive.reference.t_s, unwrapped(dive)))
    assert np.degrees(error.std()) == pytest.approx(0.5, rel=0.15)
    slip = full.dvl.v_s - dive.dvl.v_s
    assert np.abs(slip.mean(axis=0)).max() < 0.03, "scale and misalignment are drawn"
    assert slip.std(axis=0) == pytest.approx(DvlModel().rig.sigma, rel=0.2)
    assert full.heading.reference == "true"


def unwrapped(dive):
    return np.unwrap(dive.reference.rph[:, 2])


def test_what_cannot_be_done_is_refused(dive):
    with pytest.raises(DataError, match="no reference"):
        add_sun_heading(replace(dive, reference=None))
    with pytest.raises(DataError, match="no IMU"):
        degrade_imu(replace(dive, imu=None))
    with pytest.raises(DataError, match="fewer than two"):
        add_dvl(replace(dive, reference=replace(dive.reference, rph=np.full_like(dive.reference.rph, np.nan))))
    backward = dive.imu.t_ns.copy()
    backward[10] = backward[9]
    with pytest.raises(DataError, match="after sample 9"):
        degrade_imu(replace(dive, imu=replace(dive.imu, t_ns=backward)))
    submerged = dive.reference.select(slice(1000, None))
    with pytest.raises(DataError, match="under water"):
        add_fixes(replace(dive, reference=submerged))


@pytest.mark.data
def test_sun_heading_and_mems_errors_on_a_real_auv():
    dive = real("snapir/Trajectory1")
    aided = add_sun_heading(degrade_imu(dive, "mems", seed=1), 0.5, 1.0, seed=1)
    assert len(aided.heading) == pytest.approx(len(dive.reference), abs=2)
    error = wrap_pi(aided.heading.heading - np.interp(aided.heading.t_s, dive.reference.t_s, unwrapped(dive)))
    assert np.degrees(error.std()) == pytest.approx(0.5, rel=0.12)
    assert aided.rig.imu.gyro_noise_density > GRADES["mems"].rig.gyro_noise_density


@pytest.mark.data
def test_velocity_and_depth_on_a_real_mav():
    dive = add_depth(add_dvl(real("euroc"), seed=1), seed=1)
    reference = dive.reference
    v_b = np.einsum("nji,nj->ni", matrix_from_rph(reference.rph), reference.v_n)
    error = dive.dvl.v_s - np.stack([np.interp(dive.dvl.t_s, reference.t_s, v) for v in v_b.T], axis=-1)
    assert np.median(np.abs(error)) < 0.3, "the lever arm times the rate, and noise"
    assert -dive.depth.depth.mean() == pytest.approx(reference.height.mean(), abs=0.3)
