"""Bad input: every fault is an error of ours that names file, field and remedy."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uwgraph.dive import Dive
from uwgraph.dive.folder import read_dive, write_dive
from uwgraph.errors import ConfigError, DataError, UwgraphError
from uwgraph.types import Depth, Dvl, Heading, Imu, Origin, Reference

START = 1_654_646_400_000_000_000
N = 50


def good_dive() -> Dive:
    rng = np.random.default_rng(1)
    t = START + np.arange(N) * 10**8
    return Dive(
        Origin(0.57, 0.61),
        imu=Imu(t, rng.normal((0, 0, -9.8), 0.1, (N, 3)), rng.normal(0, 0.1, (N, 3))),
        dvl=Dvl(t, rng.normal(1, 0.1, (N, 3)), np.full((N, 3, 3), np.nan), np.ones(N, dtype=bool)),
        depth=Depth(t, rng.uniform(3, 9, N), np.full(N, 0.05)),
        heading=Heading(t, rng.uniform(0, 6, N), np.full(N, 0.01), "true"),
        reference=Reference(
            t, np.full(N, 0.57), np.full(N, 0.61), np.full(N, -3.0), rng.uniform(-1, 1, (N, 3)), np.ones((N, 3))
        ),
    )


@pytest.fixture(scope="module", params=["csv", "parquet"])
def pristine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place: Path = tmp_path_factory.mktemp(request.param) / "dive"
    write_dive(good_dive(), place, table_format=request.param)
    return place


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A good dive in CSV, to be spoilt."""
    write_dive(good_dive(), tmp_path / "dive", table_format="csv")
    return tmp_path / "dive"


def refused(folder: Path, *words: str, error: type[UwgraphError] = DataError) -> None:
    """Reading fails with an error of ours that has a place and a remedy and says all the words."""
    with pytest.raises(error) as caught:
        read_dive(folder)
    assert str(folder) in caught.value.where
    assert caught.value.remedy
    for word in words:
        assert word in str(caught.value)


def edit(file: Path, change: Callable[[list[str]], None]) -> None:
    lines = file.read_text().splitlines()
    change(lines)
    file.write_text("\n".join(lines) + "\n")


def set_cell(file: Path, line: int, column: str, value: str) -> None:
    def change(lines: list[str]) -> None:
        cells = lines[line - 1].split(",")
        cells[lines[0].split(",").index(column)] = value
        lines[line - 1] = ",".join(cells)

    edit(file, change)


def scale(file: Path, columns: str, factor: float) -> None:
    """Multiply columns by a factor, as a wrong unit would."""

    def change(lines: list[str]) -> None:
        wanted = [lines[0].split(",").index(name) for name in columns.split()]
        for i, line in enumerate(lines[1:], start=1):
            cells = line.split(",")
            for j in wanted:
                cells[j] = repr(float(cells[j]) * factor)
            lines[i] = ",".join(cells)

    edit(file, change)


def test_the_pristine_dive_is_fine(pristine: Path) -> None:
    assert len(list(read_dive(pristine).streams())) == 5


# --- files


