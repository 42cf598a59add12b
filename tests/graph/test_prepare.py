"""One clock and one frame: what the rig says is undone, and what is missing is filled in or refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from graph_dives import ORIGIN, SHORT

from uwgraph.dive import Dive
from uwgraph.dive.rig import DepthRig, DvlRig, FixesRig, HeadingRig, ImuRig, SunRig
from uwgraph.errors import DataError
from uwgraph.graph.prepare import prepare
from uwgraph.simulate import GRADES, DepthModel, DvlModel, GnssModel, HeadingModel, SunModel, simulate

CALM = SHORT.model_copy(update={"grade": "noise_free", "compass": HeadingModel()})
SENSORS = ("dvl", "depth", "fixes", "heading", "sun")


def ideal(rig: ImuRig):
    return GRADES["noise_free"].model_copy(update={"rig": rig})


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate(CALM)


@pytest.mark.parametrize("offset_s", [0.731, -0.4])
def test_the_offset_is_added_to_the_stamps(dive: Dive, offset_s: float) -> None:
    """Clocks that run late or early by the rig's word give the streams of clocks that run right."""
    imu = GRADES["noise_free"].rig.model_copy(update={"time_offset_s": offset_s})
    settings = CALM.model_copy(
        update={
            "grade": ideal(imu),
            "dvl": DvlModel(rig=DvlModel().rig.model_copy(update={"time_offset_s": offset_s})),
            "depth_sensor": DepthModel(rig=DepthModel().rig.model_copy(update={"time_offset_s": offset_s})),
            "gnss": GnssModel(rig=GnssModel().rig.model_copy(update={"time_offset_s": offset_s})),
            "compass": HeadingModel(rig=HeadingRig(time_offset_s=offset_s)),
            "sun": SunModel(rig=SunRig(time_offset_s=offset_s)),
        }
    )
    late = simulate(settings)
    assert late.imu is not None
    assert dive.imu is not None
    assert late.imu.t_ns[0] == dive.imu.t_ns[0] - round(offset_s * 1e9)
    found, expected = prepare(late), prepare(dive)
    np.testing.assert_array_equal(found.imu.t_ns, expected.imu.t_ns)
    for name in SENSORS:
        np.testing.assert_array_equal(getattr(found, name).t_ns, getattr(expected, name).t_ns, err_msg=name)


def test_sensor_axes_become_body_axes(dive: Dive) -> None:
    turned = (10.0, -20.0, 130.0)
    imu = GRADES["noise_free"].rig.model_copy(update={"rotation_deg": turned})
    dvl = DvlModel(rig=DvlModel().rig.model_copy(update={"rotation_deg": turned}))
    mounted = simulate(CALM.model_copy(update={"grade": ideal(imu), "dvl": dvl}))
    assert mounted.dvl is not None
    assert dive.dvl is not None
    assert np.abs(mounted.dvl.v_s - dive.dvl.v_s).max() > 0.5
    found, expected = prepare(mounted), prepare(dive)
    assert found.dvl is not None
    assert expected.dvl is not None
    np.testing.assert_allclose(found.imu.f_b, expected.imu.f_b, atol=1e-12)
    np.testing.assert_allclose(found.imu.w_b, expected.imu.w_b, atol=1e-12)
    np.testing.assert_allclose(found.dvl.v_b, expected.dvl.v_b, atol=1e-12)


def test_the_covariance_of_the_dvl_turns_and_scales_with_it(dive: Dive) -> None:
    assert dive.dvl is not None
    rig = DvlRig(rotation_deg=(0.0, 0.0, 90.0), scale=2.0)
    cov = np.tile(np.diag([1.0, 4.0, 9.0]), (len(dive.dvl), 1, 1))
    prepared = prepare(with_rig(replace(dive, dvl=replace(dive.dvl, cov_s=cov)), dvl=rig))
    assert prepared.dvl is not None
    np.testing.assert_allclose(prepared.dvl.cov_b[0], 4.0 * np.diag([4.0, 1.0, 9.0]), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(prepared.dvl.v_b[0]), 2.0 * np.linalg.norm(dive.dvl.v_s[0]))


def with_rig(dive: Dive, **entries: object) -> Dive:
    return replace(dive, rig=dive.rig.model_copy(update=entries))


