"""Telemetry logs: the vehicle's clock through a link that delays, restarts, other senders, damage, no pymavlink."""

from __future__ import annotations

import os
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ardusub_logs import START_US, dive, telemetry
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uwgraph.dive.folder import read_dive
from uwgraph.dive.importing import import_dive
from uwgraph.dive.readers import guess_reader, tlog, tlog_frames
from uwgraph.dive.readers.tlog_clocks import Clock
from uwgraph.errors import ConfigError, DataError

DATA = Path(os.environ.get("UWGRAPH_DATA", Path(__file__).parents[3] / "shared" / "data"))
REAL = DATA / "ardusub" / "small.tlog"
needs_data = pytest.mark.skipif(not REAL.is_file(), reason=f"no ArduSub log in {DATA}")


class Messages:
    """A sink that keeps everything."""

    def __init__(self) -> None:
        self.t_ns: list[int] = []
        self.messages: list[Any] = []

    def add(self, t_ns: int, message: Any) -> None:
        self.t_ns.append(t_ns)
        self.messages.append(message)

    def extend(self, t_ns: Any, columns: Any) -> None:
        raise AssertionError("messages come one by one")


def pour(path: Path) -> tuple[dict[str, int | None], dict[str, Messages], tuple[str, ...]]:
    with tlog.open_log(path) as log:
        counts = {topic.name: topic.count for topic in log.topics}
        sinks = {name: Messages() for name in counts}
        log.pour({name: (sink,) for name, sink in sinks.items()}, lambda share: None)
        return counts, sinks, log.caveats


def written(folder: Path, data: bytes) -> Path:
    path = folder / "2024-09-10 20-26-40.tlog"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("real", "block"),
    [(False, 1 << 9), (False, 1 << 20), pytest.param(True, 1 << 20, marks=[pytest.mark.data, needs_data])],
)
def test_every_message_is_what_pymavlink_reads(
    real: bool, block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tlog_frames, "_BLOCK", block)
    path = REAL if real else written(tmp_path, telemetry(dive(3.0)))
    counts, found, _ = pour(path)
    assert capfd.readouterr() == ("", "")
    ours = sorted(str(message) for sink in found.values() for message in sink.messages)
    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    theirs = []
    while (message := log.recv_match()) is not None:
        if not message.get_type().startswith(("BAD_DATA", "UNKNOWN")):
            theirs.append(str(message))
    assert ours == sorted(theirs)
    assert sum(count or 0 for count in counts.values()) == len(theirs)


def test_topics_are_named_after_who_sent_them(tmp_path: Path) -> None:
    counts, _, _ = pour(written(tmp_path, telemetry(dive(2.0))))
    assert set(counts) == {
        "ATTITUDE",
        "GPS_RAW_INT",
        "HEARTBEAT",
        "HEARTBEAT 255/190",
        "HIGHRES_IMU",
        "NAMED_VALUE_FLOAT Lights1",
        "PARAM_VALUE",
        "SCALED_PRESSURE",
        "SCALED_PRESSURE2",
        "VISION_POSITION_DELTA 1/220",
    }
    assert counts["HIGHRES_IMU"] == 100


def test_without_an_autopilots_heartbeat_the_vehicle_is_who_sent_most(tmp_path: Path) -> None:
    quiet = [m for m in dive(2.0) if m[2].get_type() != "HEARTBEAT" or m[1] == (255, 190)]
    counts, _, _ = pour(written(tmp_path, telemetry(quiet)))
    assert {"HIGHRES_IMU", "HEARTBEAT 255/190"} <= set(counts)


def test_stamps_are_the_vehicles(tmp_path: Path) -> None:
    """Jitter of the link is gone, its least delay stays: 2 ms here."""
    _, found, caveats = pour(written(tmp_path, telemetry(dive())))
    t_ns = np.array(found["HIGHRES_IMU"].t_ns)
    np.testing.assert_allclose(np.diff(t_ns), 20e6, atol=2e3)
    np.testing.assert_allclose(t_ns[0] - START_US * 1000, 2e6, atol=1e6)
    fix = np.array(found["GPS_RAW_INT"].t_ns) - START_US * 1000
    np.testing.assert_allclose(fix[5], 5e9 - 0.4e9 + 2e6, atol=1e6)
    companion = np.array(found["VISION_POSITION_DELTA 1/220"].t_ns)
    assert np.std(np.diff(companion)) > 1e6
    assert caveats == ()


