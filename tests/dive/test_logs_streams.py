"""From columns to streams: axes, worlds, units, signs, covariances, pressure, magnetic fields."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.dive import Dive
from uwgraph.dive.logs.axes import turn, turned_attitude, turned_covariance
from uwgraph.dive.logs.mapping import LogMapping
from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.samples import Samples, usable
from uwgraph.dive.logs.streams import BUILDERS
from uwgraph.dive.rig import DepthRig, HeadingRig, Rig
from uwgraph.errors import DataError
from uwgraph.frames import matrix_from_rph, ned_from_geodetic
from uwgraph.types import FloatArray, Origin

START = 1_654_646_400_000_000_000
ORIGIN = Origin(0.75, 0.1)
AXES = ("frd", "flu", "rfu", "luf", "rdf")
FIELDS: dict[str, dict[str, Any]] = {
    "imu": {"f": ["a", "b", "c"], "w": ["d", "e", "f"]},
    "dvl": {"v": ["a", "b", "c"]},
    "depth": {"depth": "a"},
    "fixes": {"lat": "a", "lon": "b"},
    "heading": {"heading": "a"},
    "reference": {"rph": ["a", "b", "c"]},
}


def built(
    stream: str, values: dict[str, Any], mapping: dict[str, Any] | None = None, dive: Dive | None = None
) -> tuple[Any, Notes]:
    """The stream that columns become, in a dive at ORIGIN."""
    columns = {name: np.asarray(column, dtype=float) for name, column in values.items()}
    count = len(next(iter(columns.values())))
    settings = {"topic": "t", **(mapping if mapping is not None else FIELDS[stream])}
    whole = LogMapping.model_validate({"streams": {stream: settings}}).by_stream()[stream]
    notes = Notes()
    samples = usable(stream, Samples(START + np.arange(count) * 10**8, columns), whole, notes)
    return BUILDERS[stream](samples, whole, dive or Dive(ORIGIN), notes), notes


@pytest.mark.parametrize("axes", AXES)
def test_axes_are_right_handed_rotations(axes: str) -> None:
    R = turn(axes)
    np.testing.assert_array_equal(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == 1.0


def test_axes_by_hand() -> None:
    np.testing.assert_array_equal(turn("flu") @ [1, 2, 3], [1, -2, -3])
    np.testing.assert_array_equal(turn("rfu") @ [1, 2, 3], [2, 1, -3])
    np.testing.assert_array_equal(turn("rdf") @ [1, 2, 3], [3, 1, 2])
    np.testing.assert_array_equal(turn("enu") @ [1, 2, 3], [2, 1, -3])
    np.testing.assert_array_equal(turn("nwu") @ [1, 2, 3], [1, -2, -3])


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3), st.sampled_from(AXES), st.sampled_from(["enu", "nwu"]))
def test_an_attitude_written_in_other_axes_comes_back(vector: list[float], axes: str, world: str) -> None:
    R_nb = Rotation.from_rotvec(vector).as_matrix()
    theirs = Rotation.from_matrix(turn(world).T @ R_nb @ turn(axes)).as_quat()
    np.testing.assert_allclose(turned_attitude(theirs[None], axes, world)[0], R_nb, atol=1e-12)


def test_ros_attitude_by_hand() -> None:
    """REP 103: identity is level and looks east; a quarter turn anticlockwise looks north."""
    quarter = Rotation.from_euler("z", 90, degrees=True).as_quat()
    nose_up = Rotation.from_euler("y", -10, degrees=True).as_quat()
    mapping = {"orientation": ["x", "y", "z", "w"], "axes": "flu", "world": "enu", "reference": True}
    heading, _ = built("heading", {"orientation": [[0, 0, 0, 1], quarter, nose_up]}, mapping)
    np.testing.assert_allclose(np.degrees(heading.heading), [90, 0, 90], atol=1e-9)
    assert heading.reference == "true"
    reference, _ = built("reference", {"orientation": [[0, 0, 0, 1], quarter, nose_up]}, mapping_of("orientation"))
    np.testing.assert_allclose(np.degrees(reference.rph[2]), [0, 10, 90], atol=1e-9)


def mapping_of(*names: str, **settings: Any) -> dict[str, Any]:
    counts = {"orientation": 4, "position": 3, "velocity": 3, "rph": 3}
    return {name: [f"{name}{i}" for i in range(counts[name])] for name in names} | settings


def test_imu_is_turned_and_becomes_interval_means() -> None:
    t = np.arange(6.0)
    f = np.column_stack([t, 0 * t + 1, 0 * t + 9.8])
    mapping = FIELDS["imu"] | {"axes": "flu"}
    imu, notes = built("imu", {"f": f, "w": f * 0.1}, mapping)
    assert len(imu) == 5
    assert imu.t_ns[0] == START + 10**8
    np.testing.assert_allclose(imu.f_s, np.column_stack([t[1:] - 0.5, 0 * t[1:] - 1, 0 * t[1:] - 9.8]))
    np.testing.assert_allclose(imu.w_s, imu.f_s * 0.1)
    assert any("flu turned to frd" in note for note in notes.conversions)
    means, _ = built("imu", {"f": f, "w": f}, FIELDS["imu"] | {"sampling": "mean"})
    np.testing.assert_array_equal(means.f_s, f)


def test_a_ping_without_lock_stays_but_is_not_valid() -> None:
    v = [[1.0, 0, 0], [np.nan, 0, 0], [1, 1, 1], [2, 2, 2]]
    dvl, notes = built("dvl", {"v": v, "valid": [1, 1, 0, np.nan]}, FIELDS["dvl"] | {"valid": "ok"})
    np.testing.assert_array_equal(dvl.valid, [True, False, False, False])
    assert any("3 of 4 pings" in note for note in notes.conversions)


@given(st.lists(st.floats(-2.0, 2.0), min_size=9, max_size=9), st.sampled_from(["enu", "nwu", "ned"]))
def test_covariances_turn_with_their_axes(entries: list[float], world: str) -> None:
    A = np.reshape(entries, (3, 3))
    C = A @ A.T + np.eye(3)
    upper = C[np.triu_indices(3)][None]
    R = turn(world)
    np.testing.assert_allclose(turned_covariance(upper, world)[0], R @ C @ R.T, atol=1e-12)


def test_covariances_that_say_nothing_are_unknown() -> None:
    good, zero, minus = [1.0, 0, 0, 4, 0, 9], [0.0] * 6, [-1.0, 0, 0, 0, 0, 0]
    mapping = FIELDS["fixes"] | {"cov": list("cdefgh"), "height": "h"}
    fixes, _ = built(
        "fixes", {"lat": [0.7] * 3, "lon": [0.1] * 3, "height": [1.0] * 3, "cov": [good, zero, minus]}, mapping
    )
    np.testing.assert_array_equal(np.diagonal(fixes.cov_n[0]), [4, 1, 9])  # east, north, up as north, east, down
    assert np.isnan(fixes.cov_n[1:]).all()


def test_a_fix_without_height_says_nothing_of_it() -> None:
    mapping = FIELDS["fixes"] | {"sigma": "s"}
    fixes, _ = built("fixes", {"lat": [0.7], "lon": [0.1], "sigma": [2.0]}, mapping)
    np.testing.assert_array_equal(fixes.cov_n[0], np.diag([4.0, 4.0, np.inf]))
    assert np.isnan(fixes.height).all()


def test_no_fix_is_no_fix() -> None:
    values = {"lat": [0.0, 0.7, 0.7, np.nan], "lon": [0.0, 0.1, 0.1, 0.1], "valid": [3, 3, 1, 3]}
    fixes, notes = built("fixes", values, FIELDS["fixes"] | {"valid": "type", "valid_above": 2})
    assert len(fixes) == 1
    assert "3 of 4" in notes.conversions[0]


@given(st.floats(-5e3, 5e3), st.floats(-5e3, 5e3), st.floats(-50, 0))
def test_local_positions_lie_about_the_origin(east: float, north: float, up: float) -> None:
    fixes, _ = built("fixes", {"position": [[east, north, up]]}, mapping_of("position"))
    ned = ned_from_geodetic(ORIGIN, fixes.lat, fixes.lon, fixes.height)[0]
    np.testing.assert_allclose(ned, [north, east, -up], atol=1e-6)


def test_depth_from_what_logs_have() -> None:
    height, _ = built("depth", {"height": [-3.0, -4.0]}, {"height": "z"})
    np.testing.assert_array_equal(height.depth, [3, 4])
    pressure = 101_325.0 + np.array([0.0] * 60 + [1e5] * 40 + [0.0] * 60)
    stated, _ = built("depth", {"pressure": pressure}, {"pressure": "p"})
    assert stated.depth.max() == pytest.approx(1e5 / (1028.1 * 9.805), rel=1e-3)  # sea water at 43 degrees north
    air = {"pressure": pressure - 2000.0}
    for how in ("first", "least"):
        depth, notes = built("depth", air, {"pressure": "p", "surface_pressure_pa": how})
        np.testing.assert_allclose(depth.depth, stated.depth, atol=1e-9)
        assert f"99325 Pa at the surface ({how})" in notes.conversions[0]


def test_a_distance_that_is_none_is_no_altitude() -> None:
    values = {"altitude": [3.0, -1.0, 0.0, np.nan, 4.0, 5.0], "valid": [1, 1, 1, 1, 0, 1]}
    altitude, notes = built("altitude", values, {"altitude": "a", "valid": "ok"})
    np.testing.assert_array_equal(altitude.altitude, [3, 5])
    assert np.isnan(altitude.sigma).all()
    assert "4 of 6" in notes.conversions[0]


def test_sigmas_that_are_none() -> None:
    depth, _ = built("depth", {"depth": [1.0, 2, 3], "sigma": [0.1, 0.0, -1.0]}, {"depth": "d", "sigma": "s"})
    np.testing.assert_array_equal(depth.sigma, [0.1, np.nan, np.nan])


@pytest.mark.parametrize(("world", "expected"), [("ned", 30.0), ("enu", 60.0), ("nwu", -30.0)])
def test_headings_of_other_conventions(world: str, expected: float) -> None:
    heading, _ = built("heading", {"heading": [np.radians(30)]}, {"heading": "h", "world": world})
    assert np.degrees(heading.heading[0]) == pytest.approx(expected)


@pytest.mark.parametrize("axes", ["frd", "flu"])
def test_a_magnetic_field_is_levelled_by_the_imu(axes: str) -> None:
    """A vehicle that rolls and pitches at a constant heading; the field dips by 60 degrees."""
    n = 400
    t = START + np.arange(n) * 10**8
    phase = np.arange(n) / 30
    rph = np.column_stack([0.3 * np.sin(phase), 0.2 * np.cos(phase), np.full(n, 1.0)])
    R_nb = matrix_from_rph(rph)
    step = Rotation.from_matrix(R_nb[:-1]).inv() * Rotation.from_matrix(R_nb[1:])
    w = np.vstack([[0, 0, 0], step.as_rotvec() * 10.0])
    f = -9.81 * R_nb[:, 2, :]
    field_b = np.einsum("nji,j->ni", R_nb, [25e-6, 0, 43e-6])
    base, _ = built("imu", {"f": f, "w": w}, FIELDS["imu"] | {"sampling": "mean"})
    mapping = {"magnetic_field": list("abc"), "axes": axes}
    heading, notes = built("heading", {"magnetic_field": field_b @ turn(axes)}, mapping, Dive(ORIGIN, imu=base))
    assert len(heading) == len(t)
    assert np.abs(heading.heading - 1.0).max() < np.radians(1.0)
    assert heading.reference == "magnetic"
    assert any("declination_deg" in note for note in notes.caveats)
    declined = Dive(ORIGIN, Rig(heading=HeadingRig(declination_deg=2.0)), imu=base)
    _, notes = built("heading", {"magnetic_field": field_b @ turn(axes)}, mapping, declined)
    assert not any("declination_deg" in note for note in notes.caveats)
    with pytest.raises(DataError, match="only with an IMU"):
        built("heading", {"magnetic_field": field_b}, mapping)


def test_body_velocity_of_a_reference_is_turned() -> None:
    quarter = Rotation.from_euler("z", 90, degrees=True).as_quat()
    values: dict[str, FloatArray | list[Any]] = {
        "orientation": [[0, 0, 0, 1], quarter],
        "velocity": [[1.0, 0, 0], [1.0, 2.0, 0.5]],
    }
    reference, _ = built("reference", values, mapping_of("orientation", "velocity", velocity_in="body"))
    np.testing.assert_allclose(reference.v_n, [[0, 1, 0], [1, -2, -0.5]], atol=1e-12)
    assert np.isnan(reference.lat).all()


def test_thinning_keeps_the_first_of_each_interval() -> None:
    heading, notes = built("heading", {"heading": np.arange(100) * 0.01}, FIELDS["heading"] | {"max_rate_hz": 1.0})
    np.testing.assert_allclose(heading.heading, np.arange(10) * 0.1)
    assert any("thinned from 100 to 10" in note for note in notes.conversions)


def test_the_rig_is_not_touched() -> None:
    dive = replace(Dive(ORIGIN), rig=Rig(depth=DepthRig(sigma=0.3)))
    depth, _ = built("depth", {"depth": [1.0]}, dive=dive)
    assert np.isnan(depth.sigma).all()