def test_what_the_log_does_not_state_comes_from_the_rig(dive: Dive) -> None:
    assert dive.dvl is not None
    assert dive.depth is not None
    assert dive.fixes is not None
    assert dive.heading is not None
    half = {name: getattr(dive, name) for name in SENSORS}
    for name, field in (("dvl", "cov_s"), ("depth", "sigma"), ("fixes", "cov_n"), ("heading", "sigma")):
        stated = np.full_like(getattr(half[name], field), np.nan)
        stated[1::2] = getattr(half[name], field)[1::2]
        half[name] = replace(half[name], **{field: stated})
    rigs = {"dvl": DvlRig(sigma=0.3), "depth": DepthRig(sigma=0.7), "fixes": FixesRig(sigma=5.0)}
    prepared = prepare(with_rig(replace(dive, **half), heading=HeadingRig(sigma_deg=2.0), **rigs))
    assert prepared.dvl is not None
    assert prepared.fixes is not None
    np.testing.assert_allclose(
        prepared.dvl.cov_b[::2], np.broadcast_to(0.09 * np.eye(3), (len(prepared.dvl.t_ns[::2]), 3, 3))
    )
    np.testing.assert_allclose(prepared.dvl.cov_b[1], dive.dvl.cov_s[1])
    np.testing.assert_array_equal(prepared.depth.sigma[::2], 0.7)
    np.testing.assert_array_equal(prepared.depth.sigma[1::2], dive.depth.sigma[1::2])
    np.testing.assert_allclose(prepared.fixes.cov_n[0], 25.0 * np.eye(3))
    np.testing.assert_allclose(prepared.heading.sigma[0], np.radians(2.0))


def test_a_horizontal_fix_keeps_its_infinite_variance(dive: Dive) -> None:
    assert dive.fixes is not None
    cov = dive.fixes.cov_n.copy()
    cov[:, 2, 2] = np.inf
    prepared = prepare(replace(dive, fixes=replace(dive.fixes, cov_n=cov)))
    assert prepared.fixes is not None
    np.testing.assert_array_equal(prepared.fixes.cov_n, cov)


def test_samples_that_cannot_be_used_go(dive: Dive) -> None:
    assert dive.dvl is not None
    valid, v_s = dive.dvl.valid.copy(), dive.dvl.v_s.copy()
    valid[:10], v_s[20:25, 1] = False, np.nan
    prepared = prepare(replace(dive, dvl=replace(dive.dvl, valid=valid, v_s=v_s)))
    whole = prepare(dive)
    assert prepared.dvl is not None
    assert whole.dvl is not None
    assert len(prepared.dvl.t_ns) == len(whole.dvl.t_ns) - 15
    blind = prepare(replace(dive, dvl=replace(dive.dvl, valid=np.zeros_like(valid))))
    assert blind.dvl is None


def test_streams_are_cut_to_the_imu(dive: Dive) -> None:
    assert dive.imu is not None
    prepared = prepare(replace(dive, imu=dive.imu.select(slice(2000, 4000))))
    for name in ("dvl", "depth", "sun", "heading"):
        t = getattr(prepared, name).t_ns
        assert t[0] >= prepared.imu.t_ns[0]
        assert t[-1] <= prepared.imu.t_ns[-1]
    assert prepared.fixes is None or prepared.fixes.t_ns[0] >= prepared.imu.t_ns[0]


@pytest.mark.parametrize("count", [None, 0, 1])
def test_without_an_imu_it_says_what_is_missing(dive: Dive, count: int | None) -> None:
    assert dive.imu is not None
    imu = None if count is None else dive.imu.select(slice(0, count))
    with pytest.raises(DataError, match="no IMU samples") as caught:
        prepare(replace(dive, imu=imu))
    assert caught.value.where == "imu"
    assert "imu.parquet" in caught.value.remedy


def test_a_magnetic_heading_needs_a_declination(dive: Dive) -> None:
    assert dive.heading is not None
    magnetic = replace(dive, heading=replace(dive.heading, reference="magnetic"))
    with pytest.raises(DataError, match="declination") as caught:
        prepare(magnetic)
    assert "rig.heading.declination_deg" in caught.value.remedy
    prepared = prepare(with_rig(magnetic, heading=HeadingRig(declination_deg=3.5)))
    assert prepared.heading is not None
    assert prepared.heading.reference == "true"
    np.testing.assert_allclose(prepared.heading.heading, dive.heading.heading + np.radians(3.5))


def test_an_empty_dive_is_refused() -> None:
    with pytest.raises(DataError, match="no IMU samples"):
        prepare(Dive(ORIGIN))


@pytest.mark.parametrize("first_ms", [-4, 4])
def test_an_imu_that_jitters_at_its_start_is_integrated(dive: Dive, first_ms: int) -> None:
    """The edge before the first sample never lies before what the preintegration takes for it."""
    assert dive.imu is not None
    t_ns = dive.imu.t_ns.copy()
    t_ns[0] += first_ms * 1_000_000
    found = prepare(replace(dive, imu=replace(dive.imu, t_ns=t_ns)))
    assert 2 * t_ns[0] - t_ns[1] <= found.imu.t_ns[0] < t_ns[0]


def test_an_imu_that_is_too_slow_is_refused_with_what_to_log(dive: Dive) -> None:
    assert dive.imu is not None
    rate = 1e9 / np.median(np.diff(dive.imu.t_ns))
    slow = dive.imu.select(slice(None, None, round(rate / 2.0)))
    with pytest.raises(DataError, match=r"2 Hz.*\n.*SR0_RAW_SENS"):
        prepare(replace(dive, imu=slow))
