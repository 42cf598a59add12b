"""Trajectories of others: read to the last digit, or refused with the line that is wrong."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hand_made import ORIGIN, truth
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uwgraph.errors import DataError
from uwgraph.evaluate import tum_file
from uwgraph.evaluate.matching import Matching, compare_trajectories
from uwgraph.evaluate.metrics import error_metrics
from uwgraph.evaluate.pose_columns import MAX_ROWS
from uwgraph.evaluate.table import solution_table, trajectory_tum
from uwgraph.evaluate.trajectory import seen_from, trajectory_of_solution
from uwgraph.evaluate.trajectory_file import read_trajectory
from uwgraph.export import Source, export, track_of_solution
from uwgraph.frames import geodetic_from_ned
from uwgraph.time import NS, from_text
from uwgraph.types import Origin

TUM = trajectory_tum(truth(n=60))


def tum(folder: Path, text: str | bytes) -> Path:
    file = folder / "a.tum"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return file


def csv(folder: Path, text: str) -> Path:
    file = folder / "a.csv"
    file.write_text(text)
    return file


def test_tum_keeps_every_digit(tmp_path: Path) -> None:
    solution = truth(n=60)
    read = read_trajectory(tum(tmp_path, TUM))
    assert read.t_ns.tolist() == solution.t_ns.tolist()
    np.testing.assert_allclose(read.p_n, solution.p_n, atol=1e-6)
    np.testing.assert_allclose(read.R_nb, solution.R_nb, atol=1e-11)
    assert read.assumed
    assert read.origin is None


@given(st.integers(-(10**18), 4 * 10**18), st.sampled_from([1, 1000, 10**6, NS]))
def test_stamps_as_text_are_exact(t_ns: int, unit_ns: int) -> None:
    whole, rest = divmod(abs(t_ns), unit_ns)
    digits = len(str(unit_ns)) - 1
    text = f"{'-' if t_ns < 0 else ''}{whole}" + (f".{rest:0{digits}d}" if digits else "")
    assert from_text(text, unit_ns) == t_ns
    assert from_text(f"{t_ns}e-9") == t_ns


@pytest.mark.parametrize("text", ["", "nan", "inf", "1e30", "1e999999999", "12:00", "1.2.3", "1_000.0"])
def test_what_is_no_time(text: str) -> None:
    with pytest.raises(ValueError, match="no time"):
        from_text(text)


def test_tum_of_others(tmp_path: Path) -> None:
    """Tabs, wide columns, a byte-order mark, Windows line ends, comments anywhere, exponents, no last newline."""
    text = (
        b"\xef\xbb\xbf# timestamp tx ty tz qx qy qz qw\r\n"
        b"1.403636579763555584e+09\t1  2\t3e0   0 0 0 1 \r\n\r\n"
        b"   # half way\r\n"
        b"  1403636580 1.0 2.5 -3 0.0 0.0 0.7071 0.7071"
    )
    read = read_trajectory(tum(tmp_path, text))
    assert read.t_ns.tolist() == [1403636579763555584, 1403636580 * NS]
    np.testing.assert_allclose(read.p_n, [[1, 2, 3], [1, 2.5, -3]])
    np.testing.assert_allclose(read.rph[1], [0, 0, np.pi / 2], atol=1e-12)


def test_our_own_files_state_their_frame(tmp_path: Path) -> None:
    solution = truth(n=60)
    for frame in ("ned", "enu", "euroc"):
        export(Source("a", track_of_solution(solution)), tmp_path / f"{frame}.tum", frame=frame)  # type: ignore[arg-type]
        read = read_trajectory(tmp_path / f"{frame}.tum")
        assert not read.assumed
        np.testing.assert_allclose(read.p_n, solution.p_n, atol=1e-6)
        np.testing.assert_allclose(read.R_nb, solution.R_nb, atol=1e-9)
        assert read.origin is not None
        assert read.origin.lat == pytest.approx(ORIGIN.lat, abs=1e-10)


def test_euroc_and_csv_and_parquet_hold_the_same(tmp_path: Path) -> None:
    solution = truth(n=60)
    source = Source("a", track_of_solution(solution))
    export(source, tmp_path / "e.csv", "euroc")
    export(source, tmp_path / "t.csv")
    pq.write_table(solution_table(solution), tmp_path / "s.parquet")
    for name in ("e.csv", "t.csv", "s.parquet"):
        read = read_trajectory(tmp_path / name)
        assert read.t_ns.tolist() == solution.t_ns.tolist(), name
        np.testing.assert_allclose(read.p_n, solution.p_n, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(read.R_nb, solution.R_nb, atol=1e-8, err_msg=name)
        assert not read.assumed
    np.testing.assert_allclose(read.cov_p_n, trajectory_of_solution(solution).cov_p_n, atol=1e-12)
    assert read.origin is not None
    assert read.origin.lon == pytest.approx(ORIGIN.lon, abs=1e-12)


def test_nees_of_a_parquet_file(tmp_path: Path) -> None:
    solution = truth(n=60)
    pq.write_table(solution_table(solution), tmp_path / "s.parquet")
    read = read_trajectory(tmp_path / "s.parquet")
    off = trajectory_of_solution(truth(n=60))
    off.p_n[:] += solution.R_nb @ [0.1, 0.2, 0.05]  # one sigma along every axis of the body
    m = error_metrics(compare_trajectories(read, off))
    assert m["nees_position"] == pytest.approx(1.0, rel=1e-6)
    assert m["nees_heading"] < 1e-9


@pytest.mark.parametrize(
    ("header", "row", "position", "heading_deg"),
    [
        ("time [s],x [cm],y [cm],z [cm],yaw [deg]", "100,200,300,90", (1, 2, 3), 90),
        ("t;px;py;pz;qx;qy;qz;qw", "1;2;3;0;0;0;1", (1, 2, 3), 0),
        ("timestamp,north,east,depth,heading_deg", "1,2,3,45", (1, 2, 3), 45),
        ("t,e,n,u,hdg [rad]", "2,1,-3,1.5707963267948966", (1, 2, 3), 90),
        (
            "time,field.pose.position.x,field.pose.position.y,field.pose.position.z,"
            "field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,field.pose.orientation.w",
            "1,2,3,0,0,1,0",
            (1, 2, 3),
            180,
        ),
    ],
)
def test_columns_by_name(
    tmp_path: Path, header: str, row: str, position: tuple[float, ...], heading_deg: float
) -> None:
    separator = ";" if ";" in header else ","
    lines = [header, *(f"{t}.123456789{separator}{row}" for t in (1654646400, 1654646401))]
    read = read_trajectory(csv(tmp_path, "\n".join(lines) + "\n"))
    assert read.t_ns[0] == 1654646400123456789
    np.testing.assert_allclose(read.p_n[0], position, atol=1e-12)
    assert abs(np.degrees(read.rph[0, 2])) == pytest.approx(heading_deg)


def test_places_on_earth(tmp_path: Path) -> None:
    solution = truth(n=60)
    lat, lon, _ = geodetic_from_ned(ORIGIN, solution.p_n)
    rows = zip(solution.t_ns, np.degrees(lat), np.degrees(lon), solution.p_n[:, 2], strict=True)
    text = "time [ns],lat,lon,yaw\n" + "".join(f"{t},{a!r},{o!r},{0.1}\n" for t, a, o, _ in rows)
    read = read_trajectory(csv(tmp_path, text.replace("np.float64(", "").replace(")", "")))
    assert "yaw" in read.caveats[0]
    there = seen_from(read, ORIGIN)
    np.testing.assert_allclose(there.p_n[:, :2], solution.p_n[:, :2], atol=2e-3)  # 25 m deep, 400 m away
    assert np.isnan(there.p_n[:, 2]).all()


def test_another_origin_is_the_same_track() -> None:
    trajectory = trajectory_of_solution(truth())
    there = seen_from(trajectory, Origin(ORIGIN.lat + 1e-4, ORIGIN.lon - 2e-4))
    assert np.abs(there.p_n - trajectory.p_n).max() > 500.0
    back = seen_from(there, ORIGIN)
    np.testing.assert_allclose(back.p_n, trajectory.p_n, atol=1e-7)
    np.testing.assert_allclose(back.R_nb, trajectory.R_nb, atol=1e-12)
    np.testing.assert_allclose(back.cov_p_n, trajectory.cov_p_n, atol=1e-12)


LINES = TUM.splitlines(keepends=True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ("empty",)),
        ("# nothing\n\n", ("no poses",)),
        ("".join(LINES[:9]) + LINES[9][:40], ("line 10", "columns instead of 8", "cut off")),
        ("".join(LINES[:9]) + LINES[9][:-8], ("line 10", "cut off")),
        (LINES[0] + "1 2 3\n" + LINES[2], ("line 2", "3 columns")),
        (LINES[0] + LINES[1].replace(" 2", " x2", 1), ("line 2", "'x2", "no number")),
        (LINES[0] + "1654678900 nan 0 0 0 0 0 1\n", ("line 2", "x y z", "no position")),
        (LINES[0] + "1654678900 inf 0 0 0 0 0 1\n", ("line 2", "no position")),
        (LINES[0] + "1654678900 1e300 0 0 0 0 0 1\n", ("line 2", "no position")),
        (LINES[0] + "1654678900 0 0 0 nan 0 0 1\n", ("line 2", "qx qy qz qw", "quaternion")),
        (LINES[0] + "1654678900 0 0 0 0 0 0 0\n", ("line 2", "quaternion")),
        (LINES[0] + "1654678900 0 0 0 1 0 0 1\n", ("line 2", "quaternion")),
        (LINES[0] + "1654678900 0 0 0 1e200 0 0 1\n", ("line 2", "quaternion")),
        (LINES[0] + "nan 0 0 0 0 0 0 1\n", ("line 2", "no time")),
        (LINES[0] + "1e300 0 0 0 0 0 0 1\n", ("line 2", "no time")),
        ("# head\n\n" + LINES[1] + LINES[0], ("line 4", "does not come after", "sort")),
        (LINES[0] + LINES[0], ("line 2", "does not come after")),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), ("line", "no text")),
        (TUM.encode("utf-16"), ("UTF-16", "UTF-8")),
        (gzip.compress(TUM.encode()), ("gzip", "unpack")),
        (TUM.encode()[:500] + b"\0" * 500, ("no text",)),
        (b"1 1 1 1 0 0 0 1\n" * 3, ("line 2", "come after")),
        ("1 0 0 0 1 0 0 0 1 0 0 0\n", ("12 columns instead of 8",)),
        ("1,2,3,4,0,0,0,1\n2,2,3,4,0,0,0,1\n", ("numbers, not column names", "header")),
    ],
)
def test_bad_tum_is_refused_with_its_line(tmp_path: Path, text: str | bytes, words: tuple[str, ...]) -> None:
    refused(tum(tmp_path, text), *words)


def refused(file: Path, *words: str) -> None:
    with pytest.raises(DataError) as caught:
        read_trajectory(file)
    message = str(caught.value)
    assert str(file) in message
    assert "remedy:" in message
    for word in words:
        assert word in message


HEAD = "time [s],x [m],y [m],z [m],qx,qy,qz,qw\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time [s],speed,colour\n1,2,3\n2,3,4\n", ("no columns of position", "lat, lon")),
        ("name,x,y\n1,2,3\n2,3,4\n", ("no column of time",)),
        ("time,x,y\n", ("no rows",)),
        (HEAD + "1,0,0,0,0,0,0,1\n2,0,0,0,0,0,0\n", ("line 3", "7 columns instead of 8")),
        (HEAD + "1,0,0,0,0,0,0,1\n2,0,0,0,0,0,0,1", ("cut off",)),
        (HEAD + "1,0,0,0,0,0,0,1\n2,zero,0,0,0,0,0,1\n", ("row 2", "x [m]", "no number")),
        (HEAD + "1,0,0,0,0,0,0,1\n2,nan,0,0,0,0,0,1\n", ("row 2", "x [m]", "no position")),
        (HEAD + "1,0,0,0,0,0,0,1\n2,1e99,0,0,0,0,0,1\n", ("row 2", "no position")),
        (HEAD + "1,0,0,0,0,0,0,1\n2,0,0,0,0,0,0,2\n", ("row 2", "quaternion")),
        (HEAD + "1,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n", ("row 2", "come after")),
        (HEAD + "2,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n", ("row 2", "come after")),
        (HEAD + "1,0,0,0,0,0,0,1\nlater,0,0,0,0,0,0,1\n", ("row 2", "time")),
        ("time,lat,lon\n1,43,5\n2,143,5\n", ("row 2", "lat", "no position")),
        ("time,x,y,yaw\n1,0,0,1\n2,0,0,inf\n", ("row 2", "yaw")),
        ("time,x,x\n1,2,3\n", ("twice",)),
        ("time,x,y\n2022-06-08 09:00:00,0,0\n2022-06-08 09:00:01,0,0\n", ("no zone",)),
    ],
)
def test_a_bad_table_is_refused(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    refused(csv(tmp_path, text), *words)


def test_heights_and_attitudes_may_be_unknown_in_a_table(tmp_path: Path) -> None:
    read = read_trajectory(csv(tmp_path, "time [s],north,east,down,heading\n1,0,0,nan,\n2,1,1,5,90\n"))
    assert np.isnan(read.p_n[0, 2])
    assert np.isnan(read.rph[0, 2])
    assert np.degrees(read.rph[1, 2]) == pytest.approx(90.0)


def test_a_speed_called_u_is_no_height(tmp_path: Path) -> None:
    read = read_trajectory(csv(tmp_path, "time [s],lat,lon,u,v,w\n1,43,5,0.4,0,0\n2,43,5,0.4,0,0\n"))
    assert np.isnan(read.p_n[:, 2]).all()


def test_a_parquet_file_that_is_none(tmp_path: Path) -> None:
    file = tmp_path / "a.parquet"
    file.write_bytes(b"PAR1" + b"\0" * 50)
    refused(file, "not a whole Parquet file")
    pq.write_table(pa.table({"t_ns": [1, 2], "name": ["a", "b"]}), file)
    refused(file, "no columns of position")


def test_limits_are_stated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    many = pa.table({"t_ns": pa.array(np.arange(MAX_ROWS + 1, dtype=np.int64))})
    pq.write_table(many, tmp_path / "a.parquet")
    refused(tmp_path / "a.parquet", f"{MAX_ROWS} rows")
    monkeypatch.setattr(tum_file, "MAX_BYTES", 1_000)
    refused(tum(tmp_path, TUM), "the limit of 0 MB")


def test_no_such_file(tmp_path: Path) -> None:
    refused(tmp_path / "nothing.tum", "No such file")
    refused(tmp_path / "nothing.parquet", "No such file")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damage_is_told_or_harmless(tmp_path: Path, data: st.DataObject) -> None:
    """Bytes changed, cut or repeated anywhere: a message for people or a sane trajectory, nothing else."""
    name, text = data.draw(
        st.sampled_from([("a.tum", TUM[:2000].encode()), ("a.csv", (HEAD + "1,0,0,0,0,0,0,1\n").encode())])
    )
    damaged = bytearray(text)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(len(damaged) - 1, 0)))
        piece = data.draw(
            st.one_of(st.binary(max_size=4), st.sampled_from([b"\n", b" ", b"-", b",", b"#", b"e9", b"nan"]))
        )
        damaged[at : at + data.draw(st.integers(0, 60))] = piece
    file = tmp_path / name
    file.write_bytes(bytes(damaged))
    message = complaint(file)
    if message is not None:
        assert str(file) in message
        assert "remedy:" in message
        return
    read = read_trajectory(file)
    assert np.isfinite(read.p_n[:, :2]).all()
    assert (np.diff(read.t_ns) > 0).all()


def complaint(file: Path) -> str | None:
    try:
        read_trajectory(file)
    except DataError as error:
        return str(error)
    return None


def test_the_denser_one_is_interpolated(tmp_path: Path) -> None:
    fine, coarse = trajectory_of_solution(truth(n=3000, period_s=0.1)), trajectory_of_solution(truth(n=290))
    for estimate, reference in ((fine, coarse), (coarse, fine)):
        c = compare_trajectories(estimate, reference)
        assert (int(c.matched.sum()), len(c.matched)) == (290, 290)
        assert np.abs(c.e_n).max() < 1e-6
        assert np.abs(c.e_rph).max() < 1e-9


def test_the_nearest_pose_is_not_moved() -> None:
    late, reference = trajectory_of_solution(truth(n=50, offset_s=0.3)), trajectory_of_solution(truth(n=50))
    near = compare_trajectories(late, reference, matching=Matching("nearest"))
    np.testing.assert_allclose(near.truth.p_n, reference.p_n)
    assert near.matched.all()
    assert not compare_trajectories(late, reference, matching=Matching("nearest", 0.2)).matched.any()
    assert not compare_trajectories(late, reference, matching=Matching("interpolate", 0.2)).matched.any()
    assert compare_trajectories(late, reference, matching=Matching("interpolate", 0.3)).matched.sum() == 49


def test_attitudes_survive_a_nose_straight_down() -> None:
    """Roll and heading mean nothing there; the rotation does."""
    R = Rotation.from_euler("Y", -90, degrees=True).as_matrix() @ Rotation.from_rotvec([0.3, 0, 0]).as_matrix()
    solution = truth(n=30)
    trajectory = trajectory_of_solution(solution)
    trajectory.R_nb[:] = R
    m = error_metrics(compare_trajectories(trajectory, trajectory), [5.0])
    assert m["attitude_rmse_deg"] < 1e-9
    assert m["rpe"][0]["rotation_rmse_deg"] < 1e-6