@settings(max_examples=25, deadline=None)
@given(
    rate=st.floats(-2.5e-4, 2.5e-4),
    least=st.integers(0, 200_000),
    span=st.integers(60, 7200),
    seed=st.integers(0, 1000),
)
def test_a_clock_that_runs_at_another_rate_is_followed_from_below(
    rate: float, least: int, span: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    boot = np.sort(rng.integers(10_000_000, (10 + span) * 1_000_000, 20 * span))
    true = START_US + ((1.0 + rate) * boot).astype(np.int64)
    received = true + least + rng.exponential(20_000.0, len(boot)).astype(np.int64)
    clock = Clock()
    for at, (r, b) in enumerate(zip(received.tolist(), boot.tolist(), strict=True)):
        clock.see(at, r, b)
    clock.settle()
    ours = np.array([clock.utc_us(at, int(received[at]), int(boot[at])) for at in range(0, len(boot), 50)])
    assert np.all(ours <= received[::50])
    error = ours - true[::50] - least
    assert np.abs(error).max() < 15_000.0


def test_a_restart_begins_a_new_clock(tmp_path: Path) -> None:
    data = telemetry([*dive(20.0), *dive(20.0, boot_ms=3_000, at_us=60_000_000)])
    _, found, caveats = pour(written(tmp_path, data))
    t_s = (np.array(found["HIGHRES_IMU"].t_ns) - START_US * 1000) * 1e-9
    np.testing.assert_allclose(t_s[1000] - t_s[0], 60.0, atol=0.01)
    assert (np.diff(t_s) > 0.0).all()
    assert any("started 1 times" in caveat for caveat in caveats)


def test_a_sender_with_several_clocks_is_stamped_on_receipt(tmp_path: Path) -> None:
    messages = dive(10.0)
    for k in range(200):
        mixed = mavlink.MAVLink_attitude_message([5_000, 900_000][k % 2] + 20 * k, 0, 0, 0, 0, 0, 0)
        messages.append((50_000 * k, (1, 1), mixed))
    messages.sort(key=lambda stamped: stamped[0])
    _, found, caveats = pour(written(tmp_path, telemetry(messages)))
    t_ns = np.array(found["ATTITUDE"].t_ns)
    assert (np.diff(t_ns) >= 0).all()
    assert any("clock cannot be told" in caveat for caveat in caveats)


def test_the_ground_stations_clock_is_held_against_the_vehicles(tmp_path: Path) -> None:
    told = [
        (
            k * 1_000_000,
            (1, 1),
            mavlink.MAVLink_system_time_message(START_US + k * 1_000_000 - 7_500_000, 60_000 + 1000 * k),
        )
        for k in range(10)
    ]
    messages = sorted([*dive(10.0), *told], key=lambda stamped: stamped[0])
    _, _, caveats = pour(written(tmp_path, telemetry(messages)))
    assert any("+7.5 s off" in caveat for caveat in caveats)


def test_mavlink_1_is_read_too(tmp_path: Path) -> None:
    old = [m for m in dive(2.0) if m[2].get_type() in ("HEARTBEAT", "ATTITUDE", "HIGHRES_IMU")]
    counts, _, _ = pour(written(tmp_path, telemetry(old, v1=True)))
    assert counts["HIGHRES_IMU"] == 100


def test_signed_frames_are_read_too(tmp_path: Path) -> None:
    signer = mavlink.MAVLink(None, 1, 1)
    signer.signing.secret_key, signer.signing.sign_outgoing = b"k" * 32, True
    frames = [
        struct.pack(">Q", START_US + 20_000 * k)
        + mavlink.MAVLink_attitude_message(20 * k + 1, 0, 0, 0, 0, 0, 0).pack(signer)
        for k in range(50)
    ]
    counts, _, caveats = pour(written(tmp_path, b"".join(frames)))
    assert counts["ATTITUDE"] == 50
    assert not any("checksum" in caveat for caveat in caveats)


@settings(max_examples=30, deadline=None)
@given(at=st.floats(0.0, 1.0), garbage=st.binary(min_size=1, max_size=300), block=st.sampled_from([400, 1 << 20]))
def test_garbage_costs_nothing_but_the_frame_it_hits(
    at: float, garbage: bytes, block: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    data = telemetry(dive(2.0))
    place = int(at * len(data))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tlog_frames, "_BLOCK", block)
        counts, _, caveats = pour(written(tmp_path_factory.mktemp("log"), data[:place] + garbage + data[place:]))
    whole = len(dive(2.0))
    assert whole - 2 <= sum(count or 0 for count in counts.values()) <= whole
    assert caveats


def test_a_cut_off_end_is_left_out(tmp_path: Path) -> None:
    data = telemetry(dive(2.0))
    counts, _, caveats = pour(written(tmp_path, data[:-5]))
    assert sum(count or 0 for count in counts.values()) == len(dive(2.0)) - 1
    assert any("from byte" in caveat for caveat in caveats)


@pytest.mark.parametrize("data", [b"", b"\0" * 100, b"\0\x06\x22" + bytes(5) + b"\xfd" + bytes(40)])
def test_a_file_without_messages_is_refused_in_words(data: bytes, tmp_path: Path) -> None:
    path = written(tmp_path, data)
    with pytest.raises(DataError) as failure, tlog.open_log(path):
        pass
    assert str(path) in str(failure.value)


def test_without_pymavlink_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, telemetry(dive(1.0)))
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20", None)
    with pytest.raises(ConfigError, match=r"pip install 'uwgraph\[ardusub\]'"):
        import_dive(path, tmp_path / "dive")


def test_it_is_recognised_and_imported(tmp_path: Path) -> None:
    path = written(tmp_path, telemetry(dive()))
    assert guess_reader(path)[0] is tlog
    report = import_dive(path, tmp_path / "dive")
    assert {taken.stream: taken.topic for taken in report.taken} == {
        "imu": "HIGHRES_IMU",
        "depth": "SCALED_PRESSURE2",
        "heading": "ATTITUDE",
        "reference": "ATTITUDE",
        "dvl": "VISION_POSITION_DELTA 1/220",
        "fixes": "GPS_RAW_INT",
    }
    assert any("repeat the place" in caveat for caveat in report.caveats)
    found = read_dive(tmp_path / "dive")
    assert found.imu is not None
    assert found.dvl is not None
    assert found.depth is not None
    assert found.fixes is not None
    assert found.heading is not None
    np.testing.assert_allclose(found.dvl.v_s, np.tile([0.5, 0.1, 0.0], (len(found.dvl), 1)), atol=1e-6)
    assert found.depth.depth[-1] - found.depth.depth[0] == pytest.approx(1.96, rel=0.02)
    assert len(found.fixes) == 1
    assert found.heading.reference == "magnetic"
    assert len(found.heading) == 4
    np.testing.assert_allclose(found.imu.f_s.mean(axis=0), [0.1, 0.0, -9.8], atol=0.01)
