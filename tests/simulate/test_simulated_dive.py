"""Whole simulated dives: complete, reproducible, and in agreement with their own rig."""

import numpy as np
import pytest
from pydantic import ValidationError

from uwgraph.errors import ConfigError
from uwgraph.frames import geodetic_from_ned
from uwgraph.simulate import DepthModel, DvlModel, SimulationSettings, simulate, trajectory_of
from uwgraph.types import stream_fields

SHORT = {"duration_s": 200.0, "truth_rate_hz": 5.0}


@pytest.fixture(scope="module")
def dive():
    return simulate(SimulationSettings(**SHORT), seed=5)


def test_every_stream_is_there_with_its_rate(dive):
    counts = {name: len(stream) for name, stream in dive.streams()}
    assert counts["imu"] == 20_000
    assert counts["dvl"] == counts["depth"] == counts["reference"] == 1001
    assert counts["sun"] == 201
    assert 30 < counts["fixes"] < 100
    for name, stream in dive.streams():
        assert (np.diff(stream.t_ns) > 0).all(), name
        for column, values in stream_fields(stream):
            if values.dtype.kind == "f":
                assert np.isfinite(values).all(), f"{name}.{column}"


def test_the_same_seed_gives_the_same_dive(dive):
    again = simulate(SimulationSettings(**SHORT), seed=5)
    for (name, one), (_, two) in zip(dive.streams(), again.streams(), strict=True):
        for (column, a), (_, b) in zip(stream_fields(one), stream_fields(two), strict=True):
            np.testing.assert_array_equal(a, b, err_msg=f"{name}.{column}")
    other = simulate(SimulationSettings(**SHORT), seed=6)
    assert not np.array_equal(other.imu.w_s, dive.imu.w_s)


def test_taking_a_sensor_away_leaves_the_others_as_they_were(dive):
    fewer = simulate(SimulationSettings(**SHORT, dvl=None, sun=None), seed=5)
    assert fewer.dvl is None
    assert fewer.sun is None
    np.testing.assert_array_equal(fewer.imu.f_s, dive.imu.f_s)
    np.testing.assert_array_equal(fewer.depth.depth, dive.depth.depth)


def test_reference_is_the_truth(dive):
    motion = trajectory_of(SimulationSettings(**SHORT), seed=5)
    t = dive.reference.t_s
    lat, lon, height = geodetic_from_ned(dive.origin, motion.position(t))
    np.testing.assert_allclose(dive.reference.lat, lat, atol=1e-12)
    np.testing.assert_allclose(dive.reference.lon, lon, atol=1e-12)
    np.testing.assert_allclose(dive.reference.height, height, atol=1e-9)
    assert dive.reference.t_ns[0] == motion.start_ns


def test_noise_free_streams_are_exact():
    noise_free = simulate(SimulationSettings(**SHORT, grade="noise_free"), seed=5)
    motion = trajectory_of(SimulationSettings(**SHORT), seed=5)
    t = noise_free.dvl.t_s
    v_b = np.einsum("nji,nj->ni", motion.attitude(t), motion.velocity(t))
    v_b += np.cross(motion.angular_rate(t), noise_free.rig.dvl.l_b)
    np.testing.assert_allclose(noise_free.dvl.v_s, v_b, atol=1e-12)
    assert noise_free.provenance["drawn"]["dvl_scale"] == 0.0


def test_rig_and_provenance_state_what_was_drawn(dive):
    drawn = dive.provenance["drawn"]
    exact = simulate(SimulationSettings(**SHORT, grade="noise_free"), seed=5)
    np.testing.assert_allclose(
        (dive.imu.w_s - exact.imu.w_s).mean(axis=0),
        drawn["gyro_bias"],
        atol=4 * dive.rig.imu.gyro_noise_density / np.sqrt(200.0),
    )
    assert abs(drawn["dvl_scale"]) < 4 * dive.rig.dvl.scale_sigma
    assert dive.rig.dvl == DvlModel().rig
    assert dive.rig.depth == DepthModel().rig
    assert SimulationSettings(**dive.provenance["settings"]) == SimulationSettings(**SHORT)


def test_settings_are_strict_and_the_impossible_is_refused():
    with pytest.raises(ValidationError, match="sped"):
        SimulationSettings(sped=2.0)
    with pytest.raises(ValidationError, match="timezone"):
        SimulationSettings(start="2024-09-10T11:00:00")
    with pytest.raises(ConfigError, match="current"):
        simulate(SimulationSettings(current=(1.5, 0.0)))
    with pytest.raises(ConfigError, match="too short") as error:
        simulate(SimulationSettings(duration_s=100.0, surface_at_end=True))
    assert error.value.where == "duration_s"


def test_surfacing_at_the_end_brings_fixes_back():
    for pattern in ("lawnmower", "helix", "transit"):
        up = simulate(
            SimulationSettings(pattern=pattern, duration_s=500.0, surface_at_end=True, imu_rate_hz=10.0), seed=1
        )
        late = up.fixes.t_s > 400.0
        assert late.sum() > 20, pattern
        assert -up.reference.height.min() == pytest.approx(20.0, abs=1.0)


@pytest.mark.parametrize("depth", [0.0, 0.3])
def test_a_vehicle_that_stays_up_never_sinks(depth):
    dive = simulate(SimulationSettings(**SHORT, depth=depth, imu_rate_hz=10.0))
    assert dive.reference.height.min() > -1.0
    assert len(dive.fixes) == 201
