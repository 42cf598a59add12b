"""Bags that lost power, and bags made to harm."""

from __future__ import annotations

import bz2
import shutil
import sqlite3
import struct
from pathlib import Path
from typing import Any

import pytest
import zstandard
from rosbags.rosbag1 import Writer as Rosbag1Writer
from roslogs import TYPES, write_rosbag1, write_rosbag2

from uwgraph.dive.logs.log import Log
from uwgraph.dive.readers import rosbag, rosbag1, rosbag2
from uwgraph.dive.readers.inflate import MAX_BLOCK
from uwgraph.errors import ConfigError, DataError

IMU = {"/imu": TYPES["/imu"]}


class Count:
    def __init__(self) -> None:
        self.n = 0

    def add(self, t_ns: int, message: Any) -> None:
        self.n += 1

    def extend(self, t_ns: Any, columns: Any) -> None:
        raise AssertionError


def poured(log: Log, topic: str = "/imu") -> int:
    sink = Count()
    log.pour({topic: (sink,)}, lambda share: None)
    return sink.n


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_rosbag1(tmp_path / "a.bag", "BZ2", IMU)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_bag_cut_off_is_read_up_to_there(bag: Path, share: float) -> None:
    data = bag.read_bytes()
    bag.write_bytes(data[: int(share * len(data))])
    with rosbag.open_log(bag) as log:
        (topic,) = log.topics
        assert any("cut off" in caveat and "byte" in caveat for caveat in log.caveats), log.caveats
        assert topic.count == poured(log)
        assert 0.5 * share * 500 < poured(log) <= 500 * min(1.0, 1.2 * share)


def test_a_bag_that_was_never_closed(tmp_path: Path) -> None:
    """As ``rosbag record`` leaves it: the place of the index is zero, and there is none."""
    path = write_rosbag1(tmp_path / "a.bag", "LZ4", IMU)
    data = path.read_bytes()
    place = data.index(b"index_pos=") + len(b"index_pos=")
    (index,) = struct.unpack("<Q", data[place : place + 8])
    path.write_bytes(data[:place] + bytes(8) + data[place + 8 : index])
    with rosbag.open_log(path) as log:
        assert log.topics[0].count == poured(log) == 500
        assert log.caveats == ()


def test_a_damaged_chunk_is_left_out_and_said(bag: Path) -> None:
    data = bytearray(bag.read_bytes())
    second = data.index(b"BZh", data.index(b"BZh") + 3)
    data[second + 40 : second + 60] = bytes(20)
    bag.write_bytes(data)
    with rosbag.open_log(bag) as log:
        assert 250 < poured(log) < 500
        assert "1 damaged blocks" in log.caveats[0]
        assert "bz2" in log.caveats[0]


def test_a_chunk_that_claims_too_much_is_refused_before_it_is_inflated(bag: Path) -> None:
    data = bag.read_bytes()
    place = data.index(b"size=", data.index(b"compression=bz2")) + 5
    bag.write_bytes(data[:place] + struct.pack("<I", 0xFFFFFFF0) + data[place + 4 :])
    with rosbag.open_log(bag) as log, pytest.raises(DataError, match=f"larger than {MAX_BLOCK}") as caught:
        poured(log)
    assert "byte" in caught.value.where
    assert str(bag) in caught.value.where


def test_a_chunk_that_inflates_to_more_than_it_says_is_left_out(bag: Path) -> None:
    data = bag.read_bytes()
    start = data.index(b"BZh")
    (length,) = struct.unpack("<I", data[start - 4 : start])
    bomb = bz2.compress(bytes(1 << 24))
    bag.write_bytes(data[: start - 4] + struct.pack("<I", len(bomb)) + bomb + data[start + length :])
    with rosbag.open_log(bag) as log:
        poured(log)
        assert any("more than" in caveat for caveat in log.caveats), log.caveats


