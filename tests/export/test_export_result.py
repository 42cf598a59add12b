"""The output folder of ``smooth`` read back, and what must not be believed of it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hand_made import ORIGIN, truth
from hypothesis import given
from hypothesis import strategies as st

from uwgraph.dive.model import Dive
from uwgraph.errors import DataError, UwgraphError
from uwgraph.evaluate import people, write_solution
from uwgraph.export import Track, read_result, track_of_reference, track_of_solution
from uwgraph.export.track import thinned
from uwgraph.frames import geodetic_from_ned, ned_from_geodetic, origin_from
from uwgraph.types import Origin, Solution, stream_fields


def result_of(solution: Solution, folder: Path) -> Path:
    write_solution(solution, folder, {}, {}, "")
    return folder


@pytest.fixture
def result(tmp_path: Path) -> Path:
    return result_of(truth(), tmp_path / "out")


def test_every_state_comes_back(result: Path) -> None:
    solution, track = truth(), read_result(result)
    assert track.t_ns.tolist() == solution.t_ns.tolist()
    apart = ned_from_geodetic(ORIGIN, track.origin.lat, track.origin.lon, 0.0)
    assert np.linalg.norm(apart) < 1e-7
    np.testing.assert_allclose(track.R_nb, solution.R_nb, atol=1e-9)
    np.testing.assert_array_equal(track.p_n, solution.p_n)
    np.testing.assert_array_equal(track.v_n, solution.v_n)
    np.testing.assert_array_equal(track.bias_gyro, solution.bias_gyro)
    np.testing.assert_array_equal(track.bias_accel, solution.bias_accel)
    np.testing.assert_allclose(track.cov_p_n, people(solution).cov_p_n, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(track.sigma_v, 1e-2)
    np.testing.assert_allclose(track.sigma_bias_accel, 1e-4)


def test_a_fresh_solution_is_the_same_track(result: Path) -> None:
    read, fresh = read_result(result), track_of_solution(truth())
    for (name, a), (_, b) in zip(stream_fields(read), stream_fields(fresh), strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)


def test_without_covariances(tmp_path: Path) -> None:
    solution = truth()
    bare = replace(solution, **{k: getattr(solution, k) * np.nan for k in ("cov_pose", "cov_v", "cov_bias")})
    track = read_result(result_of(bare, tmp_path / "bare"))
    assert np.isnan(track.sigma_p).all()
    assert np.isfinite(track.p_n).all()


@given(
    lat=st.floats(-1.5, 1.5),
    lon=st.floats(-3.14, 3.14),
    p_n=st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.floats(-100, 1.1e4)),
)
def test_the_origin_follows_from_one_place(lat: float, lon: float, p_n: tuple[float, float, float]) -> None:
    origin = Origin(lat, lon)
    place = (float(x) for x in geodetic_from_ned(origin, np.array(p_n)))
    found = origin_from(*place, np.array(p_n))
    assert np.linalg.norm(ned_from_geodetic(origin, found.lat, found.lon, 0.0)) < 1e-6


def changed(result: Path, **columns: object) -> None:
    table = pd.read_parquet(result / "solution.parquet").assign(**columns)
    table.to_parquet(result / "solution.parquet")


@pytest.mark.parametrize(
    ("column", "row", "value", "words"),
    [
        ("lat_deg", 7, 44.0, "two places"),
        ("north", 7, np.nan, "north"),
        ("bias_gyro_y", 3, np.inf, "bias_gyro"),
        ("east", 3, 1e300, "east"),
        ("sigma_down", 3, 1e300, "sigma_down"),
        ("lat_deg", 0, 95.0, "latitude"),
        ("heading_deg", 5, 4000.0, "heading_deg"),
        ("t_ns", 9, 12, "t_ns"),
    ],
)
def test_what_cannot_be_is_named(result: Path, column: str, row: int, value: float, words: str) -> None:
    values = pd.read_parquet(result / "solution.parquet")[column].to_numpy().copy()
    values[row] = value
    changed(result, **{column: values})
    with pytest.raises(DataError, match=words) as told:
        read_result(result)
    assert "solution.parquet" in told.value.where


def test_a_missing_column_is_named(result: Path) -> None:
    pd.read_parquet(result / "solution.parquet").drop(columns="v_e").to_parquet(result / "solution.parquet")
    with pytest.raises(DataError, match="v_e"):
        read_result(result)


def test_a_folder_of_something_else(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no result"):
        read_result(tmp_path)


def test_damaged_tables_are_errors_for_people(result: Path) -> None:
    """Whatever bytes are flipped or cut: the track, or an error of ours."""
    whole = (result / "solution.parquet").read_bytes()
    rng = np.random.default_rng(5)
    for _ in range(200):
        damaged = bytearray(whole[: rng.integers(1, len(whole) + 1)] if rng.random() < 0.3 else whole)
        for place in rng.integers(0, len(damaged), rng.integers(0, 8)):
            damaged[place] = rng.integers(256)
        (result / "solution.parquet").write_bytes(damaged)
        with suppress(UwgraphError):
            assert isinstance(read_result(result), Track)


def test_the_reference_is_brought_to_the_body(short_dive: Dive) -> None:
    """An antenna 2 m ahead on a late clock is taken off, as the rig says."""
    plain = track_of_reference(short_dive)
    rig = short_dive.rig.model_copy(
        update={
            "reference": short_dive.rig.reference.model_copy(
                update={"translation_m": (2.0, 0.0, 0.0), "time_offset_s": 0.5}
            )
        }
    )
    moved = track_of_reference(replace(short_dive, rig=rig))
    assert (moved.t_ns - plain.t_ns == 500_000_000).all()
    ahead = np.einsum("kji,kj->ki", plain.R_nb, plain.p_n - moved.p_n)
    np.testing.assert_allclose(ahead, np.tile([2.0, 0.0, 0.0], (len(plain), 1)), atol=1e-6)


def test_no_reference(short_dive: Dive) -> None:
    with pytest.raises(DataError, match="no reference"):
        track_of_reference(replace(short_dive, reference=None))


@given(rate=st.floats(0.01, 30.0))
def test_thinning_keeps_samples_and_the_rate(rate: float) -> None:
    track = track_of_solution(truth(n=50, period_s=0.37))
    few = thinned(track, rate)
    assert set(few.t_ns) <= set(track.t_ns)
    assert few.t_ns[0] == track.t_ns[0]
    assert len(few) <= (track.t_ns[-1] - track.t_ns[0]) * 1e-9 * rate + 2
    assert np.diff(few.t_ns).max(initial=0) * 1e-9 < 1 / rate + 0.38
