"""MCAP read back with the mcap library, every message held against its schema."""

from __future__ import annotations

import json
import tracemalloc
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_made import as_reference, truth
from jsonschema import Draft7Validator
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from uwgraph.dive.model import Dive
from uwgraph.dive.rig import Rig
from uwgraph.export import Source, export, source_of_dive, track_of_solution
from uwgraph.export.foxglove import plain_schema
from uwgraph.export.mcap_file import Stamped, Topic, write_mcap
from uwgraph.types import Fixes, Heading

WELL_KNOWN = {
    "foxglove.PoseInFrame": {"timestamp", "frame_id", "pose"},
    "foxglove.PosesInFrame": {"timestamp", "frame_id", "poses"},
    "foxglove.FrameTransform": {"timestamp", "parent_frame_id", "child_frame_id", "translation", "rotation"},
    "foxglove.LocationFix": {
        *("timestamp", "frame_id", "latitude", "longitude", "altitude"),
        *("position_covariance", "position_covariance_type"),
    },
}
"""The fields that Foxglove's own definitions require."""


@dataclass
class Read:
    messages: dict[str, list[dict[str, Any]]] = field(default_factory=lambda: defaultdict(list))
    stamps: dict[str, list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))
    schemas: dict[str, str] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)


def read(path: Path) -> Read:
    """Every message, strictly: valid JSON, valid against its schema, in order of time, in indexed zstd chunks."""
    out = Read()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        validators = {key: Draft7Validator(json.loads(schema.data)) for key, schema in summary.schemas.items()}
        for schema in summary.schemas.values():
            Draft7Validator.check_schema(json.loads(schema.data))
            assert schema.encoding == "jsonschema"
            foxglove_can_parse(json.loads(schema.data))
            if schema.name in WELL_KNOWN:
                assert set(json.loads(schema.data)["required"]) == WELL_KNOWN[schema.name]
        count, last = 0, 0
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            assert channel.message_encoding == "json"
            content = json.loads(message.data, parse_constant=pytest.fail)
            validators[schema.id].validate(content)
            assert message.log_time >= last
            stamp = content["timestamp"]
            assert stamp["sec"] * 10**9 + stamp["nsec"] == message.log_time
            last = message.log_time
            out.messages[channel.topic].append(content)
            out.stamps[channel.topic].append((message.log_time, message.publish_time))
            out.schemas[channel.topic] = schema.name
            count += 1
        assert count == summary.statistics.message_count
        out.metadata = {k: v for record in reader.iter_metadata() for k, v in record.metadata.items()}
    return out


def foxglove_can_parse(schema: dict[str, Any]) -> None:
    """Foxglove takes single types, objects with properties, arrays of one type, and enumerations of numbers."""
    if "oneOf" in schema:
        assert all(isinstance(option["const"], int) for option in schema["oneOf"])
        return
    assert schema["type"] in ("object", "array", "number", "integer", "string", "boolean")
    for inner in schema.get("properties", {}).values():
        foxglove_can_parse(inner)
    if schema["type"] == "array":
        foxglove_can_parse(schema["items"])


def xyz(message: dict[str, float]) -> list[float]:
    return [message["x"], message["y"], message["z"]]


def xyzw(message: dict[str, float]) -> list[float]:
    return [*xyz(message), message["w"]]


def test_a_result_with_poses_path_locations_and_states(tmp_path: Path) -> None:
    solution = truth()
    made = export(Source("run1", track_of_solution(solution)), tmp_path / "a.mcap")
    got = read(tmp_path / "a.mcap")
    assert made.count == sum(map(len, got.messages.values()))
    assert got.schemas == {
        "/tf": "foxglove.FrameTransform",
        "/solution/pose": "foxglove.PoseInFrame",
        "/solution/path": "foxglove.PosesInFrame",
        "/solution/location": "foxglove.LocationFix",
        "/solution/state": "uwgraph.solution.state",
    }
    enu, flu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), np.diag([1, -1, -1])
    poses = [message["pose"] for message in got.messages["/solution/pose"]]
    np.testing.assert_allclose([xyz(p["position"]) for p in poses], solution.p_n @ enu.T, atol=1e-9)
    R = Rotation.from_quat([xyzw(p["orientation"]) for p in poses]).as_matrix()
    np.testing.assert_allclose(R, enu @ solution.R_nb @ flu, atol=1e-9)
    (path,) = got.messages["/solution/path"]
    assert path["poses"] == poses
    transforms = got.messages["/tf"]
    assert [t["translation"] for t in transforms] == [p["position"] for p in poses]
    assert {(t["parent_frame_id"], t["child_frame_id"]) for t in transforms} == {("map", "base_link")}
    assert got.stamps["/solution/pose"] == [(t, t) for t in solution.t_ns.tolist()]
    states = got.messages["/solution/state"]
    np.testing.assert_allclose([s["v_e"] for s in states], solution.v_n[:, 1])
    np.testing.assert_allclose([s["bias_accel_x"] for s in states], 1e-3)
    assert got.metadata["frames"] == "ENU world, FLU body"
    assert float(got.metadata["origin_lat_deg"]) == pytest.approx(43.1, abs=1e-12)