def test_an_old_bag_and_no_bag(tmp_path: Path) -> None:
    old = tmp_path / "old.bag"
    old.write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(DataError, match=r"version 2\.0"), rosbag.open_log(old):
        pass
    empty = tmp_path / "empty.bag"
    empty.write_bytes(rosbag1.MAGIC)
    with pytest.raises(DataError, match="holds no topics"), rosbag.open_log(empty):
        pass


def bag_with(tmp_path: Path, definition: str, data: bytes = b"") -> Path:
    """A bag of one message of a type of one's own."""
    path = tmp_path / "own.bag"
    with Rosbag1Writer(path) as writer:
        link = writer.add_connection("/own", "pkg/msg/Own", msgdef=definition, md5sum="*" * 32)
        writer.write(link, 1_700_000_000_000_000_000, data)
    return path


LINE = "=" * 80 + "\nMSG: pkg/"


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        ("Own again\n", "contains itself"),
        (f"B b\n{LINE}B\nOwn own\n", "contains itself"),
        ("".join(f"T{n + 1}[100] a\n{LINE}T{n + 1}\n" for n in range(8)) + "uint8 x\n", "unfolds"),
        ("string[4000000000] names\n", "unfolds"),
        (f"E[] many\n{LINE}E\n", "without content"),
        ("Missing m\n", "lacks the type"),
        ("float64 x\n" * 20_000, "characters"),
        ("float64 ((\n", "definition cannot be read"),
        ("float64 x\nfloat64 x\n", "cannot be used"),
        ("".join(f"T{n + 1} a\n{LINE}T{n + 1}\n" for n in range(40)) + "uint8 x\n", "deep"),
    ],
)
def test_definitions_that_would_harm_are_refused(tmp_path: Path, definition: str, words: str) -> None:
    with rosbag.open_log(bag_with(tmp_path, definition)) as log:
        assert log.topics[0].name == "/own"
        with pytest.raises(DataError, match=words) as caught:
            poured(log, "/own")
    assert "/own" in caught.value.where
    if words != "cannot be used":
        assert any(words in caveat for caveat in log.caveats)


@pytest.mark.parametrize(
    ("definition", "data"),
    [
        ("float64[] x\n", struct.pack("<I", 0xFFFFFFFF)),
        ("string x\n", struct.pack("<I", 0xFFFFFFFF)),
        (f"B[] many\n{LINE}B\nuint8 x\n", struct.pack("<I", 1 << 30) + bytes(1 << 20)),
        ("float64 x\n", b"abc"),
        ("float64 x\n", bytes(9)),
    ],
)
def test_messages_that_lie_about_their_lengths_are_refused(tmp_path: Path, definition: str, data: bytes) -> None:
    with rosbag.open_log(bag_with(tmp_path, definition, data)) as log, pytest.raises(DataError) as caught:
        poured(log, "/own")
    assert "byte" in caught.value.where


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_rosbag2(tmp_path / "bag", topics=IMU)


def test_a_folder_without_its_metadata(folder: Path) -> None:
    (folder / "metadata.yaml").unlink()
    with rosbag.open_log(folder) as log:
        assert poured(log) == 500
        assert "metadata.yaml" in log.caveats[0]
    with rosbag.open_log(folder / "bag.db3") as log:
        assert poured(log) == 500


def test_a_bag_in_two_files(folder: Path) -> None:
    shutil.copy(folder / "bag.db3", folder / "bag_1.db3")
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- bag.db3", "- bag.db3\n  - bag_1.db3", 1))
    with rosbag.open_log(folder) as log:
        assert log.topics[0].count == poured(log) == 1000


def test_a_database_cut_off_is_read_up_to_there(folder: Path) -> None:
    file = folder / "bag.db3"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with rosbag.open_log(folder) as log:
        assert 0 < poured(log) < 500
        assert "damaged" in log.caveats[-1]


