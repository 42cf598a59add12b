"""Fields, sinks, guesses, the mapping file, and a log from its topics to a dive."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.dive.logs.assemble import Wishes
from uwgraph.dive.logs.fields import resolve, row_getter
from uwgraph.dive.logs.guess import guess
from uwgraph.dive.logs.log import Known, Progress, Proposal, Sink, Topic
from uwgraph.dive.logs.mapping import LogMapping
from uwgraph.dive.logs.mapping_file import mapping_text
from uwgraph.dive.logs.quantity import UNITS, quantity
from uwgraph.dive.logs.reading import LogOptions, read_log
from uwgraph.dive.logs.sinks import NumberSink
from uwgraph.dive.logs.window import Window
from uwgraph.dive.rig import DvlRig, Rig
from uwgraph.dive.validate import validate_dive
from uwgraph.dive.yamlfile import parse_settings, parse_yaml
from uwgraph.errors import ConfigError, DataError
from uwgraph.types import Origin

START = 1_654_646_400_000_000_000
XYZ = ("x", "y", "z")
IMU = {"f": [f"f.{a}" for a in XYZ], "w": [f"w.{a}" for a in XYZ]}


# --- fields and sinks


def test_fields_by_attribute_by_key_and_by_index() -> None:
    by_attribute = Message(a=Message(x=1, y=2.5), data=[5, 6])
    by_key = {"a": {"x": 1, "y": 2.5}, "data": [5, 6]}
    for message in (by_attribute, by_key):
        assert list(row_getter(["a.x", "a.y"], message)(message)) == [1, 2.5]
        assert list(row_getter(["a.x", "data[1]"], message)(message)) == [1, 6]
        assert list(row_getter(["a.b", "data[2]", "data.x"], message)(message)) == [None, None, None]


def test_what_is_no_number_is_nan() -> None:
    sink = NumberSink(["a", "b"])
    for value in (1, 2.0, True, np.float32(3), None, "4", [5], {}, 10**400):
        sink.add(START, {"a": value, "b": 7})
    values = sink.poured().values
    np.testing.assert_array_equal(values[:, 0], [1, 2, 1, 3, *[np.nan] * 5])
    assert (values[:, 1] == 7).all()


def test_stamps_of_headers_in_all_spellings() -> None:
    for seconds, rest in (("sec", "nanosec"), ("secs", "nsecs")):
        sink = NumberSink(["v"])
        sink.add(START, {"v": 1, "header": {"stamp": {seconds: 1654646400, rest: 123456789}}})
        sink.add(START, {"v": 1})
        header = sink.poured().header_ns
        assert header is not None
        assert list(header) == [START + 123456789, 0]
    assert NumberSink(["v"]).poured().header_ns is None


@given(st.lists(st.tuples(st.floats(), st.integers(-(2**70), 2**70)), max_size=30))
def test_a_sink_keeps_what_it_is_given(rows: list[tuple[float, int]]) -> None:
    one, many = NumberSink(["a"]), NumberSink(["a"])
    for value, t in rows:
        one.add(t, Message(a=value))
    stamps = np.array([t if abs(t) < 2**62 else 0 for _, t in rows], dtype=np.int64)
    many.extend(stamps, {"a": np.array([value for value, _ in rows])})
    np.testing.assert_array_equal(one.poured().values, many.poured().values)
    np.testing.assert_array_equal(one.poured().log_ns, many.poured().log_ns)


def test_columns_that_bear_their_unit_answer_to_it_alone() -> None:
    topic = Topic("t", "table", fields=("ACC X [g]", "data", "p[0]"))
    assert resolve(quantity("-ACC X [g]", "acceleration"), topic, "") == "ACC X [g]"
    assert resolve(quantity("ACC X [g] [mg]", "acceleration"), topic, "") == "ACC X [g]"
    assert resolve(quantity("data[7]", "number"), topic, "") == "data[7]"
    with pytest.raises(ConfigError, match="no field 'ACC X'") as caught:
        resolve(quantity("ACC X", "acceleration"), topic, "mapping: imu.f")
    assert "did you mean 'ACC X [g]'" in caught.value.remedy


# --- a log in memory


@dataclass
class MemoryLog:
    messages: dict[str, list[tuple[int, Any]]]
    known: Known = field(default_factory=Known)
    caveats: tuple[str, ...] = ()
    poured: list[str] = field(default_factory=list)

    @property
    def topics(self) -> tuple[Topic, ...]:
        return tuple(Topic(name, name.rstrip("0123456789"), len(m)) for name, m in self.messages.items())

    def pour(self, sinks: Mapping[str, tuple[Sink, ...]], progress: Progress) -> None:
        self.poured = sorted(sinks)
        for name, taking in sinks.items():
            for t_ns, message in self.messages[name]:
                for sink in taking:
                    sink.add(t_ns, message)
        progress(1.0)


class MemoryReader:
    NAME, EXPECTS, CLOCKS_DIFFER = "memory", "nothing", False

    def __init__(self, log: MemoryLog) -> None:
        self.log = log

    def matches(self, path: Path) -> str:
        return ""

    @contextmanager
    def open_log(self, path: Path) -> Iterator[MemoryLog]:
        yield self.log

    def proposals(self, topic: Topic) -> tuple[Proposal, ...]:
        settings = {"imu": ("imu", IMU), "fix": ("fixes", {"lat": "lat [deg]", "lon": "lon [deg]"})}
        if topic.type not in settings:
            return ()
        stream, fields = settings[topic.type]
        mapping = LogMapping.model_validate({"streams": {stream: {"topic": topic.name, **fields}}})
        return (Proposal(stream, mapping.by_stream()[stream], note="axes assumed"),)


def imu_messages(count: int = 100) -> list[tuple[int, Any]]:
    force, rate = Message(x=0.1, y=0.2, z=-9.8), Message(x=0.0, y=0.0, z=0.01)
    return [(START + k * 10**7, Message(f=force, w=rate)) for k in range(count)]


def fix_messages(count: int = 3) -> list[tuple[int, Any]]:
    return [(START + k * 10**8, Message(lat=43.0 + k * 1e-5, lon=6.0)) for k in range(count)]


def read(log: MemoryLog, **options: Any) -> Any:
    return read_log(Path("memory"), MemoryReader(log), LogOptions(**options), None, lambda share: None)


def mapped(**streams: Any) -> LogMapping:
    return LogMapping.model_validate({"streams": streams})


def test_a_guessed_log_becomes_a_dive() -> None:
    log = MemoryLog({"imu1": imu_messages(50), "imu0": imu_messages(), "fix": fix_messages(), "odd": [(START, 1)]})
    dive, survey = read(log)
    validate_dive(dive)
    assert log.poured == ["fix", "imu0"]  # the IMU with more messages
    assert len(dive.imu) == 99
    assert dive.origin.lat == pytest.approx(np.radians(43.0))
    assert {taken.stream: taken.topic for taken in survey.taken} == {"imu": "imu0", "fixes": "fix"}
    assert {left.topic: left.why for left in survey.left} == {
        "imu1": "could be imu; imu0 was taken",
        "odd": "of no use here",
    }
    assert "imu: axes assumed" in dive.provenance["caveats"]
    assert "origin: the first position of fixes" in dive.provenance["conversions"]


def test_what_the_user_says_wins_over_mapping_and_log() -> None:
    ours, theirs = Rig(dvl=DvlRig(sigma=0.5)), Rig(dvl=DvlRig(sigma=0.7))
    log = MemoryLog({"fix": fix_messages()}, Known(rig=theirs))
    fixes = {"topic": "fix", "lat": "lat [deg]", "lon": "lon [deg]"}
    dive, _ = read(log, mapping=mapped(fixes=fixes))
    assert dive.rig == theirs
    with_both = LogMapping.model_validate(
        {"origin": {"lat_deg": 43, "lon_deg": 5}, "rig": {"dvl": {"sigma": 0.6}}, "streams": {"fixes": fixes}}
    )
    dive, _ = read(log, mapping=with_both)
    assert dive.rig.dvl.sigma == 0.6
    assert dive.origin.lon == pytest.approx(np.radians(5))
    dive, _ = read(log, mapping=with_both, wishes=Wishes(Origin(0.7, 0.1), ours, Window(0.1, None)))
    assert (dive.rig, dive.origin, len(dive.fixes)) == (ours, Origin(0.7, 0.1), 2)


@pytest.mark.parametrize(
    ("streams", "words"),
    [
        ({"depth": {"topic": "fixx", "depth": "lat"}}, "did you mean 'fix'"),
        ({"depth": {"topic": "fix", "depth": "lat"}}, "--origin LAT,LON"),
    ],
)
def test_a_mapping_is_checked_before_anything_is_read(streams: Any, words: str) -> None:
    log = MemoryLog({"fix": fix_messages()})
    with pytest.raises((ConfigError, DataError)) as caught:
        read(log, mapping=mapped(**streams))
    assert words in caught.value.remedy
    assert log.poured == []


def test_an_imu_whose_z_points_up_is_told_in_words_of_the_mapping() -> None:
    """Guessed as frd, it is flu."""
    flu = [(t, Message(f=Message(x=0.1, y=0.2, z=9.8), w=message.w)) for t, message in imu_messages()]
    log = MemoryLog({"imu": flu, "fix": fix_messages()})
    with pytest.raises(DataError, match="upside down") as caught:
        read(log)
    assert "axes: flu" in caught.value.remedy
    dive, _ = read(
        MemoryLog({"imu": flu, "fix": fix_messages()}),
        mapping=mapped(
            imu={"topic": "imu", **IMU, "axes": "flu"}, fixes={"topic": "fix", "lat": "lat [deg]", "lon": "lon [deg]"}
        ),
    )
    validate_dive(dive)


def test_a_number_stands_for_a_field() -> None:
    mapping = mapped(
        fixes={"topic": "fix", "lat": "lat [deg]", "lon": "lon [deg]"},
        depth={"topic": "fix", "depth": "lat", "sigma": "25 [cm]"},
    )
    dive, _ = read(MemoryLog({"fix": fix_messages()}), mapping=mapping)
    np.testing.assert_array_equal(dive.depth.sigma, [0.25] * 3)


def test_a_stream_without_usable_messages_is_left_out_and_told() -> None:
    log = MemoryLog({"imu": imu_messages(), "fix": [(START, Message(lat=0.0, lon=0.0))]})
    dive, _ = read(log, wishes=Wishes(Origin(0.7, 0.1)))
    assert dive.fixes is None
    assert any("no message of fix is usable" in note for note in dive.provenance["caveats"])
    with pytest.raises(DataError, match="no stream of the mapping has a usable message"):
        read(MemoryLog({"fix": [(START, Message())]}), wishes=Wishes(Origin(0.7, 0.1)))


def test_nothing_known_leaves_a_file_to_edit(tmp_path: Path) -> None:
    log = MemoryLog({"odd": [(START, Message(data=1.0))]})
    template = tmp_path / "dive-mapping.yaml"
    with pytest.raises(DataError, match="none of its 1 topics") as caught:
        read(log, template=template)
    assert str(template) in caught.value.remedy
    assert "odd" in template.read_text()
    template.write_text("mine")
    with pytest.raises(DataError):
        read(log, template=template)
    assert template.read_text() == "mine"


# --- guesses and the mapping file


def test_rank_goes_before_count_and_a_compass_needs_an_imu() -> None:
    magnet = {"topic": "mag", "magnetic_field": ["a", "b", "c"]}
    heading = mapped(heading=magnet).by_stream()["heading"]
    imus = {name: mapped(imu={"topic": name, **IMU}).by_stream()["imu"] for name in ("raw", "good")}
    offers = {
        "raw": (Proposal("imu", imus["raw"], 0),),
        "good": (Proposal("imu", imus["good"], 1),),
        "mag": (Proposal("heading", heading),),
        "silent": (Proposal("imu", imus["good"], 9),),
    }
    topics = [Topic("raw", "T", 900), Topic("good", "T", 10), Topic("mag", "T", 5), Topic("silent", "T", 0)]
    found = guess(topics, lambda topic: offers[topic.name])
    assert {t.stream: t.topic for t in found.taken} == {"imu": "good", "heading": "mag"}
    assert {left.topic: left.why for left in found.left}["silent"] == "no messages"
    alone = guess([topics[2]], lambda topic: offers[topic.name])
    assert alone.taken == ()
    assert "needs an imu" in alone.left[0].why


NAMES = st.text("abcxyz_./[]0:#'\" é", min_size=1, max_size=12).map(str.strip).filter(bool)


@st.composite
def quantities(draw: st.DrawFn, dimension: str) -> str:
    name = draw(st.from_regex(r"[a-z]\w{0,8}(\.[a-z]\w{0,5}|\[\d\]){0,3}", fullmatch=True))
    return f"{draw(st.sampled_from(['', '-']))}{name} [{draw(st.sampled_from(sorted(UNITS[dimension])))}]"


def triple(dimension: str) -> st.SearchStrategy[list[str]]:
    return st.lists(quantities(dimension), min_size=3, max_size=3)


@settings(max_examples=40, deadline=None)
@given(
    NAMES,
    triple("acceleration"),
    triple("rate"),
    st.sampled_from(["frd", "flu", "rdf"]),
    quantities("angle"),
    st.sampled_from(["ned", "enu"]),
    st.sampled_from(["first", "least", 99_000.0]),
    quantities("pressure"),
)
def test_the_mapping_file_reads_back(
    topic: str, f: list[str], w: list[str], axes: str, heading: str, world: str, surface: Any, pressure: str
) -> None:
    values = {
        "origin": {"lat_deg": 1.0, "lon_deg": -2.0},
        "streams": {
            "imu": {"topic": topic, "f": f, "w": w, "axes": axes, "epoch": "2022-06-08T09:00:00Z", "time": "t [us]"},
            "heading": {"topic": topic, "heading": heading, "world": world, "reference": "true"},
            "depth": {"topic": topic, "pressure": pressure, "surface_pressure_pa": surface},
        },
        "images": {"down": {"topic": topic, "max_rate_hz": 2.0}},
    }
    mapping = LogMapping.model_validate(values)
    topics = [Topic(topic, "T"), Topic("left\n- x: !!python/object", "T", 3, ("a", "b"))]
    left = guess(topics[1:], lambda topic: ()).left
    text = mapping_text(mapping, topics, left)
    again = parse_settings(LogMapping, parse_yaml(text, "file"), "file")
    assert again == mapping
    assert "a, b" in text


def test_yaml_true_is_the_word() -> None:
    assert mapped(heading={"topic": "t", "heading": "h", "reference": True}).streams.heading is not None


@pytest.mark.parametrize(
    ("streams", "words"),
    [
        ({"imu": {"topic": "t"}}, "imu.f"),
        ({"imu": {"topic": "t", "f": ["a", "b", "c [deg]"], "w": ["a", "b", "c"]}}, "no unit of acceleration"),
        ({"depth": {"topic": "t", "depth": "a", "pressure": "b"}}, "exactly one"),
        ({"depth": {"topic": "t", "depht": "a"}}, "did you mean 'depth'"),
        ({"fixes": {"topic": "t", "lat": "a"}}, "together"),
        ({"heading": {"topic": "t", "heading": "a", "epoch": "2022-01-01T00:00:00"}}, "no time zone"),
        ({"reference": {"topic": "t"}}, "position, an attitude or a velocity"),
        ({"imo": {}}, "did you mean 'imu'"),
    ],
)
def test_a_wrong_mapping_is_told_by_key(streams: Any, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_settings(LogMapping, {"streams": streams}, "m.yaml")
    assert words in str(caught.value)
    assert "m.yaml" in caught.value.where