def test_no_folder(tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", "no such folder")


def test_no_dive_yaml(folder: Path) -> None:
    (folder / "dive.yaml").unlink()
    refused(folder, "dive.yaml", "No such file", error=ConfigError)


@pytest.mark.parametrize("name", ["imu", "dvl", "depth"])
def test_listed_stream_without_file(folder: Path, name: str) -> None:
    (folder / f"{name}.csv").unlink()
    refused(folder, f"{name}.parquet (or .csv) is missing")


def test_file_of_a_stream_that_is_not_listed(folder: Path) -> None:
    yaml = folder / "dive.yaml"
    yaml.write_text(yaml.read_text().replace("dvl, ", ""))
    refused(folder, "dvl.csv is there", "does not list 'dvl'")


def test_both_formats(folder: Path) -> None:
    shutil.copy(folder / "imu.csv", folder / "imu.parquet")
    refused(folder, "both there", "imu.csv", "imu.parquet")


def test_empty_file(pristine: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(pristine, tmp_path / "dive"))
    (file,) = copy.glob("depth.*")
    file.write_bytes(b"")
    refused(copy, file.name, "empty")


def test_header_only(folder: Path) -> None:
    edit(folder / "depth.csv", lambda lines: lines.__delitem__(slice(1, None)))
    refused(folder, "depth.csv", "no samples")


def test_parquet_without_rows(folder: Path) -> None:
    (folder / "depth.csv").unlink()
    empty = pa.table({"t_ns": pa.array([], pa.int64()), "depth": pa.array([], pa.float64())})
    pq.write_table(empty, folder / "depth.parquet")
    refused(folder, "depth.parquet", "no samples")


def test_truncated_anywhere(pristine: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(pristine, tmp_path / "dive"))
    (file,) = copy.glob("imu.*")
    whole = file.read_bytes()
    line_ends = {i + 1 for i, byte in enumerate(whole) if byte == ord("\n")}
    for end in range(0, len(whole) - 1, 23):
        if file.suffix == ".csv" and end in line_ends:
            continue  # a shorter, whole file
        file.write_bytes(whole[:end])
        refused(copy, file.name)


def test_not_a_table_at_all(folder: Path) -> None:
    for content, word in (
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "UTF-8"),
        (b"t_ns,depth\n\0\0\0\0\n", "line 2 holds NUL"),
        (b"1,2\n3,4\n", "line 1 holds numbers"),
        (b"t_ns;depth\n1;2\n", "no commas"),
        (b"t_ns depth\n1 2\n", "no commas"),
    ):
        (folder / "depth.csv").write_bytes(content)
        refused(folder, "depth.csv", word)
    (folder / "depth.csv").unlink()
    (folder / "depth.parquet").write_bytes(b"t_ns,depth\n1,2\n")
    refused(folder, "depth.parquet", "not a whole Parquet file")


# --- columns and cells


def test_wrong_column_counts(folder: Path) -> None:
    whole = (folder / "imu.csv").read_text()
    edit(folder / "imu.csv", lambda lines: lines.__setitem__(7, lines[7] + ",1"))
    refused(folder, "imu.csv", "line 8 has 8 columns instead of 7")
    (folder / "imu.csv").write_text(whole)
    edit(folder / "imu.csv", lambda lines: lines.__setitem__(-1, "1,2"))
    refused(folder, f"line {N + 1} has 2 columns instead of 7", "cut off")


def test_unknown_missing_and_doubled_columns(folder: Path) -> None:
    whole = (folder / "imu.csv").read_text()
    for old, new, words in (
        ("f_x", "fx", ("unknown column 'fx'", "did you mean 'f_x'")),
        ("f_x", "w_x", ("'w_x' appears twice",)),
        ("t_ns", "time", ("unknown column 'time'", "known columns: t_ns")),
    ):
        (folder / "imu.csv").write_text(whole.replace(old, new, 1))
        refused(folder, "imu.csv", *words)
    edit(folder / "depth.csv", lambda lines: lines.__setitem__(slice(None), [line.split(",")[0] for line in lines]))
    (folder / "imu.csv").write_text(whole)
    refused(folder, "depth.csv", "exactly one of the columns depth and pressure")
    (folder / "depth.csv").write_text("depth,sigma\n1,1\n")
    refused(folder, "depth.csv", "'t_ns' is missing")


def test_half_a_covariance(folder: Path) -> None:
    (folder / "dvl.csv").write_text(f"t_ns,v_x,v_y,v_z,cov_xx,cov_yy\n{START},1,1,1,1,1\n")
    refused(folder, "dvl.csv", "'cov_xy' is missing beside 'cov_xx'")


@pytest.mark.parametrize("value", ["abc", "1.5.2", "0x10", "--", "1,5".replace(",", ";")])
def test_a_cell_that_is_no_number(folder: Path, value: str) -> None:
    set_cell(folder / "imu.csv", 12, "w_y", value)
    refused(folder, "imu.csv: w_y", "line 12", repr(value))


@pytest.mark.parametrize("value", ["1.6e18", f"{START}.5", "2022-06-08"])
def test_stamps_are_whole_nanoseconds(folder: Path, value: str) -> None:
    set_cell(folder / "imu.csv", 9, "t_ns", value)
    refused(folder, "imu.csv: t_ns", "line 9")


