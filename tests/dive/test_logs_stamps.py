"""Which clock, and what real logs do to stamps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uwgraph.dive.logs.mapping import DepthMapping
from uwgraph.dive.logs.notes import Notes
from uwgraph.dive.logs.samples import Samples
from uwgraph.dive.logs.sinks import NumberSink, Poured
from uwgraph.dive.logs.stamps import in_order, stamps_of
from uwgraph.dive.logs.window import Window, refuse_gaps
from uwgraph.errors import DataError
from uwgraph.types import TimeArray

START = 1_654_646_400_000_000_000
LOG = START + np.arange(100) * 10**8


def chosen(header: TimeArray | None, time: str = "auto", log: TimeArray = LOG) -> tuple[TimeArray, Notes]:
    notes = Notes()
    mapping = DepthMapping.model_validate({"topic": "t", "depth": "d", "time": time})
    return stamps_of(Poured(log, header, None, np.empty((len(log), 0))), mapping, "depth", notes), notes


def test_the_header_is_taken_where_it_is_plausible() -> None:
    header = LOG - 20_000_000
    stamps, notes = chosen(header)
    np.testing.assert_array_equal(stamps, header)
    assert notes.caveats == []


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (LOG - 22 * 86_400 * 10**9, "-22.0 days off"),
        (LOG * 0, "not set"),
        (np.roll(LOG, 50), "jump back"),
        (np.arange(100) * 10**8, "not set"),
    ],
)
def test_an_implausible_header_is_left_and_told(header: TimeArray, words: str) -> None:
    stamps, notes = chosen(header)
    np.testing.assert_array_equal(stamps, LOG)
    assert words in notes.caveats[0]
    asked, _ = chosen(header, "header")
    np.testing.assert_array_equal(asked, header)


def test_a_header_some_minutes_off_is_taken_with_a_warning() -> None:
    header = LOG + 600 * 10**9
    stamps, notes = chosen(header)
    np.testing.assert_array_equal(stamps, header)
    assert "+10.0 minutes" in notes.caveats[0]
    log, notes = chosen(header, "log")
    np.testing.assert_array_equal(log, LOG)
    assert notes.caveats == []


def test_a_header_that_is_not_there() -> None:
    np.testing.assert_array_equal(chosen(None)[0], LOG)
    with pytest.raises(DataError, match=r"no header\.stamp"):
        chosen(None, "header")


def test_doubles_and_small_shuffles_are_repaired_and_counted() -> None:
    t = np.array([0, 1, 2, 2, 4, 3, 5]) * 10**8 + START
    notes = Notes()
    rows = in_order(t, "imu", notes, shared=False)
    np.testing.assert_array_equal(rows, [0, 1, 2, 5, 4, 6])
    assert any("1 messages with the stamp" in note for note in notes.conversions)
    assert any("1 messages that were out of order" in note for note in notes.conversions)
    assert len(in_order(t, "fixes", Notes(), shared=True)) == 7


def test_a_clock_that_was_set_is_refused_with_the_place() -> None:
    t = LOG.copy()
    t[60:] -= 3600 * 10**9
    with pytest.raises(DataError, match="the clock was set") as caught:
        in_order(t, "imu", Notes(), shared=False)
    assert "message 61" in str(caught.value)
    assert "2022-06-08T00:00:05.9" in str(caught.value)


def test_a_few_stamps_of_a_clock_not_yet_set_are_dropped() -> None:
    t = LOG.copy()
    t[:3] = 0
    notes = Notes()
    np.testing.assert_array_equal(in_order(t, "imu", notes, shared=False), np.arange(3, 100))
    assert "3 messages without" in notes.conversions[0]
    with pytest.raises(DataError, match="no time between") as caught:
        in_order(t - START, "imu", Notes(), shared=False)
    assert "epoch" in caught.value.remedy


@given(st.lists(st.integers(-(2**62), 2**62) | st.integers(START, START + 10**10), max_size=40), st.booleans())
def test_whatever_comes_stamps_are_in_order_or_refused(values: list[int], shared: bool) -> None:
    t = np.array(values, dtype=np.int64)
    try:
        rows = in_order(t, "imu", Notes(), shared=shared)
    except DataError:
        return
    steps = np.diff(t[rows])
    assert (steps >= 0).all() if shared else (steps > 0).all()


@pytest.mark.parametrize(
    ("time", "unit", "exact"),
    [(START + 7, 1e-9, START + 7), (START // 1000 + 7, 1e-6, START + 7000), (1654646400.25, 1.0, START + 250_000_000)],
)
def test_fields_of_time_keep_their_nanoseconds(time: Any, unit: float, exact: int) -> None:
    one = NumberSink(["v"], "t", unit)
    one.add(0, {"t": time, "v": 1.0})
    many = NumberSink(["v"], "t", unit)
    many.extend(np.zeros(1, dtype=np.int64), {"t": np.array([time]), "v": np.ones(1)})
    for sink in (one, many):
        stamps = sink.poured().field_ns
        assert stamps is not None
        assert stamps[0] == exact


def test_a_field_of_time_counts_from_its_epoch() -> None:
    settings = {"topic": "t", "depth": "d", "time": "t [s]", "epoch": "2022-06-08T02:00:00+02:00"}
    poured = Poured(LOG, None, np.array([5_000_000_000]), np.empty((1, 0)))
    stamps = stamps_of(poured, DepthMapping.model_validate(settings), "depth", Notes())
    assert stamps[0] == START + 5 * 10**9


def test_the_longest_stretch_without_a_gap_is_named() -> None:
    seconds = np.concatenate([np.arange(0, 20, 0.1), np.arange(30, 90, 0.1), np.arange(95, 100, 0.1)])
    t = START + np.rint(seconds * 1e9).astype(np.int64)
    with pytest.raises(DataError, match=r"for 10\.1 s after 2022-06-08T00:00:19\.9") as caught:
        refuse_gaps(t)
    assert "--from 2022-06-08T00:00:30.000000000Z --to 2022-06-08T00:01:29.900000000Z" in caught.value.remedy
    refuse_gaps(t[200:800])


def test_a_window_in_seconds_counts_from_the_imu() -> None:
    streams = {"imu": Samples(LOG + 10**9, {}), "depth": Samples(LOG, {}), "fixes": Samples(LOG[:5], {})}
    notes = Notes()
    cut = Window(1.0, 2.0).cut(streams, notes)
    assert {name: len(samples) for name, samples in cut.items()} == {"imu": 11, "depth": 11}
    assert cut["depth"].t_ns[0] == START + 2 * 10**9
    assert "fixes: nothing in that part" in notes.caveats
    instant = Window(START + 5 * 10**9, None).cut(streams, Notes())
    assert instant["imu"].t_ns[0] == START + 5 * 10**9
    with pytest.raises(DataError, match="holds nothing"):
        Window(1e6, 2e6).cut(streams, Notes())
