"""Nodes, their samples and neighbours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uwgraph.errors import DataError, UwgraphError
from uwgraph.places.topology import TopologicalMap, TopologySettings

SECOND = 1_000_000_000
NEAR = TopologySettings(gate=1.0, radius_m=1.0, samples=3, apart_s=5.0)


def corridor(n: int = 12, step: float = 0.6, laps: int = 1) -> TopologicalMap:
    """Images along a line; descriptors are the position itself."""
    made = TopologicalMap(2, NEAR)
    for i in range(n * laps):
        x = step * (i % n)
        made.add([x, 0.0], i * SECOND, [x, 0.0, 5.0, 0.0])
    return made


def test_too_similar_images_share_a_node_and_others_follow() -> None:
    made = corridor()
    np.testing.assert_array_equal(made.labels, np.arange(12) // 2)
    assert made.edges == tuple((i, i + 1) for i in range(5))
    assert made.samples(2) == (4, 5)
    assert made.neighbours(3) == (2, 4)
    np.testing.assert_allclose(made.pose(3)[:3], [3.6, 0.0, 5.0])


def test_positions_forbid_what_descriptors_allow() -> None:
    made = TopologicalMap(1, NEAR)
    assert made.add([0.0], 0, [0.0, 0.0, 0.0, 0.0]) == 0
    assert made.add([0.1], 1, [5.0, 0.0, 0.0, 0.0]) == 1
    assert made.add([0.1], 2) == 1, "an unknown position forbids nothing"


def test_a_node_keeps_so_many_samples() -> None:
    made = TopologicalMap(1, NEAR)
    assert [made.add([0.0], i) for i in range(9)] == [0] * 9
    assert len(made) == 3


def test_a_place_seen_again_is_associated_then_merged() -> None:
    made = corridor(laps=2)
    assert len(made.nodes) == 12
    seen = made.associate([1.25, 0.0], 24 * SECOND)
    assert seen is not None
    assert made.labels[seen.sample] == seen.node
    assert seen.node in (1, 7)
    assert seen.distance == pytest.approx(0.05**2, abs=1e-6)
    keep = made.merge(1, 7)
    assert keep == 1
    assert made.neighbours(1) == (0, 2, 6, 8)
    assert len(made.samples(1)) == 4
    assert 7 not in made.nodes
    assert not np.any(made.labels == 7)


def test_what_is_near_in_time_is_not_a_place_seen_again() -> None:
    made = corridor()
    assert made.associate([6.6, 0.0], 11 * SECOND).node < 4
    assert corridor(4).associate([0.0, 0.0], 2 * SECOND) is None
    assert TopologicalMap(2).associate([0.0, 0.0]) is None


def test_the_ratio_tells_the_ambiguous() -> None:
    made = TopologicalMap(1, NEAR)
    for i, x in enumerate([0.0, 10.0, 20.0, 30.0]):
        made.add([x], i * SECOND)
    clear, torn = made.associate([0.5]), made.associate([10.0 - 1e-3 + 5.0])
    assert clear.ratio < 0.01
    assert torn.ratio > 0.1
    assert clear.node == 0


def test_corrected_poses_merge_similar_neighbours() -> None:
    made = TopologicalMap(1, NEAR)
    for i in range(3):
        made.add([0.1 * i], i, [2.0 * i, 0.0, 0.0, 0.0])
    assert len(made.nodes) == 3
    made.move(np.zeros((3, 4)))
    assert made.merge_similar() == 2
    assert made.nodes == (0,)
    assert made.edges == ()
    assert made.add([0.1], 9, np.zeros(4)) == 0
    with pytest.raises(DataError, match="samples"):
        made.move(np.zeros((2, 4)))


@given(
    z=st.lists(st.floats(-3, 3, width=32), min_size=1, max_size=40),
    known=st.booleans(),
    merges=st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=4),
)
@settings(max_examples=50, deadline=None)
def test_whatever_is_added_the_map_holds_together(z: list[float], known: bool, merges: list[tuple[int, int]]) -> None:
    made = TopologicalMap(1, NEAR)
    for i, value in enumerate(z):
        made.add([value], i * SECOND, [value, 0.0, 0.0, 0.0] if known else None)
    for a, b in merges:
        if a in made.nodes and b in made.nodes:
            made.merge(a, b)
    assert set(made.labels) == set(made.nodes)
    assert sorted(s for node in made.nodes for s in made.samples(node)) == list(range(len(made)))
    for node in made.nodes:
        assert all(made.labels[s] == node for s in made.samples(node))
        assert node not in made.neighbours(node)
        assert all(node in made.neighbours(other) for other in made.neighbours(node))
    reached = {made.nodes[0]}
    while more := {n for r in reached for n in made.neighbours(r)} - reached:
        reached |= more
    assert reached == set(made.nodes), "the way is in one piece"


def test_saved_and_loaded_it_is_the_same_and_goes_on(tmp_path: Path) -> None:
    made = corridor(laps=2)
    made.add([0.0, 3.0], 50 * SECOND)
    made.merge(1, 7)
    made.save(tmp_path / "map.npz")
    again = TopologicalMap.load(tmp_path / "map.npz")
    assert (again.nodes, again.edges, again.settings) == (made.nodes, made.edges, made.settings)
    np.testing.assert_array_equal(again.labels, made.labels)
    np.testing.assert_array_equal(again.descriptors, made.descriptors)
    np.testing.assert_array_equal(again.poses, made.poses)
    assert again.associate([2.0, 0.1], 99 * SECOND) == made.associate([2.0, 0.1], 99 * SECOND)
    assert again.add([0.0, 9.0], 51 * SECOND) == made.add([0.0, 9.0], 51 * SECOND)


def test_an_empty_map_is_saved_too(tmp_path: Path) -> None:
    TopologicalMap(3).save(tmp_path / "map.npz")
    assert TopologicalMap.load(tmp_path / "map.npz").nodes == ()


def test_descriptors_of_another_kind_are_refused() -> None:
    made = corridor()
    for bad in ([np.nan, 0.0], [1.0], [[1.0, 2.0]]):
        with pytest.raises(DataError):
            made.add(bad, 0)
    assert len(made) == 12


@pytest.mark.parametrize(
    "change",
    [
        {"labels": np.arange(12)},
        {"labels": np.zeros(12, np.int64)},
        {"edges": np.array([[0, 77]])},
        {"nodes": np.array([[0, 99]])},
        {"nodes": np.zeros((0, 2), np.int64)},
        {"current": np.array([42])},
        {"descriptors": np.full((12, 2), np.nan, np.float32)},
        {"descriptors": np.zeros((3, 2), np.float32)},
        {"t_ns": np.zeros(12)},
        {"settings": np.array("{")},
        {"settings": np.array('{"gate": -1}')},
        {"what": np.array("something else")},
        {"labels": None},
    ],
)
def test_a_map_that_contradicts_itself_is_refused(tmp_path: Path, change: dict[str, np.ndarray | None]) -> None:
    corridor().save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as file:
        arrays = {name: file[name] for name in file.files} | change
    np.savez(tmp_path / "bad.npz", **{name: a for name, a in arrays.items() if a is not None})
    with pytest.raises(UwgraphError, match=r"bad\.npz"):
        TopologicalMap.load(tmp_path / "bad.npz")