def test_a_blank_line_in_the_middle(folder: Path) -> None:
    edit(folder / "imu.csv", lambda lines: lines.insert(5, ""))
    refused(folder, "imu.csv: t_ns", "row 5 is empty")


def test_parquet_of_other_types(folder: Path) -> None:
    (folder / "depth.csv").unlink()
    for t, depth, column in (
        (pa.array([float(START)]), pa.array([1.0]), "t_ns"),
        (pa.array([START]), pa.array(["1.0"]), "depth"),
        (pa.array([2**63 + 5], pa.uint64()), pa.array([1.0]), "t_ns"),
        (pa.array([None], pa.int64()), pa.array([1.0]), "t_ns"),
        (pa.array([START]), pa.array([[1.0]]), "depth"),
    ):
        pq.write_table(pa.table({"t_ns": t, "depth": depth}), folder / "depth.parquet")
        refused(folder, f"depth.parquet: {column}")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", ""])
@pytest.mark.parametrize(
    ("file", "column"), [("imu", "f_y"), ("dvl", "v_x"), ("depth", "depth"), ("heading", "heading_deg")]
)
def test_not_a_number(folder: Path, file: str, column: str, value: str) -> None:
    set_cell(folder / f"{file}.csv", 20, column, value)
    refused(folder, f"{file}.csv: {column}", "row 19 holds")


def test_nan_is_fine_where_it_says_unknown(folder: Path) -> None:
    for file, column in (("depth", "sigma"), ("heading", "sigma_deg"), ("reference", "lat_deg"), ("reference", "v_n")):
        set_cell(folder / f"{file}.csv", 20, column, "")
    set_cell(folder / "dvl.csv", 20, "valid", "false")
    set_cell(folder / "dvl.csv", 20, "v_x", "nan")
    dive = read_dive(folder)
    assert np.isnan(dive.depth.sigma[18])  # type: ignore[union-attr]
    set_cell(folder / "reference.csv", 20, "lat_deg", "inf")
    refused(folder, "reference.csv: lat_deg", "row 19 holds inf")


# --- stamps


def test_backward_and_doubled_stamps(folder: Path) -> None:
    whole = (folder / "imu.csv").read_text()
    set_cell(folder / "imu.csv", 12, "t_ns", str(START + 5))
    refused(
        folder, "imu.csv: t_ns", "runs backward", "in row 10 to 2022-06-08T00:00:00.000000005Z in row 11", "(1 such"
    )
    (folder / "imu.csv").write_text(whole)
    set_cell(folder / "imu.csv", 12, "t_ns", str(START + 9 * 10**8))
    refused(folder, "imu.csv: t_ns", "rows 10 and 11 have the same stamp")


def test_two_fixes_may_share_a_stamp_but_not_go_back(tmp_path: Path) -> None:
    place = tmp_path / "dive"
    place.mkdir()
    (place / "dive.yaml").write_text("origin: {lat_deg: 32.0, lon_deg: 34.0}\nstreams: [fixes]\n")
    row = "32.0,34.0,gnss\n"
    (place / "fixes.csv").write_text(f"t_ns,lat_deg,lon_deg,source\n{START},{row}{START},{row}")
    assert len(read_dive(place).fixes or ()) == 2
    (place / "fixes.csv").write_text(f"t_ns,lat_deg,lon_deg,source\n{START},{row}{START - 1},{row}")
    refused(place, "fixes.csv: t_ns", "backward")


@pytest.mark.parametrize(("factor", "unit"), [(10**9, "seconds"), (10**6, "milliseconds"), (10**3, "microseconds")])
def test_stamps_in_other_units(folder: Path, factor: int, unit: str) -> None:
    (folder / "depth.csv").write_text(f"t_ns,depth\n{START // factor},1\n{START // factor + 1},1\n")
    refused(folder, "depth.csv: t_ns", f"looks like {unit}")


def test_stamps_from_the_start_of_the_recording(folder: Path) -> None:
    (folder / "depth.csv").write_text("t_ns,depth\n0,1\n1000000000,1\n")
    refused(folder, "depth.csv: t_ns", "add the start of a recording")


def test_a_gap_that_nothing_bridges(folder: Path) -> None:
    edit(folder / "imu.csv", lambda lines: lines.__delitem__(slice(20, 40)))
    refused(folder, "imu.csv: t_ns", "no sample for 2.1 s after row 19", "cut the recording")


