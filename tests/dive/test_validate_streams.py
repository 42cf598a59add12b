"""What a stream in memory must satisfy, beyond what a file can get wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwgraph.dive import Dive
from uwgraph.dive.validate import LATEST_NS, validate_dive, validate_stream
from uwgraph.errors import DataError
from uwgraph.types import Altitude, Depth, Dvl, Fixes, Imu, Origin, RelativePoses, Sun

START = 1_654_646_400_000_000_000
T = START + np.arange(4) * 10**8


def imu() -> Imu:
    return Imu(T, np.tile([0.0, 0.0, -9.8], (4, 1)), np.zeros((4, 3)))


def refused(name: str, stream: object, *words: str) -> None:
    with pytest.raises(DataError) as caught:
        validate_stream(name, stream, "FILE")  # type: ignore[arg-type]
    assert caught.value.where.startswith("FILE")
    assert caught.value.remedy
    for word in words:
        assert word in str(caught.value)


def test_shapes_and_types() -> None:
    refused("imu", replace(imu(), f_s=np.zeros((3, 3))), "FILE: f_s", "(3, 3), (4, 3) is needed")
    refused("imu", replace(imu(), w_s=np.zeros(4)), "FILE: w_s")
    refused("imu", replace(imu(), t_ns=T.astype(float)), "float64", "int64")
    refused("imu", imu().select(slice(0, 0)), "no samples")
    refused("depth", Depth(T, np.ones((4, 1)), np.ones(4)), "FILE: depth")


@pytest.mark.parametrize("field", ["f_s", "w_s"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_fault_is_named_by_its_column(field: str, axis: int) -> None:
    values = getattr(imu(), field).copy()
    values[2, axis] = np.nan
    refused("imu", replace(imu(), **{field: values}), f"FILE: {field[0]}_{'xyz'[axis]}", "row 3")


@pytest.mark.parametrize(
    ("i", "j", "column"), [(0, 0, "xx"), (0, 2, "xz"), (1, 2, "yz"), (2, 1, "xz yz"), (2, 2, "zz")]
)
def test_a_fault_in_a_matrix_is_named_by_its_column(i: int, j: int, column: str) -> None:
    cov = np.tile(np.eye(3), (4, 1, 1))
    cov[1, i, j] = np.inf
    dvl = Dvl(T, np.ones((4, 3)), cov, np.ones(4, dtype=bool))
    refused("dvl", dvl, f"FILE: cov_{column.split()[-1]}", "row 2")


def test_covariances() -> None:
    def fixes(cov: np.ndarray) -> Fixes:
        place = (np.full(4, 0.5), np.full(4, 0.6), np.zeros(4))
        return Fixes(T, *place, np.tile(cov, (4, 1, 1)), np.full(4, "gnss"))

    for fine in (np.eye(3), np.diag([1, 1, np.inf]), np.full((3, 3), np.nan), np.zeros((3, 3))):
        validate_stream("fixes", fixes(fine), "FILE")
    refused("fixes", fixes(np.diag([1, -1, 1])), "no covariance")
    refused("fixes", fixes(np.diag([1, -1, np.inf])), "no covariance")
    refused("fixes", fixes(np.array([[1, 2, 0], [2, 1, 0], [0, 0, 1.0]])), "no covariance")
    refused("fixes", fixes(np.array([[1, np.nan, 0], [np.nan, 1, 0], [0, 0, 1.0]])), "in part")


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda s: np.linalg.norm(s) > 0.1), st.floats(1, 1e9))
def test_rank_two_information_passes_whatever_its_rounding(direction: list[float], size: float) -> None:
    s = np.array(direction) / np.linalg.norm(direction)
    information = size * (np.eye(3) - np.outer(s, s))
    sun = Sun(
        T[:1],
        *(
            information[None],
            s[None],
            np.full((1, 3, 3), np.nan),
            np.array(["made"]),
            np.ones(1),
            np.zeros(1, np.int64),
        ),
    )
    validate_stream("sun", sun, "FILE")
    refused("sun", replace(sun, s_b=1.1 * sun.s_b), "unit vector")


def test_a_fast_but_possible_vehicle_passes() -> None:
    rng = np.random.default_rng(0)
    t = START + np.arange(1000) * 10**7
    quick = Imu(t, rng.normal((3, 0, -9.8), 5, (1000, 3)), rng.normal(0, 1.0, (1000, 3)))
    validate_stream("imu", quick, "FILE")
    validate_stream("dvl", Dvl(t[:1], np.full((1, 3), 8.0), np.full((1, 3, 3), np.nan), np.ones(1, bool)), "FILE")
    validate_stream("depth", Depth(t[:1], np.array([-0.3]), np.array([np.nan])), "FILE")


@given(st.lists(st.integers(0, LATEST_NS + 10**18), min_size=2, max_size=6))
def test_stamps_pass_only_in_order_and_in_range(stamps: list[int]) -> None:
    t = np.array(stamps, dtype=np.int64)
    depth = Depth(t, np.ones(len(t)), np.ones(len(t)))
    fine = bool((np.diff(t) > 0).all()) and t[0] >= 631_152_000 * 10**9 and t[-1] <= LATEST_NS
    if fine:
        validate_stream("depth", depth, "FILE")
    else:
        refused("depth", depth, "FILE: t_ns")


def test_a_dive_names_the_stream() -> None:
    upside_down = replace(imu(), f_s=-imu().f_s)
    with pytest.raises(DataError, match="upside down") as caught:
        validate_dive(Dive(Origin(0, 0), imu=upside_down), "SRC")
    assert caught.value.where.startswith("SRC/imu")


def relative_poses() -> RelativePoses:
    none = np.zeros((4, 3))
    cov = np.tile(np.eye(6), (4, 1, 1))
    return RelativePoses(T, T - 10**9, none, none, cov, np.ones(4, bool), np.full(4, "plane"), np.full(4, 30))


def test_relative_poses() -> None:
    poses = relative_poses()
    validate_stream("odometry", poses, "FILE")
    refused("closures", replace(poses, from_ns=T), "row 1", "FILE: from_ns")
    refused("closures", replace(poses, rotvec=np.tile([3.0, 1.0, 1.0], (4, 1))), "half a turn")
    refused("closures", replace(poses, cov=np.zeros((4, 6, 6))), "variance of zero")
    refused("closures", replace(poses, cov=poses.cov[:, :3, :3]), "(4, 6, 6) is needed")


@pytest.mark.parametrize(("i", "j", "column"), [(0, 0, "rxrx"), (0, 5, "rxpz"), (4, 2, "rzpy"), (5, 5, "pzpz")])
def test_a_fault_in_a_covariance_of_poses_is_named_by_its_column(i: int, j: int, column: str) -> None:
    cov = relative_poses().cov.copy()
    cov[2, i, j] = np.nan
    refused("odometry", replace(relative_poses(), cov=cov), f"FILE: cov_{column}", "row 3")


def test_altitudes() -> None:
    validate_stream("altitude", Altitude(T, np.ones(4), np.full(4, np.nan)), "FILE")
    refused("altitude", Altitude(T, np.array([1.0, 0.0, 1.0, 1.0]), np.ones(4)), "row 2", "FILE: altitude")
    refused("altitude", Altitude(T, np.ones(4), np.zeros(4)), "FILE: sigma")
