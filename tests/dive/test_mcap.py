"""MCAP files: any numbers come back; encodings that are not read are named; damage and lies are not believed."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from roslogs import TYPES, store_of, write_mcap

from uwgraph.dive.logs.log import Log
from uwgraph.dive.readers import mcapfile
from uwgraph.dive.readers.inflate import MAX_BLOCK
from uwgraph.errors import DataError

IMU = {"/imu": TYPES["/imu"]}
STORE = store_of("ros2_humble")
ARRAY = "std_msgs/msg/Float64MultiArray"


class Kept:
    def __init__(self) -> None:
        self.messages: list[tuple[int, Any]] = []

    def add(self, t_ns: int, message: Any) -> None:
        self.messages.append((t_ns, message))

    def extend(self, t_ns: Any, columns: Any) -> None:
        raise AssertionError


def poured(log: Log, topic: str = "/imu") -> list[tuple[int, Any]]:
    sink = Kept()
    log.pour({topic: (sink,)}, lambda share: None)
    return sink.messages


def write_one(
    path: Path, encoding: str, schema_encoding: str, schema: bytes, *messages: bytes, name: str = "T"
) -> Path:
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("/t", encoding, writer.register_schema(name, schema_encoding, schema))
        for number, message in enumerate(messages):
            writer.add_message(channel, 1_700_000_000_000_000_000 + number, message, 0)
        writer.finish()
    return path


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(
        st.tuples(st.integers(0, 2**63 - 1), st.lists(st.floats(allow_nan=False), max_size=5)), min_size=1, max_size=30
    ),
    compression=st.sampled_from(list(CompressionType)),
    chunked=st.booleans(),
    size=st.sampled_from([1, 100, 1 << 20]),
)
def test_what_is_written_comes_back(
    tmp_path: Path, rows: list[tuple[int, list[float]]], compression: CompressionType, chunked: bool, size: int
) -> None:
    layout = STORE.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression, use_chunking=chunked, chunk_size=size)
        writer.start("ros2")
        text = STORE.generate_msgdef(ARRAY, ros_version=2)[0].encode()
        channel = writer.register_channel("/t", "cdr", writer.register_schema(ARRAY, "ros2msg", text))
        for t_ns, values in rows:
            message = STORE.types[ARRAY](layout=layout, data=np.array(values))
            writer.add_message(channel, t_ns, bytes(STORE.serialize_cdr(message, ARRAY)), t_ns)
        writer.finish()
    with mcapfile.open_log(path) as log:
        assert [(t, message.data.tolist()) for t, message in poured(log, "/t")] == rows
        assert log.caveats == ()


def test_json_without_a_schema_says_its_fields_by_its_first_message(tmp_path: Path) -> None:
    message = {"header": {"frame_id": "dvl_ned"}, "velocity": {"x": 1, "y": 0.5, "z": 0}, "name": "a", "more": [1, 2]}
    path = write_one(tmp_path / "a.mcap", "json", "", b"", json.dumps(message).encode(), name="pkg/DVL")
    with mcapfile.open_log(path) as log:
        (topic,) = log.topics
        assert topic.fields == ("velocity.x", "velocity.y", "velocity.z", "more")
        assert topic.frame == "dvl_ned"
        assert mcapfile.proposals(topic)[0].stream == "dvl"
        assert poured(log, "/t") == [(1_700_000_000_000_000_000, message)]


def test_protobuf_is_named_and_left(tmp_path: Path) -> None:
    path = write_one(tmp_path / "a.mcap", "protobuf", "protobuf", b"\0", b"\0", name="foxglove.Imu")
    with mcapfile.open_log(path) as log:
        assert log.topics[0].type == "foxglove.Imu"
        assert log.caveats == ("/t: messages are encoded as 'protobuf', which is not read",)
        with pytest.raises(DataError, match="protobuf"):
            poured(log, "/t")


def test_a_definition_in_idl_is_named_and_left(tmp_path: Path) -> None:
    path = write_one(tmp_path / "a.mcap", "cdr", "ros2idl", b"module a {};", b"\0", name="a/msg/B")
    with mcapfile.open_log(path) as log:
        assert "ros2idl" in log.caveats[0]


@pytest.mark.parametrize("text", [b"{", b"[" * 100_000, b"{" + b'"a":{' * 50_000, b"\xff", b""])
def test_json_that_is_none_is_refused_with_its_place(tmp_path: Path, text: bytes) -> None:
    path = write_one(tmp_path / "a.mcap", "json", "", b"", text)
    with mcapfile.open_log(path) as log, pytest.raises(DataError) as caught:
        poured(log, "/t")
    assert "byte" in caught.value.where


@pytest.mark.parametrize("text", [b"[]", b'"a"', b"1e999", b"NaN", b"null", b'{"header": 5}'])
def test_json_without_fields_does_no_harm(tmp_path: Path, text: bytes) -> None:
    path = write_one(tmp_path / "a.mcap", "json", "", b"", text)
    with mcapfile.open_log(path) as log:
        assert log.topics[0].frame == ""
        assert len(poured(log, "/t")) == 1


def test_more_definitions_than_any_log_has_are_refused(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        for number in range(40):
            text = f"float64 x{number}\n".encode() + b"#" * 60_000 + b"\n"
            schema = writer.register_schema(f"pkg/msg/T{number}", "ros2msg", text)
            writer.register_channel(f"/t{number}", "cdr", schema)
        writer.finish()
    with pytest.raises(DataError, match="message definitions"), mcapfile.open_log(tmp_path / "a.mcap"):
        pass


def test_a_large_json_message_is_refused(tmp_path: Path) -> None:
    path = write_one(tmp_path / "a.mcap", "json", "", b"", b"[" + b"[]," * 200_000 + b"[]]")
    with mcapfile.open_log(path) as log, pytest.raises(DataError, match="bytes of JSON"):
        poured(log, "/t")


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_a_file_cut_off_is_read_up_to_there(tmp_path: Path, compression: str, share: float) -> None:
    path = write_mcap(tmp_path / "a.mcap", "cdr", compression, IMU)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with mcapfile.open_log(path) as log:
        assert any("cut off" in caveat and "byte" in caveat for caveat in log.caveats), log.caveats
        assert log.topics[0].count == len(poured(log))
        assert 0.5 * share * 500 < len(poured(log)) <= 500


def test_a_file_that_lacks_only_its_summary_is_whole(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", "cdr", "ZSTD", IMU)
    path.write_bytes(path.read_bytes()[:-20])
    with mcapfile.open_log(path) as log:
        assert log.topics[0].count == len(poured(log)) == 500
        assert log.caveats == ()


def test_a_chunk_with_a_wrong_checksum_is_left_out(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", topics=IMU)
    data = bytearray(path.read_bytes())
    place = data.index(b"base_link", len(data) // 2)
    data[place] ^= 1
    path.write_bytes(data)
    with mcapfile.open_log(path) as log:
        count = len(poured(log))
        assert 300 < count < 500
        assert "checksum" in log.caveats[0]
        assert log.topics[0].count == 500


def chunk_of(path: Path, size: int, compression: bytes, data: bytes) -> Path:
    """A file that is one chunk, which states its inflated size."""
    body = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression + struct.pack("<Q", len(data)) + data
    header = b"\x01" + struct.pack("<QII", 8, 0, 0)
    end = b"\x0f" + struct.pack("<QI", 4, 0) + b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + mcapfile.MAGIC
    path.write_bytes(mcapfile.MAGIC + header + b"\x06" + struct.pack("<Q", len(body)) + body + end)
    return path


def test_a_chunk_that_claims_too_much_is_refused_before_it_is_inflated(tmp_path: Path) -> None:
    path = chunk_of(tmp_path / "a.mcap", 1 << 40, b"zstd", b"")
    with pytest.raises(DataError, match=f"more than {MAX_BLOCK}") as caught, mcapfile.open_log(path):
        pass
    assert caught.value.where == f"{path}: byte 25"


@pytest.mark.parametrize(("name", "pack"), [(b"lz4", "lz4.frame"), (b"zstd", "zstandard"), (b"brotli", "zlib")])
def test_a_chunk_that_inflates_to_more_than_it_says_is_not_inflated(tmp_path: Path, name: bytes, pack: str) -> None:
    bomb = pytest.importorskip(pack).compress(bytes(1 << 24))
    path = chunk_of(tmp_path / "a.mcap", 1000, name, bomb)
    with pytest.raises(DataError, match=r"holds more than|not known"), mcapfile.open_log(path):
        pass


def test_a_record_longer_than_any_memory_is_the_end(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", topics=IMU)
    data = path.read_bytes()
    end = data.index(b"\x0f" + struct.pack("<Q", 4))
    path.write_bytes(data[:end] + b"\x05" + struct.pack("<Q", 1 << 62) + bytes(100))
    with mcapfile.open_log(path) as log:
        assert len(poured(log)) == 500
        assert f"byte {end}" in log.caveats[0]


def test_stamps_that_are_none_are_refused(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = McapWriter(file, index_types=IndexType.NONE)
        writer.start()
        channel = writer.register_channel("/t", "json", 0)
        writer.add_message(channel, 2**64 - 1, b"{}", 0)
        writer.finish()
    with mcapfile.open_log(tmp_path / "a.mcap") as log, pytest.raises(DataError, match="no time"):
        poured(log, "/t")


def test_an_empty_file_and_no_mcap(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcapfile.MAGIC)
    with pytest.raises(DataError, match="cut off"), mcapfile.open_log(path):
        pass
    path.write_bytes(b"no mcap")
    assert mcapfile.matches(path) == ""
    with pytest.raises(DataError, match="MCAP"), mcapfile.open_log(path):
        pass