# --- units, signs and frames


@pytest.mark.parametrize(
    ("file", "columns", "factor", "words"),
    [
        ("imu", "w_x w_y w_z", 180 / np.pi, ("w_x, w_y, w_z", "deg/s")),
        ("imu", "f_x f_y f_z", 1 / 9.80665, ("f_x, f_y, f_z", "looks like g:")),
        ("imu", "f_x f_y f_z", 1000 / 9.80665, ("f_x, f_y, f_z", "looks like mg:")),
        ("imu", "f_x f_y f_z", 0.01, ("f_x, f_y, f_z", "with gravity in it")),
        ("imu", "f_y f_z", -1.0, ("upside down", "[180, 0, 0]")),
        ("dvl", "v_x v_y v_z", 1000.0, ("v_x, v_y, v_z", "mm/s")),
        ("dvl", "v_x v_y v_z", 100.0, ("v_x, v_y, v_z", "cm/s")),
        ("depth", "depth", -1.0, ("depth", "change the sign")),
        ("depth", "depth", 10_000.0, ("depth", "deeper than any sea")),
        ("depth", "sigma", 0.0, ("sigma", "not positive")),
        ("heading", "heading_deg", 180 / np.pi, ("heading_deg", "more than a turn")),
        ("reference", "lat_deg lon_deg", np.pi / 180, ("lat_deg, lon_deg", "from the origin", "in degrees")),
        ("reference", "lat_deg", 180 / np.pi, ("lat_deg", "no latitude")),
        ("reference", "roll_deg", 1000.0, ("roll_deg", "more than a turn")),
        ("reference", "height", 10_000.0, ("height", "metres")),
    ],
)
def test_wrong_units_signs_and_frames(folder: Path, file: str, columns: str, factor: float, words: tuple[str]) -> None:
    scale(folder / f"{file}.csv", columns, factor)
    refused(folder, f"{file}.csv: ", *words)


def test_an_flu_sensor_is_fine_once_the_rig_says_so(folder: Path) -> None:
    scale(folder / "imu.csv", "f_y f_z w_y w_z", -1.0)
    yaml = folder / "dive.yaml"
    yaml.write_text(yaml.read_text().replace("rotation_deg: [0.0, 0.0, 0.0]", "rotation_deg: [180, 0, 0]", 1))
    read_dive(folder)


def test_a_bad_dive_can_still_be_looked_at(folder: Path) -> None:
    scale(folder / "imu.csv", "f_x f_y f_z", 0.1)
    assert read_dive(folder, validate=False).imu is not None


def test_magnetic_or_true_must_be_said(folder: Path) -> None:
    set_cell(folder / "heading.csv", 5, "reference", "magnetic")
    refused(folder, "heading.csv: reference", "'magnetic', 'true'")
    text = re.sub(",(true|magnetic)", ",grid", (folder / "heading.csv").read_text())
    (folder / "heading.csv").write_text(text)
    refused(folder, "heading.csv: reference", "'grid'")


# --- anything else


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files_are_refused_or_read_never_crash(
    pristine: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    copy = Path(shutil.copytree(pristine, tmp_path_factory.mktemp("damaged") / "dive"))
    file = data.draw(st.sampled_from(sorted(copy.iterdir())))
    content = bytearray(file.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content)))
        action = data.draw(st.sampled_from(["set", "insert", "delete", "cut"]))
        piece = data.draw(
            st.one_of(st.binary(max_size=6), st.sampled_from([b"nan", b",", b"\n", b"-", b"1e999", b": ", b'"']))
        )
        if action == "set":
            content[place : place + len(piece)] = piece
        elif action == "insert":
            content[place:place] = piece
        elif action == "delete":
            del content[place : place + data.draw(st.integers(1, 60))]
        else:
            del content[place:]
    file.write_bytes(content)
    try:
        dive = read_dive(copy)
    except (DataError, ConfigError) as error:
        assert error.where  # noqa: PT017
        assert error.remedy  # noqa: PT017
    else:
        assert all(len(stream) for _, stream in dive.streams())
    shutil.rmtree(copy.parent)