def test_an_unmerged_log_of_a_database_is_said(folder: Path) -> None:
    (folder / "bag.db3-wal").write_bytes(b"messages")
    with rosbag.open_log(folder) as log:
        assert "not read" in log.caveats[0]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("- bag.db3", "- ../bag/bag.db3", "no file of this folder"),
        ("- bag.db3", "- /etc/passwd", "no file of this folder"),
        ("- bag.db3", "- ..", "no file of this folder"),
        ("- bag.db3", "- other.db3", "no file of this folder"),
        ("- bag.db3", "- !!python/object/apply:os.system ['touch /tmp/uwgraph-owned']", "constructor"),
        ("sqlite3", "parquet", "storage 'parquet'"),
        ("compression_mode: ''", "compression_mode: FILE", "compression"),
        ("rosbag2_bagfile_information:", "something_else:", "missing"),
    ],
)
def test_metadata_that_lead_elsewhere_are_refused(folder: Path, old: str, new: str, words: str) -> None:
    metadata = folder / "metadata.yaml"
    text = metadata.read_text().replace('compression_mode: ""', "compression_mode: ''")
    assert old in text
    metadata.write_text(text.replace(old, new, 1))
    with pytest.raises((DataError, ConfigError), match=words), rosbag.open_log(folder):
        pass


def test_databases_that_are_something_else(folder: Path, tmp_path: Path) -> None:
    file = folder / "bag.db3"
    file.write_bytes(b"no database at all" * 100)
    with pytest.raises(DataError, match="no SQLite database"), rosbag.open_log(folder):
        pass
    file.unlink()
    with sqlite3.connect(file) as database:
        database.execute("CREATE TABLE photos (id INTEGER)")
    database.close()
    with pytest.raises(DataError, match="topics and messages"), rosbag.open_log(folder):
        pass


def test_a_view_that_counts_for_ever_is_no_table(folder: Path) -> None:
    with sqlite3.connect(folder / "bag.db3") as database:
        database.execute("DROP TABLE messages")
        database.execute(
            "CREATE VIEW messages(id, topic_id, timestamp, data) AS WITH RECURSIVE n(i) AS "
            "(SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i, 1, i, x'00' FROM n"
        )
    database.close()
    with pytest.raises(DataError, match="topics and messages"), rosbag.open_log(folder):
        pass


def test_computed_columns_are_no_messages(folder: Path) -> None:
    with sqlite3.connect(folder / "bag.db3") as database:
        database.execute("DROP TABLE messages")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB GENERATED ALWAYS AS (zeroblob(900000000)))"
        )
        database.execute("INSERT INTO messages(topic_id, timestamp) VALUES (1, 1)")
    database.close()
    with pytest.raises(DataError, match="topics and messages"), rosbag.open_log(folder):
        pass


def test_a_file_that_grows_without_bound_is_refused(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "bag", compression="file", topics=IMU)
    (file,) = folder.glob("*.zstd")
    file.write_bytes(zstandard.compress(bytes(1 << 24)))
    with pytest.raises(DataError, match="times its size"), rosbag.open_log(folder):
        pass


def test_an_unknown_type_without_a_definition_is_left_and_named(folder: Path) -> None:
    with sqlite3.connect(folder / "bag.db3") as database:
        database.execute("DELETE FROM message_definitions")
        database.execute("UPDATE topics SET type = 'my_msgs/msg/Secret'")
    database.close()
    with rosbag.open_log(folder) as log:
        assert log.topics[0].type == "my_msgs/msg/Secret"
        assert "no definition" in log.caveats[0]
        with pytest.raises(DataError, match="no definition"):
            poured(log)


def test_the_files_of_a_bag_are_ordered_by_number(tmp_path: Path) -> None:
    for number in (10, 9, 1, 0):
        (tmp_path / f"bag_{number}.db3").touch()
    assert [file.name for file in rosbag2.bag_files(tmp_path)] == [f"bag_{n}.db3" for n in (0, 1, 9, 10)]
