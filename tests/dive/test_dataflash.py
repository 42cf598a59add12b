"""DataFlash logs: as pymavlink reads them, in any blocks, damaged anywhere, with the date where they have one."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ardusub_logs import definition, head, message, of, onboard
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.DFReader import DFReader_binary

from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive
from uwgraph.dive.logs.log import Topic
from uwgraph.dive.readers import dataflash, dataflash_blocks, guess_reader
from uwgraph.dive.readers.mavlink_messages import AIR, MAGNETIC, PLACED, WATER
from uwgraph.errors import DataError

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
REAL = DATA / "ardusub" / "small.BIN"
needs_data = pytest.mark.skipif(not REAL.is_file(), reason=f"no ArduSub log in {DATA}")


class Columns:
    """A sink that keeps everything."""

    def __init__(self) -> None:
        self.t_ns: list[Any] = []
        self.parts: list[dict[str, Any]] = []

    def add(self, t_ns: int, message: Any) -> None:
        raise AssertionError("tables come as columns")

    def extend(self, t_ns: Any, columns: Any) -> None:
        self.t_ns.append(t_ns)
        self.parts.append({name: columns[name] for name in columns})

    def __getitem__(self, name: str) -> Any:
        return np.concatenate([part[name] for part in self.parts])


def pour(path: Path) -> tuple[dict[str, Topic], dict[str, Columns], tuple[str, ...]]:
    shares: list[float] = []
    with dataflash.open_log(path) as log:
        topics = {topic.name: topic for topic in log.topics}
        sinks = {name: Columns() for name in topics}
        log.pour({name: (sink,) for name, sink in sinks.items()}, shares.append)
        assert shares == sorted(shares)
        assert shares[-1] == 1.0
        return topics, sinks, log.caveats


def written(folder: Path, data: bytes) -> Path:
    path = folder / "00000042.BIN"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("real", "block"),
    [(False, 1 << 10), (False, 1 << 22), pytest.param(True, 1 << 22, marks=[pytest.mark.data, needs_data])],
)
def test_every_number_is_what_pymavlink_reads(
    real: bool, block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dataflash_blocks, "BLOCK", block)
    path = REAL if real else written(tmp_path, onboard(5.0))
    topics, found, _ = pour(path)
    assert capfd.readouterr() == ("", "")
    theirs: dict[str, list[Any]] = {}
    log = DFReader_binary(str(path))
    while (one := log.recv_msg()) is not None:
        kind = log.formats[one.fmt.type]
        instance = f"[{getattr(one, kind.instance_field)}]" if kind.instance_field else ""
        theirs.setdefault(one.get_type() + instance, []).append(one)
    hidden = {"FMT", *dataflash.DEFINITIONS}
    assert set(topics) == {name for name in theirs if name not in hidden}
    for name, topic in topics.items():
        assert topic.count == len(theirs[name]) == len(found[name]["TimeUS"])
        for field in set(topic.fields) & set(theirs[name][0].get_fieldnames()):
            expected = [getattr(one, field) for one in theirs[name]]
            if isinstance(expected[0], str):  # flight modes are told by name
                continue
            np.testing.assert_allclose(
                found[name][field], np.array(expected, dtype=float), rtol=1e-12, err_msg=name + field
            )
        for field, unit in topic.units.items():
            assert unit == theirs[name][0].fmt.get_unit(field).replace("µ", "u")


def test_what_the_log_says_decides_what_a_topic_becomes(tmp_path: Path) -> None:
    topics, found, caveats = pour(written(tmp_path, onboard()))
    assert [topics[name].says for name in ("BARO[0]", "BARO[1]", "ATT", "XKF1[0]")] == [AIR, WATER, "", PLACED]
    assert caveats == ()
    assert dataflash.proposals(topics["BARO[0]"]) == ()
    assert [p.stream for p in dataflash.proposals(topics["BARO[1]"])] == ["depth"]
    np.testing.assert_allclose(found["VISO"]["VelX"], 0.5, rtol=1e-6)
    np.testing.assert_allclose(found["VISO"]["VelY"], 0.1, rtol=1e-6)

    topics, _, _ = pour(written(tmp_path, onboard(aided=False) + of("PARM", 99, "COMPASS_DEC", 0.0)))
    assert [topics[name].says for name in ("ATT", "XKF1[0]")] == [MAGNETIC, ""]
    (heading,) = dataflash.proposals(topics["ATT"])
    assert heading.mapping.reference == "magnetic"  # type: ignore[union-attr]
    (reference,) = dataflash.proposals(topics["XKF1[0]"])
    assert reference.mapping.velocity is None  # type: ignore[union-attr]
    assert reference.mapping.position is None  # type: ignore[union-attr]


def test_units_that_the_log_states_win(tmp_path: Path) -> None:
    units = message(1, "QbZ", 7, ord("q"), "cm/s") + message(1, "QbZ", 7, ord("n"), "deg/s")
    renamed = definition(40, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    stated = message(3, "QBNN", 6, 40, "s#nnnqqq", "F-000000")
    rows = b"".join(message(40, "QBffffff", 1000 * k, 0, *[0.1] * 6) for k in range(3))
    topics, _, _ = pour(written(tmp_path, head() + units + renamed + stated + rows))
    (imu,) = dataflash.proposals(topics["IMU[0]"])
    # deg/s are taken; cm/s is no unit of a specific force, so that the usual ones stand for all of the message
    assert "Gyr" in imu.mapping.in_words()
    assert "[m/s^2]" in imu.mapping.in_words()
    axes = tuple(f"{name}{axis}" for name in ("Gyr", "Acc") for axis in "XYZ")
    topic = Topic("IMU", "IMU", fields=axes, units={"GyrX": "deg/s", "GyrY": "deg/s", "GyrZ": "deg/s"})
    assert "[deg/s]" in dataflash.proposals(topic)[0].mapping.in_words()
    assert dataflash.proposals(Topic("IMU", "IMU", fields=axes[:5])) == ()


def test_the_date_comes_from_the_gps(tmp_path: Path) -> None:
    _, found, _ = pour(written(tmp_path, onboard()))
    # week 2331 began on 2024-09-08 (GPS); 158400 s later it was 20:00:00 on 2024-09-09, less 18 leap seconds
    start = np.datetime64("2024-09-09T20:00:00", "ns").astype(np.int64) - 18 * 10**9
    first = found["IMU[0]"].t_ns[0][0]
    assert abs(first - (start + 60 * 10**9)) < 2_000_000


def test_a_log_without_a_date_says_so(tmp_path: Path) -> None:
    _, found, caveats = pour(written(tmp_path, onboard(gps=False)))
    assert any("does not know the date" in caveat for caveat in caveats)
    assert found["IMU[0]"].t_ns[0][0] == dataflash.NOMINAL_START + 60 * 10**9


def test_a_cut_off_end_is_left_out(tmp_path: Path) -> None:
    data = onboard(5.0) + of("IMU", 70_000_000, 0, *[0.0] * 6)
    whole, _, _ = pour(written(tmp_path, data))
    topics, _, caveats = pour(written(tmp_path, data[:-7]))
    cut_at = len(data) - len(of("IMU", 0, 0, *[0.0] * 6))
    assert any(f"from byte {cut_at} on" in caveat for caveat in caveats)
    lost = sum(t.count or 0 for t in whole.values()) - sum(t.count or 0 for t in topics.values())
    assert lost == 1


@settings(max_examples=30, deadline=None)
@given(
    at=st.floats(0.0, 1.0), garbage=st.binary(min_size=1, max_size=300), block=st.sampled_from([700, 1 << 14, 1 << 22])
)
def test_garbage_costs_its_neighbours_and_nothing_else(
    at: float, garbage: bytes, block: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    data, begin = onboard(4.0), len(head())
    place = begin + int(at * (len(data) - begin))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dataflash_blocks, "BLOCK", block)
        path = written(tmp_path_factory.mktemp("log"), data[:place] + garbage + data[place:])
        topics, found, _ = pour(path)
    whole = onboard(4.0)
    total = whole.count(b"\xa3\x95\x0a")
    assert topics["IMU[0]"].count in range(total - 3, total + 2)
    good = found["IMU[0]"]["AccZ"]
    assert np.count_nonzero(np.abs(good + 9.8) < 0.2) >= total - 3


def test_definitions_that_cannot_be_are_not_believed(tmp_path: Path) -> None:
    """Lengths of nothing, columns twice, letters that do not exist, a second definition of a type."""
    strange = [
        message(128, "BBnNZ", 50, 0, "ZERO", "Q", "TimeUS"),
        message(128, "BBnNZ", 51, 30, "TWIC", "QQ", "TimeUS,TimeUS"),
        message(128, "BBnNZ", 52, 30, "LETT", "Q?", "TimeUS,A"),
        message(128, "BBnNZ", 53, 12, "LENG", "QQ", "TimeUS,A"),
        definition(10, "IMU", "Q", "TimeUS"),
        message(128, "BBnNZ", 54, 14, "../x", "QHB", "TimeUS,../../etc,B"),
    ]
    topics, _, _ = pour(written(tmp_path, head() + b"".join(strange) + onboard(2.0)))
    assert not {"ZERO", "TWIC", "LETT", "LENG", "../x"} & set(topics)
    assert topics["IMU[0]"].count == 100


def test_a_pressure_that_was_hit_is_dropped(tmp_path: Path) -> None:
    hit = [of("BARO", 79_990_000 + 1000 * k, 1, 0.0, pressure) for k, pressure in enumerate((1e30, -3e9, 5e12))]
    report = import_dive(written(tmp_path, onboard() + b"".join(hit)), tmp_path / "dive")
    assert any("depth: 3 of" in done for done in report.conversions)
    depth = read_dive(tmp_path / "dive").depth
    assert depth is not None
    assert depth.depth.max() < 3.0


def test_columns_of_other_kinds_than_usual_are_no_stumbling_block(tmp_path: Path) -> None:
    """A log whose definitions were hit: texts and floats where numbers belong, a NaN that signals."""
    swapped = [
        definition(13, "GPS", "fBffLL", "TimeUS,Status,GMS,GWk,Lat,Lng")
        + message(13, "fBffLL", np.nan, 3, 1.0, 2.0, 0, 0),
        definition(18, "ORGN", "QBnn", "TimeUS,Type,Lat,Lng") + message(18, "QBnn", 5, 0, "a", "b"),
        definition(14, "PARM", "QNn", "TimeUS,Name,Value") + message(14, "QNn", 5, "AHRS_TRIM_X", "x"),
        definition(12, "ATT", "nccC", "TimeUS,Roll,Pitch,Yaw") + message(12, "nccC", "now", 1, 2, 3),
        definition(30, "NAN", "Qf", "TimeUS,X") + b"\xa3\x95\x1e" + bytes(8) + b"\x01\x00\xa0\x7f",
    ]
    topics, found, _ = pour(written(tmp_path, b"".join(swapped) + onboard(1.0)))
    assert "ATT" not in topics
    assert np.isnan(found["NAN"]["X"][0])


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "empty"),
        (b"\xa3\x95", "no messages"),
        (b"\xa3\x95\x80" + bytes(300), "no messages"),
        (head(), "no messages"),
    ],
)
def test_a_file_without_messages_is_refused_in_words(data: bytes, words: str, tmp_path: Path) -> None:
    path = written(tmp_path, data)
    with pytest.raises(DataError, match=words) as failure, dataflash.open_log(path):
        pass
    assert str(path) in str(failure.value)


def test_it_is_recognised_and_imported(tmp_path: Path) -> None:
    path = written(tmp_path, onboard())
    reader, reason = guess_reader(path)
    assert reader is dataflash
    assert "DataFlash" in reason
    report = import_dive(path, tmp_path / "dive")
    assert {taken.stream: taken.topic for taken in report.taken} == {
        "imu": "IMU[0]",
        "depth": "BARO[1]",
        "heading": "ATT",
        "reference": "XKF1[0]",
        "dvl": "VISO",
        "fixes": "GPS",
    }
    dive = read_dive(tmp_path / "dive")
    assert dive.imu is not None
    assert dive.dvl is not None
    assert dive.depth is not None
    assert dive.heading is not None
    assert dive.fixes is not None
    assert dive.rig.imu.rotation_deg[0] == pytest.approx(np.degrees(0.02), rel=1e-4)
    assert np.degrees(dive.origin.lat) == pytest.approx(48.3861418)
    np.testing.assert_allclose(dive.imu.f_s.mean(axis=0), [0.1, 0.0, -9.8], atol=0.01)
    np.testing.assert_allclose(dive.imu.w_s.mean(axis=0), [0.01, 0.0, 0.1], atol=1e-3)
    assert dive.depth.depth[-1] - dive.depth.depth[0] == pytest.approx(0.0973 * 19.9, rel=0.02)
    assert 9.0 < dive.dvl.valid.mean() * len(dive.dvl) / 5.0 < 11.0
    np.testing.assert_allclose(np.degrees(dive.heading.heading[0]) % 360.0, 200.0, atol=0.01)
    assert len(dive.fixes) == 3
    assert len(dive.heading) == 4
