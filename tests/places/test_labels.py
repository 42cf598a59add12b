"""Places by position: near their centre, and apart from each other."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from uwgraph.places.labels import NO_PLACE, places_apart, places_of

positions_of = arrays(
    np.float64,
    st.tuples(st.integers(0, 40), st.integers(2, 3)),
    elements=st.floats(-5.0, 5.0, width=16),
)
lengths = st.floats(0.1, 4.0)


def distances(p: np.ndarray) -> np.ndarray:
    return np.linalg.norm(p[:, None] - p, axis=2)


@given(p=positions_of, radius=lengths)
@settings(max_examples=60, deadline=None)
def test_every_position_is_near_its_centre_and_centres_are_apart(p: np.ndarray, radius: float) -> None:
    labels, d = places_of(p, radius), distances(p)
    assert set(labels) == set(range(len(set(labels))))
    centres: list[int] = []
    for i in range(len(p)):
        if np.all(d[i, centres] > radius):
            centres.append(i)
    assert len(centres) == len(set(labels))
    np.testing.assert_array_equal(labels[centres], np.arange(len(centres)))
    if len(p):
        np.testing.assert_array_equal(d[np.arange(len(p)), np.array(centres)[labels]], d[:, centres].min(axis=1))
        assert d[:, centres].min(axis=1).max() <= radius


@given(p=positions_of, radius=lengths, gap=lengths, seed=st.integers(0, 9))
@settings(max_examples=80, deadline=None)
def test_places_are_small_and_apart_and_no_other_fits(p: np.ndarray, radius: float, gap: float, seed: int) -> None:
    labels, d = places_apart(p, radius, gap, np.random.default_rng(seed)), distances(p)
    taken = labels != NO_PLACE
    places = set(labels[taken])
    assert places == set(range(len(places)))
    for place in places:
        members = labels == place
        assert members.sum() >= 2
        assert d[np.ix_(members, members)].max(axis=1).min() <= radius, "one of them is the centre"
        assert d[np.ix_(members, taken & ~members)].min(initial=np.inf) > gap
    for i in np.flatnonzero(~taken):
        ball = d[i] <= radius
        assert ball.sum() < 2 or d[np.ix_(ball, taken)].min() <= gap, "it could have been a place"
    np.testing.assert_array_equal(labels, places_apart(p, radius, gap, np.random.default_rng(seed)))


def test_draws_differ_so_that_all_images_are_used() -> None:
    p = np.stack([np.arange(0.0, 30.0, 0.5), np.zeros(60)], axis=1)
    rng = np.random.default_rng(0)
    drawn = np.array([places_apart(p, 1.0, 1.0, rng) for _ in range(16)])
    assert np.all((drawn != NO_PLACE).any(axis=0))
    assert np.all((drawn == NO_PLACE).any(axis=1))
