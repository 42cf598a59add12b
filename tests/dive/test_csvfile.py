"""Tables of others: separators, headers, units, times, damage, and what is made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive, read_recording, survey_recording
from uwgraph.dive.logs.assemble import Wishes
from uwgraph.dive.logs.mapping import LogMapping
from uwgraph.dive.logs.reading import LogOptions
from uwgraph.dive.readers import csv_text, csvfile
from uwgraph.dive.readers.csv_columns import time_of
from uwgraph.errors import ConfigError, DataError
from uwgraph.types import FloatArray, Origin

START_S = 1_654_646_400
HERE = Origin(0.75, 0.1)


def imu_rows(count: int = 200) -> FloatArray:
    rng = np.random.default_rng(3)
    t = START_S + np.arange(count) / 100
    return np.column_stack([t, rng.normal((0.1, 0.2, -9.8), 0.01, (count, 3)), rng.normal(0, 0.01, (count, 3))])


def write(file: Path, header: str, rows: FloatArray, separator: str = ",") -> Path:
    np.savetxt(file, rows, delimiter=separator, header=header, comments="", fmt="%.17g")
    return file


def read(path: Path, mapping: object = None) -> object:
    options = LogOptions(
        mapping=LogMapping.model_validate({"streams": mapping}) if mapping else None, wishes=Wishes(origin=HERE)
    )
    return read_recording(path, "csv", options=options).dive


HEADERS = {
    "plain": "t,ax,ay,az,gx,gy,gz",
    "brackets": "Time [s],ACC X [m/s^2],ACC Y [m/s^2],ACC Z [m/s^2],GYRO X [rad/s],GYRO Y [rad/s],GYRO Z [rad/s]",
    "spelled": "timestamp (sec),accel_x (m/s2),accel_y (m/s2),accel_z (m/s2),gyro_x (rad/sec),gyro_y (rad/sec),"
    "gyro_z (rad/sec)",
    "camel": "Time,AccX,AccY,AccZ,GyroX,GyroY,GyroZ",
    "suffix": "time_s,imu_acc_x_m_s2,imu_acc_y_m_s2,imu_acc_z_m_s2,imu_gyro_x_rad_s,imu_gyro_y_rad_s,imu_gyro_z_rad_s",
}


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
def test_an_imu_is_known_by_its_header(tmp_path: Path, header: str, separator: str) -> None:
    rows = imu_rows()
    file = write(tmp_path / "log.csv", header.replace(",", separator), rows, separator)
    dive = read(file)
    np.testing.assert_allclose(dive.imu.f_s, 0.5 * (rows[1:, 1:4] + rows[:-1, 1:4]), rtol=1e-15)
    np.testing.assert_allclose(dive.imu.w_s, 0.5 * (rows[1:, 4:] + rows[:-1, 4:]), rtol=1e-15)
    # a float of seconds has 0.24 us
    np.testing.assert_allclose(dive.imu.t_ns - START_S * 10**9, np.arange(1, 200) * 10**7, atol=240)


def test_units_in_the_header_are_honoured(tmp_path: Path) -> None:
    header = "t [ms],ax [g],ay [g],az [g],gx [dps],gy [dps],gz [dps]"
    rows = imu_rows()
    theirs = rows * [1000, *[1 / 9.80665] * 3, *[180 / np.pi] * 3]
    dive = read(write(tmp_path / "log.csv", header, theirs))
    np.testing.assert_allclose(dive.imu.f_s, 0.5 * (rows[1:, 1:4] + rows[:-1, 1:4]), rtol=1e-12)
    np.testing.assert_allclose(dive.imu.w_s, 0.5 * (rows[1:, 4:] + rows[:-1, 4:]), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "cell", "written", "epoch"),
    [
        ("t", "1654646400.5", "t [s]", None),
        ("timestamp", "1654646400500", "timestamp [ms]", None),
        ("#timestamp [ns]", "1654646400500000000", "#timestamp [ns]", None),
        ("time_us", "1654646400500000", "time_us [us]", None),
        ("Time (s)", "0.01", "Time (s) [s]", 2000),
        ("time", "2022-06-08T00:00:00.5Z", "time [s]", None),
        ("UTC", "2022-06-08 00:00:00", "UTC [s]", 1970),
        ("time", "2022-06-08 00:00:00", "time [s]", None),
        ("temperature", "4.2", "", None),
    ],
)
def test_the_column_of_time(name: str, cell: str, written: str, epoch: int | None) -> None:
    time, found, relative = time_of(["ax", name], ["1.0", cell])
    assert time == written
    assert (found.year if found else None) == epoch
    assert relative == (epoch == 2000)


@pytest.mark.parametrize(
    "stamp", ["2022-06-08T00:00:0{}.25Z", "2022-06-08 02:00:0{}.25+02:00", "2022/06/08 00:00:0{}.25Z"]
)
def test_times_as_text(tmp_path: Path, stamp: str) -> None:
    (tmp_path / "a.csv").write_text("time,depth\n" + "".join(f"{stamp.format(k)},{k}.5\n" for k in range(5)))
    depth = read(tmp_path / "a.csv").depth
    np.testing.assert_array_equal(depth.t_ns, (START_S + np.arange(5)) * 10**9 + 250_000_000)


def test_times_without_a_zone_are_refused_until_somebody_says_it(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("when,d\n2022-06-08 02:00:00,1\n2022-06-08 02:00:01,2\n")
    mapping = {"depth": {"topic": "a.csv", "time": "when", "depth": "d"}}
    with pytest.raises(DataError, match="no zone") as caught:
        read(tmp_path / "a.csv", mapping)
    assert "epoch: 1970-01-01T00:00:00Z" in caught.value.remedy
    mapping["depth"]["epoch"] = "1970-01-01T00:00:00+02:00"
    assert read(tmp_path / "a.csv", mapping).depth.t_ns[0] == START_S * 10**9


def test_nanoseconds_are_exact(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("#timestamp [ns],depth\n1654646400000000001,1\n1654646400000000003,2\n")
    np.testing.assert_array_equal(read(tmp_path / "a.csv").depth.t_ns - START_S * 10**9, [1, 3])


def test_comments_empty_cells_and_quotes(tmp_path: Path) -> None:
    head = '# made by x\n#\n"t","depth","note, long"\n'
    rows = '1654646400,1.5,"a, b"\n# half time\n1654646401,,""\n\n1654646402, 2.5 ,c\n'
    (tmp_path / "a.csv").write_text(head + rows)
    np.testing.assert_array_equal(read(tmp_path / "a.csv").depth.depth, [1.5, 2.5])


def test_position_attitude_and_depth_of_one_table(tmp_path: Path) -> None:
    header = "t,lat,lon,roll,pitch,heading (deg),depth"
    rows = np.column_stack([START_S + np.arange(5), *np.tile([[43], [5], [1], [2], [90], [7]], 5)])
    dive = read_recording(write(tmp_path / "nav.csv", header, rows)).dive
    np.testing.assert_allclose(np.degrees(dive.reference.rph[0]), [1, 2, 90])
    assert dive.fixes is None
    assert (dive.depth.depth == 7).all()
    assert np.degrees(dive.origin.lat) == pytest.approx(43)


def test_a_folder_of_tables_is_one_dive(tmp_path: Path) -> None:
    source = tmp_path / "log"
    source.mkdir()
    write(source / "imu.csv", HEADERS["plain"], imu_rows())
    write(source / "dvl.tsv", "t\tvx\tvy\tvz", np.column_stack([START_S + np.arange(3), np.ones((3, 3))]), "\t")
    write(source / "gps.csv", "t;latitude;longitude", np.array([[START_S, 43.0, 5.0]]), ";")
    (source / "notes.txt").write_text("calm sea")
    report = import_dive(source, tmp_path / "dive")
    assert report.format == "csv"
    assert {s.name for s in report.streams} == {"imu", "dvl", "fixes"}
    assert any("over the bottom" in note for note in report.caveats)
    # the mapping that was written does the same again
    import_dive(source, tmp_path / "again", options=LogOptions(mapping=mapping_in(tmp_path / "dive")))
    for name in ("imu", "dvl", "fixes"):
        assert (tmp_path / f"dive/{name}.parquet").read_bytes() == (tmp_path / f"again/{name}.parquet").read_bytes()
    assert read_dive(tmp_path / "dive").provenance["topics"]["dvl"] == "dvl.tsv"


def mapping_in(folder: Path) -> LogMapping:
    from uwgraph.dive.yamlfile import read_settings

    return read_settings(LogMapping, folder / "mapping.yaml")


def test_stamps_from_the_logs_own_start_are_told(tmp_path: Path) -> None:
    rows = imu_rows()
    rows[:, 0] = np.arange(200) / 100
    report = import_dive(
        write(tmp_path / "a.csv", HEADERS["plain"], rows),
        tmp_path / "d",
        options=LogOptions(wishes=Wishes(origin=HERE)),
    )
    assert report.streams[0].start.startswith("2000-01-01T00:00:00.01")
    assert any("time of day not known" in note for note in report.caveats)
    assert "epoch: '2000-01-01" in (tmp_path / "d/mapping.yaml").read_text()


def test_a_cut_off_end_costs_one_line(tmp_path: Path) -> None:
    file = write(tmp_path / "a.csv", HEADERS["plain"], imu_rows())
    whole = file.read_bytes()
    for cut in (whole[:-20], whole[:-20] + bytes(5000)):
        file.write_bytes(cut)
        found = read_recording(file, options=LogOptions(wishes=Wishes(origin=HERE)))
        assert len(found.dive.imu) == 198
        assert "a.csv: its last line is cut off; left out" in found.dive.provenance["caveats"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no rows"),
        ("# only\n# comments\n", "holds no rows"),
        ("1,2\n3,4\n", "numbers, not column names"),
        ("t,depth,depth\n1,2,3\n", "appears twice"),
        ("t,depth\n1654646400,1\n1654646401,1,2\n", "3 columns instead of 2"),
        ("t,depth\n1654646400,1\n1654646401,deep\n", "row 2 holds 'deep'"),
        ("t;depth\n1654646400;1,5\n1654646401;1,6\n", "decimal commas"),
        ("t,depth\n1654646400,1,5\n", "3 columns instead of 2"),
        ("t,depth\n2022-06-08T00:00:00Z,1\nyesterday,2\n", "is no time"),
        ("t,depth\n5,1\n\x00\x00,2\n", "is no text"),
        ("t,depth\n", "has a usable message"),
    ],
)
def test_faults_are_told_in_words(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    mapping = {"depth": {"topic": "a.csv", "time": "t", "depth": "depth"}}
    with pytest.raises(DataError, match=words) as caught:
        read(tmp_path / "a.csv", mapping)
    assert caught.value.where
    assert caught.value.remedy


def test_other_files_are_not_tables(tmp_path: Path) -> None:
    import gzip

    (tmp_path / "a.csv").write_bytes(gzip.compress(b"t,depth\n1,2\n"))
    with pytest.raises(DataError, match="no text") as caught:
        read(tmp_path / "a.csv")
    assert "unpack" in caught.value.remedy
    (tmp_path / "b.csv").write_bytes("t,Höhe\n1,2\n".encode("latin-1"))
    with pytest.raises(DataError, match="line 1 is not UTF-8"):
        read(tmp_path / "b.csv")
    (tmp_path / "c.csv").write_text("t" + ",x" * 40_000 + "\n1\n")
    with pytest.raises(DataError):
        read(tmp_path / "c.csv")


def test_a_line_longer_than_a_block_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,depth\n1654646400,1\n1654646401," + "1" * (3 * csv_text.BLOCK) + "\n")
    with pytest.raises(DataError):
        read(tmp_path / "a.csv")


def test_columns_of_a_mapping_are_checked_first(tmp_path: Path) -> None:
    file = write(tmp_path / "a.csv", HEADERS["brackets"], imu_rows())
    for name, words in (("ACC Z [g]", "ACC Z [m/s^2]"), ("AC Z [m/s^2]", "ACC Z [m/s^2]"), ("q", "its fields")):
        mapping = {"imu": {"topic": "a.csv", "f": ["ACC X [m/s^2]", "ACC Y [m/s^2]", name], "w": ["1", "1", "1"]}}
        with pytest.raises(ConfigError) as caught:
            read(file, mapping)
        assert caught.value.where == "mapping: imu.f"
        assert words in caught.value.remedy


def test_nothing_known_lists_the_columns(tmp_path: Path) -> None:
    file = write(tmp_path / "a.csv", "t,foo,bar", np.ones((3, 3)))
    with pytest.raises(DataError, match="none of its 1 topics") as caught:
        import_dive(file, tmp_path / "d")
    template = tmp_path / "d-mapping.yaml"
    assert str(template) in caught.value.remedy
    assert "t, foo, bar" in template.read_text()
    assert not (tmp_path / "d").exists()
    survey = survey_recording(file)
    assert [left.topic for left in survey.left] == ["a.csv"]


def test_pressure_without_a_unit_is_not_guessed(tmp_path: Path) -> None:
    rows = np.column_stack([START_S + np.arange(4), np.full(4, 1200.0)])
    survey = survey_recording(write(tmp_path / "a.csv", "t,pressure", rows))
    assert survey.taken == ()
    survey = survey_recording(write(tmp_path / "a.csv", "t,pressure [mbar]", rows))
    assert survey.taken[0].how == "time t [s]; pressure pressure [mbar]; surface_pressure_pa 101325.0"


def test_memory_does_not_hold_the_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks, not files: a table of many blocks comes in as many batches, in order."""
    monkeypatch.setattr(csv_text, "BLOCK", 4096)
    file = write(tmp_path / "a.csv", HEADERS["plain"], imu_rows(2000))
    head = csv_text.read_head(file)
    told: list[int] = []
    parts = [batch["t"] for batch in csv_text.batches(file, head, told.append, print)]
    assert len(parts) > 20
    assert (np.diff(np.concatenate(parts)) > 0).all()
    assert told[-1] == file.stat().st_size


def test_matches_names_and_beginnings(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("t depth\n1 2\n")
    (tmp_path / "b.txt").write_text("t,depth\n1,2\n")
    assert not csvfile.matches(tmp_path / "a.txt")
    assert csvfile.matches(tmp_path / "b.txt")
    assert not csvfile.matches(tmp_path)