def test_locations_are_degrees_with_a_local_enu_covariance(tmp_path: Path) -> None:
    solution = truth(n=20)
    track = track_of_solution(solution)
    export(Source("run1", track), tmp_path / "a.mcap", frame="ned")
    fixes = read(tmp_path / "a.mcap").messages["/solution/location"]
    reference = as_reference(solution)
    np.testing.assert_allclose([f["latitude"] for f in fixes], np.degrees(reference.lat), atol=1e-12)
    np.testing.assert_allclose([f["altitude"] for f in fixes], reference.height, atol=1e-6)
    cov = np.array([f["position_covariance"] for f in fixes]).reshape(-1, 3, 3)
    ned = track.cov_p_n
    # Within 100 m of the origin the local axes are n's to 1e-5.
    np.testing.assert_allclose(cov[:, 0, 0], ned[:, 1, 1], rtol=1e-3)
    np.testing.assert_allclose(cov[:, 0, 1], ned[:, 0, 1], rtol=1e-3)
    np.testing.assert_allclose(cov[:, 1, 2], -ned[:, 0, 2], rtol=1e-2, atol=1e-6)
    assert {f["position_covariance_type"] for f in fixes} == {3}
    assert {f["frame_id"] for f in fixes} == {"base_link_frd"}


def test_a_whole_dive_on_one_clock(short_dive: Dive, tmp_path: Path) -> None:
    rig = Rig.model_validate({"dvl": {"time_offset_s": 1.25}})
    export(source_of_dive(replace(short_dive, rig=rig), "sim", None), tmp_path / "a.mcap")
    got = read(tmp_path / "a.mcap")
    for name, stream in short_dive.streams():
        assert len(got.messages[f"/{name}"]) == len(stream)
    imu, dvl = short_dive.imu, short_dive.dvl
    assert imu is not None
    assert dvl is not None
    np.testing.assert_array_equal([[m[f"f_{a}"] for a in "xyz"] for m in got.messages["/imu"]], imu.f_s)
    assert got.stamps["/dvl"] == [(t + 1_250_000_000, t) for t in dvl.t_ns.tolist()]
    assert json.loads(got.metadata["rig"])["dvl"]["time_offset_s"] == 1.25
    assert got.schemas["/reference/pose"] == "foxglove.PoseInFrame"
    assert len(got.messages["/fixes/location"]) == len(got.messages["/fixes"])


def test_a_dive_without_reference_has_its_sensors(short_dive: Dive, tmp_path: Path) -> None:
    export(source_of_dive(replace(short_dive, reference=None), "sim", None), tmp_path / "a.mcap")
    got = read(tmp_path / "a.mcap")
    assert "/imu" in got.messages
    assert "/tf" not in got.messages


def test_what_is_not_known_or_infinite_stays_json(short_dive: Dive, tmp_path: Path) -> None:
    t = short_dive.imu.t_ns[:4] if short_dive.imu is not None else np.zeros(4, np.int64)
    cov = np.tile(np.diag([4.0, 9.0, 16.0]), (4, 1, 1))
    cov[1, 2, 2] = np.inf
    cov[2] = np.nan
    cov[0, 0, 2] = cov[0, 2, 0] = 1.0
    height = np.array([-1.0, -1.0, -1.0, np.nan])
    lat, lon = np.full(4, short_dive.origin.lat), np.full(4, short_dive.origin.lon)
    fixes = Fixes(t, lat, lon, height, cov, np.array(["gnss", 'q"uo\n', "usbl", "x"]))
    heading = Heading(t, np.array([0.1, 0.2, 0.3, 0.4]), np.full(4, np.nan), "magnetic")
    dive = Dive(short_dive.origin, fixes=fixes, heading=heading)
    export(source_of_dive(dive, "odd", None), tmp_path / "a.mcap")
    got = read(tmp_path / "a.mcap")
    where = got.messages["/fixes/location"]
    assert [m["position_covariance_type"] for m in where] == [3, 1, 0, 1]
    assert where[0]["position_covariance"] == [9, 0, 0, 0, 4, -1, 0, -1, 16]
    assert where[1]["position_covariance"][8] == where[3]["position_covariance"][8] == 1e8
    assert where[2]["position_covariance"] == [0] * 9
    assert [m["source"] for m in got.messages["/fixes"]] == ["gnss", 'q"uo\n', "usbl", "x"]
    assert [set(m) for m in got.messages["/heading"]] == [{"timestamp", "heading_deg", "reference"}] * 4


def test_a_reference_in_part(short_dive: Dive, tmp_path: Path) -> None:
    """Places without attitude are places still; a reference that is nowhere leaves its numbers."""
    reference = short_dive.reference
    assert reference is not None
    rph = reference.rph.copy()
    rph[: len(rph) // 2] = np.nan
    dive = replace(short_dive, imu=None, reference=replace(reference, rph=rph))
    export(source_of_dive(dive, "sim", None), tmp_path / "a.mcap")
    got = read(tmp_path / "a.mcap")
    assert len(got.messages["/reference/location"]) == len(reference)
    assert len(got.messages["/reference/pose"]) == len(reference) - len(rph) // 2
    nan = np.full(len(reference), np.nan)
    nowhere = replace(dive, reference=replace(reference, lat=nan, lon=nan))
    export(source_of_dive(nowhere, "sim", None), tmp_path / "b.mcap")
    got = read(tmp_path / "b.mcap")
    assert "/reference/pose" not in got.messages
    assert len(got.messages["/reference"]) == len(reference)


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    def messages() -> Iterator[Stamped]:
        for t in range(10**18, 10**18 + 8_000):
            yield t, t, {"timestamp": {"sec": t // 10**9, "nsec": t % 10**9}, "text": f"{t:01000d}"}

    topics = [Topic(f"/{k}", plain_schema("text", {"text": "string"}), 8_000, messages()) for k in range(2)]
    tracemalloc.start()
    assert write_mcap(topics, tmp_path / "a.mcap", {}) == 16_000
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert sum(chunk.uncompressed_size for chunk in summary.chunk_indexes) > 16e6
    assert peak < 8e6
