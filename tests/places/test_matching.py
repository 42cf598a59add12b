"""Which feature is which: mutual, distinct, and never by a twin."""

import numpy as np
import pytest
from floor_views import FLAT, features_view, pair_of, seen_from, texture, tiles

from uwgraph.places.local import LocalSettings
from uwgraph.places.matching import APART, match
from uwgraph.places.rivals import rival
from uwgraph.places.view import view_of


def descriptors(rng, count):
    """Random RootSIFT."""
    d = rng.exponential(size=(count, 128))
    return np.sqrt(d / d.sum(axis=1, keepdims=True)).astype(np.float32)


def test_the_same_features_in_another_order():
    rng = np.random.default_rng(0)
    uv, d, order = rng.uniform(10, 200, (50, 2)), descriptors(rng, 50), rng.permutation(50)
    matches = match(features_view(0, uv, FLAT, d), features_view(1, uv[order], FLAT, d[order]))
    np.testing.assert_array_equal(order[matches.b], matches.a)
    assert len(matches) == 50
    assert matches.distinct.all()


def test_a_twin_in_either_image_makes_a_match_indistinct():
    rng = np.random.default_rng(1)
    uv, d = rng.uniform(10, 200, (20, 2)), descriptors(rng, 20)
    twin_uv, twin_d = np.concatenate([uv, [[220.0, 220.0]]]), np.concatenate([d, d[3:4]])
    alone, twinned = features_view(0, uv, FLAT, d), features_view(1, twin_uv, FLAT, twin_d)
    for a, b in ((alone, twinned), (twinned, alone)):
        matches = match(a, b)
        distinct = dict(zip(matches.a.tolist(), matches.distinct.tolist(), strict=True))
        assert not distinct.get(3, False)
        assert all(distinct[i] for i in range(20) if i != 3)


def test_the_same_thing_found_twice_is_no_twin():
    rng = np.random.default_rng(2)
    uv, d = rng.uniform(10, 200, (20, 2)), descriptors(rng, 20)
    uv, d = np.concatenate([uv, uv[:1] + 0.3 * APART]), np.concatenate([d, d[:1]])
    view = features_view(0, uv, FLAT, d)
    assert match(view, view).distinct.all()


@pytest.mark.parametrize("kind", ["sift", "orb"])
def test_images_of_a_floor_match_and_tiles_do_not(kind):
    rng = np.random.default_rng(3)
    local = LocalSettings(kind=kind, limit=500)
    floors = {"floor": texture(rng), "tiles": tiles()}
    found = {}
    for name, floor in floors.items():
        a, b = (
            view_of(t, seen_from(floor, 0.1 * t, 0.03 * t, noise=rng), FLAT, local=local, how="none") for t in (0, 1)
        )
        found[name] = int(match(a, b).distinct.sum())
    assert found["floor"] > 60
    assert found["tiles"] < 15


def test_nothing_matches_nothing():
    rng = np.random.default_rng(4)
    empty = features_view(0, np.zeros((0, 2)), FLAT, np.zeros((0, 128), np.float32))
    one = features_view(0, np.array([[20.0, 20.0]]), FLAT, descriptors(rng, 1))
    assert len(match(empty, one)) == len(match(one, empty)) == 0
    assert len(match(one, one)) == 1


def test_a_second_motion_is_a_rival():
    rng = np.random.default_rng(5)
    pair = pair_of(rng, wrong=0.0)
    n = len(pair.matches)
    agreeing = np.arange(n) < 0.6 * n
    assert rival(pair.a, pair.b, pair.matches, agreeing) > 0.35 * n
    assert rival(pair.a, pair.b, pair.matches, np.ones(n, np.bool_)) == 0
    wrong = pair_of(rng, wrong=0.9)
    assert rival(wrong.a, wrong.b, wrong.matches, np.arange(len(wrong.matches)) < 40) == 0
